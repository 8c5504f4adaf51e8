"""Check that tracked poses fit a shape of the robot, with the mistake that explains a misfit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.evaluation.plausibility.corrections import Correction, corrections
from glissando.evaluation.plausibility.finding import Finding, listed
from glissando.evaluation.plausibility.session import Streams
from glissando.evaluation.plausibility.shape import ROUNDS, Fit, Rod, TrackedPoses
from glissando.geometry.se3 import Array
from glissando.model.evenly import evenly_chosen
from glissando.model.quantiles import chi_square_exceedance

_MISS = {False: 1.3, True: 2.5}  # tolerated miss in the guard's std; True for few streams
_HUGE = 1e9  # limit of misses, to keep sums finite
_FEWER = 3  # number of streams below which they are few, and a shape almost fits by bending
_CHANCE = 1e-7  # probability that a random bend exceeds the limit of effort
_ROWS = 36  # effective number of parameters of a fitted shape
_FEW = 3  # moments at which all corrections are first tried
_ENOUGH = 2  # number of other streams that determine a shape without the corrected ones
_CAREFUL = 48  # iterations of a decisive fit
_QUICK = 8  # iterations of the first fits of corrections
_BEST = 6  # corrections that are tried at all moments
_GROUPS = 3  # groups of streams on which corrections are tried


@dataclass(frozen=True)
class _Judged:
    """Fit of all streams after a correction of some; `miss` and `effort` over their limits."""

    correction: Correction
    group: tuple[int, ...]
    miss: float
    effort: float

    @property
    def sound(self) -> bool:
        return max(self.miss, self.effort) < 1.0

    @property
    def cost(self) -> float:
        return self.correction.doubt * (1.0 + 2.0 * self.miss**2 + _ROWS * self.effort)


def check_poses(streams: Streams) -> Iterator[Finding]:
    """Check that the poses of all trackers fit shapes of the robot.

    Args:
        streams: Streams of a session.

    Yields:
        Findings.
    """
    if not streams.tracked:
        return
    rod = Rod(streams.robot)
    _, seen = streams.moments()
    for rounds in (ROUNDS, _CAREFUL):  # strongly bent robots need more iterations
        miss, effort = _judge(rod.fit(seen, rounds), seen)
        if miss[0].max() < 1.0 and effort[0] < 1.0:
            return
    yield _explained(streams, rod, seen, miss[0], float(effort[0]))


def _judge(fit: Fit, seen: TrackedPoses, count: int = 1) -> tuple[Array, Array]:
    """Median misses (count, J) and efforts (count,) over the moments, for `count` variants.

    Both are relative to their limits. The effort is the cost of bends plus all misses; its limit is
    exceeded with small probability by a random walk of curvature with the guard's noise.
    """
    unseen = np.stack([seen.weight[..., 0] == 0.0, seen.weight[..., 1:].max(-1) == 0.0], axis=-1)
    finite = np.where(np.isfinite(fit.misses), np.minimum(fit.misses, _HUGE), _HUGE)
    misses = np.where(unseen, 0.0, finite).reshape(count, -1, *fit.misses.shape[1:])
    bends = np.where(np.isfinite(fit.effort), np.minimum(fit.effort, _HUGE), _HUGE)
    weight = seen.weight.reshape(count, -1, *seen.weight.shape[1:])
    axes = weight[..., 1:].sum(axis=-1)
    rows = 3.0 * weight[..., 0] + np.select([axes > 1.0, axes > 0.0], [3.0, 2.0], 0.0)
    freedom = np.clip(np.median(rows.sum(axis=-1), axis=1), 1.0, _ROWS)
    every = bends.reshape(count, -1) + np.sum(misses**2, axis=(2, 3))
    efforts = np.median(every, axis=1)
    few = bool(np.median((seen.weight.max(axis=-1) > 0.0).sum(axis=-1)) < _FEWER)
    limit = chi_square_exceedance(_CHANCE, freedom)
    return np.median(misses, axis=1).max(axis=-1) / _MISS[few], efforts / limit


def _explained(
    streams: Streams, rod: Rod, seen: TrackedPoses, miss: Array, effort: float
) -> Finding:
    """Finding with the most likely mistake for poses that fit no shape."""
    tracked = streams.tracked
    groups = _suspects(streams, rod, seen)
    sound: list[_Judged] = []
    for group in groups[:_GROUPS]:
        if not any(j.miss < 0.5 and j.effort < 0.5 for j in sound):
            sound += [j for j in _best_corrections(streams, rod, seen, group) if j.sound]
    best = min(sound, key=lambda j: j.cost, default=None)
    if best is not None:
        names = tuple(tracked[j].label for j in best.group)
        return Finding(
            best.correction.check,
            f"{_subject(names)} not on the robot ({_how(streams, miss, effort)}): "
            f"{best.correction.cause}; {best.correction.advice}.",
            True, names, best.correction.cause,
        )  # fmt: skip
    every = tuple(range(len(tracked)))
    free = Rod(streams.robot, free_base=True)
    loose, loose_effort = _judge(free.fit(seen), seen)
    if streams.robot.prior.fixes_base and loose[0].max() < 1.0 and loose_effort[0] < 1.0:
        names = tuple(tracked[j].label for j in every)
        return Finding(
            "base",
            f"{_subject(names)} not on the robot's base ({_how(streams, miss, effort)}), but "
            f"on a robot of the same length that stands elsewhere: [base] of the robot file or "
            f"the frame of the readings is probably wrong; calibrate it.",
            True, names, "base",
        )  # fmt: skip
    group = next((g for g in groups if len(g) < len(tracked)), (int(np.argmax(miss)),))
    names = tuple(tracked[j].label for j in group)
    return Finding(
        "shape",
        f"No shape of the robot fits {listed(names)} ({_how(streams, miss, effort)}): a frame, "
        f"mount, arclength, unit or the stretch of the robot file is probably wrong; check them, "
        f"or calibrate.",
        False, names,
    )  # fmt: skip


def _subject(names: Sequence[str]) -> str:
    return f"{listed(names)} {'is' if len(names) == 1 else 'are'}"


def _how(streams: Streams, miss: Array, effort: float) -> str:
    """Size of the misfit, as part of a sentence."""
    worst = int(np.argmax(miss))
    name = streams.tracked[worst].label
    if miss[worst] < 1.0:
        return f"it would have to bend {np.sqrt(effort):.2g} times as far as robots do"
    return f"{name!r} misses the best shape by {miss[worst]:.3g} times what is tolerated"


def _suspects(streams: Streams, rod: Rod, seen: TrackedPoses) -> list[tuple[int, ...]]:
    """Groups of streams without which the other streams fit a shape, the smallest first."""
    tracked = streams.tracked
    groups = {(j,) for j in range(len(tracked))} | {tuple(range(len(tracked)))}
    frames = [streams.frame(r).tobytes() for r in tracked]
    for frame in set(frames):
        groups.add(tuple(j for j, f in enumerate(frames) if f == frame))
    truth = tuple(j for j, r in enumerate(tracked) if any(r is t for t in streams.truth))
    groups |= {truth, tuple(j for j in range(len(tracked)) if j not in truth)} - {()}
    ordered = sorted(groups, key=lambda g: (len(g), g))
    batch = [seen.without(list(group)) for group in ordered]
    every = batch[0].joined(batch[1:])
    miss, effort = _judge(rod.fit(every), every, len(batch))
    return [
        group
        for group, m, e in zip(ordered, miss, effort, strict=True)
        if m.max() < 1.0 and e < 1.0
    ]


def _best_corrections(
    streams: Streams, rod: Rod, seen: TrackedPoses, group: tuple[int, ...]
) -> list[_Judged]:
    """Evaluate corrections of a group of streams; the best are evaluated with refitted shapes.

    All corrections are first ranked by their misses from shapes fitted to the other streams, or, if
    these are too few to determine a shape, by fits at a few moments.
    """
    frame = streams.frame(streams.tracked[group[0]])
    place = seen.place[:, list(group)]
    reach = float(place.min()), float(place.max())
    distance = np.linalg.norm((seen.pose[:, list(group), :3, 3] - rod.base[:3, 3]), axis=-1)
    sizes = (
        float(np.median(distance.max(axis=1))) / max(reach[1], 0.1 * rod.length),
        float(np.linalg.norm(frame[:3, 3])) / rod.length,
    )
    chosen = corrections(rod.length, reach, sizes, bool(np.any(frame != np.eye(4))))
    if seen.weight.shape[1] - len(group) >= _ENOUGH:
        shapes, tried = rod.fit(seen.without(list(group))), _corrected(seen, group, chosen, frame)
        fit = rod.seen_by(shapes, tried)
    else:
        some = evenly_chosen(len(seen.place), _FEW)
        few = TrackedPoses(*(a[some] for a in (seen.place, seen.pose, seen.weight)))
        tried = _corrected(few, group, chosen, frame)
        fit = rod.fit(tried, _QUICK)
    coarse = _judgements(fit, tried, chosen, group)
    best = [chosen[i] for i in np.argsort([j.cost for j in coarse], kind="stable")[:_BEST]]
    tried = _corrected(seen, group, best, frame)
    return _judgements(rod.fit(tried), tried, best, group)


def _corrected(
    seen: TrackedPoses, group: tuple[int, ...], chosen: Sequence[Correction], frame: Array
) -> TrackedPoses:
    """Tracked poses with each correction of a group of streams, as one batch."""
    batch, columns = [], list(group)
    for correction in chosen:
        place, pose = seen.place.copy(), seen.pose.copy()
        place[:, columns], pose[:, columns] = correction.change(
            place[:, columns], pose[:, columns], frame
        )
        batch.append(replace(seen, place=place, pose=pose))
    return batch[0].joined(batch[1:])


def _judgements(
    fit: Fit, tried: TrackedPoses, chosen: Sequence[Correction], group: tuple[int, ...]
) -> list[_Judged]:
    miss, effort = _judge(fit, tried, len(chosen))
    return [
        _Judged(c, group, float(m.max()), float(e))
        for c, m, e in zip(chosen, miss, effort, strict=True)
    ]
