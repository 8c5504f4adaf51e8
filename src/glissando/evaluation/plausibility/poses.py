"""Whether tracked poses fit one shape of the robot, and which mistake explains that they do not."""

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

_MISS = {False: 1.3, True: 2.5}  # typical miss in generous standard deviations, of few streams more
_HUGE = 1e9  # beyond any miss of interest
_FEWER = 3  # streams, which leave a shape to bend so that it almost fits
_CHANCE = 1e-7  # with which a random bend is taken for a mistake
_ROWS = 36  # numbers that a shape of the guard has
_FEW = 3  # moments at which every correction is tried
_ENOUGH = 2  # other streams that tell a shape without those that are corrected
_CAREFUL = 48  # steps of a fit that decides
_QUICK = 8  # steps of those fits
_BEST = 6  # corrections that are tried at all moments
_GROUPS = 3  # groups of streams on which corrections are tried


@dataclass(frozen=True)
class _Judged:
    """How well a correction of some streams explains all of them."""

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
    """Findings on where trackers see the robot, each alone and all together.

    Args:
        streams: A session.

    Yields:
        Findings.
    """
    if not streams.tracked:
        return
    rod = Rod(streams.robot)
    _, seen = streams.moments()
    for rounds in (ROUNDS, _CAREFUL):  # a strongly bent robot is found from a start nearer by
        miss, effort = _judge(rod.fit(seen, rounds), seen)
        if miss[0].max() < 1.0 and effort[0] < 1.0:
            return
    yield _explained(streams, rod, seen, miss[0], float(effort[0]))


def _judge(fit: Fit, seen: TrackedPoses, count: int = 1) -> tuple[Array, Array]:
    """Typical misses (count, J) and efforts (count,) of a batch of `count` times some moments.

    Both are in units of what is tolerated. An effort is that of the bends and of all misses, which
    a random walk of curvature with generous noise exceeds with a small chance.
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
    """The finding that names what explains why the poses fit no shape."""
    tracked = streams.tracked
    groups = _suspects(streams, rod, seen)
    sound: list[_Judged] = []
    for group in groups[:_GROUPS]:
        if not any(j.miss < 0.5 and j.effort < 0.5 for j in sound):
            sound += [j for j in _tried(streams, rod, seen, group) if j.sound]
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
    """By how much the poses miss a shape, as a part of a sentence."""
    worst = int(np.argmax(miss))
    name = streams.tracked[worst].label
    if miss[worst] < 1.0:
        return f"it would have to bend {np.sqrt(effort):.2g} times as far as robots do"
    return f"{name!r} misses the best shape by {miss[worst]:.3g} times what is tolerated"


def _suspects(streams: Streams, rod: Rod, seen: TrackedPoses) -> list[tuple[int, ...]]:
    """Groups of streams without which the rest fits a shape, the smallest first."""
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


def _tried(streams: Streams, rod: Rod, seen: TrackedPoses, group: tuple[int, ...]) -> list[_Judged]:
    """The corrections of a group of streams that look best at first, judged by refitted shapes.

    At first each is judged by the shapes that fit the other streams, or where these are too few to
    tell a shape, by shapes fitted at a few moments.
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
    """Tracked poses with each correction of a group of streams, one after the other."""
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
