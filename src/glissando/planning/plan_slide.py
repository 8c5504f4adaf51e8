"""The best path of a sliding sensor: starts of many kinds, the best of them improved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.slide_path import SlideLimits, SlidePath
from glissando.planning.optimize import descend, strictly_inside
from glissando.planning.path_objective import PathObjective
from glissando.planning.path_space import PathSpace
from glissando.planning.zones import Zone

_RANDOM, _DWELLING = 4, 20  # random starts, and such that dwell
_ALIKE = 0.05  # of the track, within which two paths are one start
_TRIED = 5  # starts that are improved a little
_ITERATIONS, _STEPS = 12, 8  # of the one that became best: at least, and steps of its path for each
_BRIEFLY = 4  # times fewer for each of the others
_DRAWN = 0.1  # share of the way to the middle of all paths that a start is drawn, to be inside


@dataclass(frozen=True)
class Plan:
    """A path and what it is foretold to be worth.

    `arclength` (T,) of the first coil at `times` (T,), absolute seconds, the middles of the
    steps; `control` points of the path on its `track`; `value` by the objective, and of every start
    by name in `starts`.
    """

    times: Array
    arclength: Array
    control: Array
    track: PathSpace
    value: float
    starts: dict[str, float]

    def at(self, time: ArrayLike) -> tuple[Array, Array]:
        """Arclength (…) and speed (…) at absolute times; at rest after the end."""
        knots, place, speed = self.knots()
        into = np.clip(np.asarray(time, dtype=float) - self.start, 0.0, knots[-1])
        k = np.minimum((into / self.track.step).astype(np.intp), knots.size - 2)
        share = into - knots[k]
        slope = (speed[k + 1] - speed[k]) / self.track.step
        return place[k] + share * (speed[k] + 0.5 * slope * share), speed[k] + slope * share

    @property
    def start(self) -> float:
        """When it begins, absolute seconds."""
        return float(self.times[0] - self.track.times[0])

    def knots(self) -> tuple[Array, Array, Array]:
        """Times from the plan's start, arclengths and speeds; constant acceleration between."""
        return self.track.knots(self.control)

    def slide_path(self, tip: float, limits: SlideLimits) -> SlidePath:
        """The path as displacements from where the sensor is when drawn out, `tip` metres."""
        time, place, speed = self.knots()
        return SlidePath(time, tip - place, -speed, limits)


def plan_slide(
    judge: PathObjective,
    track: PathSpace,
    zones: Sequence[Zone] = (),
    *,
    wear: float = 0.0,
    seed: int = 0,
    tried: int = _TRIED,
    iterations: int | None = None,
    before: Array | None = None,
) -> Plan:
    """The path of least value by a judge among those that a track allows.

    The `zones` tell where it may pay to start; `wear` weighs the mean square speed, in s² times the
    objective's unit; `before` is a path (T + 2,) of control points to start from as well. Of the
    best starts that differ, `tried` are improved a little, the best of these for up to
    `iterations`, by default more for a longer path; the result is never worse than any start.
    Raises GlissandoError when the track has not the outlook's steps.
    """
    outlook = judge.outlook
    if (track.steps, track.step) != (outlook.steps, outlook.step):
        raise GlissandoError(
            f"The track has {track.steps} steps of {track.step:g} s and the outlook "
            f"{outlook.steps} of {outlook.step:g} s; give both the same."
        )
    wanted = starts(track, zones, outlook.start, seed)
    if before is not None:
        wanted["before"] = before
    paths = track.follow(np.stack(list(wanted.values())))
    with one_thread():
        values = [_worth(judge, track, path, wear) for path in paths]
        if iterations is None:
            iterations = max(_ITERATIONS, track.steps // _STEPS)
        control, value = _searched(judge, track, paths, values, wear, tried, iterations)
    told = dict(zip(wanted, map(float, values), strict=True))
    return Plan(outlook.times, track.places(control), control, track, float(value), told)


def starts(track: PathSpace, zones: Sequence[Zone], begin: float, seed: int) -> dict[str, Array]:
    """Where first paths want to be (T + 2,), by name; the time ahead begins at `begin` seconds.

    Fixed, oscillating and sweeping over all of the track, where the zones are, at random, and
    dwelling at random at one end, the other and the zones.
    """
    low, high = track.lower, track.upper
    time, way = track.control_times, high - low
    out = {
        f"fixed at {1e3 * place:.4g} mm": np.full(time.size, place)
        for place in (track.start, low, 0.5 * (low + high), high)
    }
    chased = {f"in zone {i + 1}": zone.middle(time + begin) for i, zone in enumerate(zones)}
    out |= chased
    for part in (1.0, 0.5, 0.25):
        turns = time * part * track.speed / (2.0 * way) + 0.5 * (high - track.start) / way
        place = low + 2.0 * way * np.abs(turns % 1.0 - 0.5)
        out[f"oscillating at {1e3 * part * track.speed:.3g} mm/s"] = place
    out["sweeping out"] = np.linspace(low, high, time.size)
    out["sweeping in"] = np.linspace(high, low, time.size)
    rng = np.random.default_rng(seed)
    for i in range(_RANDOM):
        stops = rng.uniform(low, high, rng.integers(2, 8))
        out[f"random {i + 1}"] = np.interp(time, np.linspace(0.0, time[-1], stops.size), stops)
    ways = np.array([np.full(time.size, low), np.full(time.size, high), *chased.values()])
    for i in range(_DWELLING):
        changes = np.sort(rng.uniform(0.0, time[-1], rng.integers(1, 8)))
        chosen = rng.integers(0, len(ways), changes.size + 1)
        turn = chosen[np.searchsorted(changes, time)]
        out[f"dwelling {i + 1}"] = ways[turn, np.arange(time.size)]
    return out


def _worth(judge: PathObjective, track: PathSpace, control: Array, wear: float) -> float:
    return judge.value(track.places(control)) + wear * _mean_square_speed(track, control)[0]


def _mean_square_speed(track: PathSpace, control: Array) -> tuple[float, Array]:
    """Mean square speed of a path at its knots, and its slope (T + 2,) by the control points."""
    speed = np.diff(control) / track.step
    slope = np.zeros(control.size)
    slope[1:] += speed
    slope[:-1] -= speed
    return float(np.mean(speed**2)), slope * 2.0 / (track.step * speed.size)


def _searched(
    judge: PathObjective,
    track: PathSpace,
    paths: Array,
    values: list[float],
    wear: float,
    tried: int,
    iterations: int,
) -> tuple[Array, float]:
    """The best path found from starts (S, T + 2), and its value."""
    order = np.argsort(values)
    centre, apart = _middle(track), _ALIKE * (track.upper - track.lower)
    found = [(paths[order[0]], values[order[0]])]
    found += [
        _improve(judge, track, path, centre, wear, max(1, iterations // _BRIEFLY))
        for path in _different(paths[order], apart, tried)
    ]
    found.append(_improve(judge, track, _best(found)[0], centre, wear, iterations))
    return _best(found)


def _best(found: Sequence[tuple[Array, float]]) -> tuple[Array, float]:
    return min(found, key=lambda f: f[1])


def _different(paths: Array, apart: float, count: int) -> list[Array]:
    """The first so many of paths (S, T + 2) that are as far `apart` in the root mean square."""
    kept: list[Array] = []
    for path in paths:
        if len(kept) < count and all(np.mean((path - p) ** 2) > apart**2 for p in kept):
            kept.append(path)
    return kept


def _improve(
    judge: PathObjective,
    track: PathSpace,
    control: Array,
    centre: Array,
    wear: float,
    iterations: int,
) -> tuple[Array, float]:
    """A better path from one that keeps the limits, with its value; `centre` keeps them easily."""
    inside = strictly_inside(control[2:-1], centre[2:-1], track.body, _DRAWN)
    if inside is None:
        return control, np.inf

    def value(free: Array) -> tuple[float, Array]:
        whole = track.whole(free)
        worth, slope = judge(track.places(whole))
        swift, by_control = _mean_square_speed(track, whole)
        return worth + wear * swift, track.free(track.slope(slope) + wear * by_control)

    free, best = descend(value, inside, track.body, iterations)
    return track.whole(free), best


def _middle(track: PathSpace) -> Array:
    """A path (T + 2,) that keeps all limits with something to spare: gently to the middle."""
    room = 0.02 * (track.upper - track.lower)
    aim = np.clip(track.start, track.lower + 5 * room, track.upper - 5 * room)
    for ease in (0.5, 0.9, 0.99):
        try:
            gentle = PathSpace(
                track.lower, track.upper, ease * track.speed, ease * track.acceleration,
                track.step, track.steps, track.start, track.start_speed,
            )  # fmt: skip
        except GlissandoError:
            continue
        return gentle.follow(np.full(track.steps + 2, aim))
    return track.follow(np.full(track.steps + 2, aim))
