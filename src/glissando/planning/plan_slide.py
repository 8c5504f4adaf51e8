"""The best path of a sliding sensor: descent from the best of many different start paths."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

import numpy as np
from numpy.typing import ArrayLike

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError, PlanWarning
from glissando.estimation.given import require_kind
from glissando.geometry.se3 import Array
from glissando.model.short_repr import ShortRepr
from glissando.model.slide_path import SlideLimits, SlidePath
from glissando.planning.optimize import descend, is_inside
from glissando.planning.path_objective import PathObjective
from glissando.planning.path_space import PathSpace
from glissando.planning.zones import Zone

_RANDOM, _DWELLING = 4, 20  # number of random starts, and of random starts that dwell
_FLAT = 1e-9  # relative difference below which values of starts are equal
_ALIKE = 0.05  # RMS distance over the reach, below which two paths count as one start
_ITERATIONS, _STEPS = 12, 8  # least iterations for the best start; path steps per iteration
_BRIEFLY = 4  # factor by which the other starts have fewer iterations
_DRAWN = 0.1  # share of the way to the middle path by which a start is moved inside the limits


@dataclass(frozen=True)
class Plan(ShortRepr):
    """A planned path with its predicted value.

    Attributes:
        times: Midpoints (T,) of the steps in absolute time, s.
        arclength: Arclengths (T,) of the first coil at these times, m.
        control: Control points (T + 2,) of the path, m.
        path_space: Space from which the path was chosen.
        value: Value of the objective.
        starts: Value of every start by name.
    """

    times: Array
    arclength: Array
    control: Array
    path_space: PathSpace
    value: float
    starts: dict[str, float]

    @property
    def start(self) -> float:
        """Absolute time at which the plan begins, s."""
        return float(self.times[0] - self.path_space.times[0])

    def at(self, time: ArrayLike) -> tuple[Array, Array]:
        """Arclength (…), m, and speed (…), m/s, at absolute times (…), s; at rest after the end."""
        knots, place, speed = self.knots()
        elapsed = np.clip(np.asarray(time, dtype=float) - self.start, 0.0, knots[-1])
        k = np.minimum((elapsed / self.path_space.step).astype(np.intp), knots.size - 2)
        since = elapsed - knots[k]
        acceleration = (speed[k + 1] - speed[k]) / self.path_space.step
        place_now = place[k] + since * (speed[k] + 0.5 * acceleration * since)
        return place_now, speed[k] + acceleration * since

    def knots(self) -> tuple[Array, Array, Array]:
        """Times from the start, arclengths and speeds (T + 1,) at the knots of the path."""
        return self.path_space.knots(self.control)

    def slide_path(self, tip: float, limits: SlideLimits) -> SlidePath:
        """The path as displacements of the stage, which are zero at the arclength `tip`, m."""
        time, place, speed = self.knots()
        return SlidePath(time, tip - place, -speed, limits)


def plan_slide(
    objective: PathObjective,
    path_space: PathSpace,
    zones: Sequence[Zone] = (),
    *,
    speed_weight: float = 0.0,
    seed: int = 0,
    candidates: int = 5,
    iterations: int | None = None,
    warm_start: Array | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Plan:
    """Find the path of least value in a path space; the result is never worse than any start.

    Args:
        objective: Objective of a path.
        path_space: Admissible paths.
        zones: Zones in which further start paths are placed.
        speed_weight: Weight of the mean square speed, (s/m)² times the objective's unit.
        seed: Seed of the random starts.
        candidates: Number of distinct starts, the best ones, that are improved.
        iterations: Largest number of iterations for the best of these; by default it increases
            with the length of the path.
        warm_start: Control points (T + 2,) of a further start, m.
        progress: Called with the numbers of completed and of all iterations; iterations that a
            converged search does not need count as completed.

    Raises:
        GlissandoError: The steps of path space and planning problem differ, or the weight is
            negative or not finite.

    Warns:
        PlanWarning: All starts have the same value.
    """
    _require_plannable(objective, path_space, speed_weight)
    targets = starts(path_space, zones, objective.problem.start, seed)
    if warm_start is not None:
        targets["warm start"] = warm_start
    paths = path_space.follow(np.stack(list(targets.values())))
    if iterations is None:
        iterations = max(_ITERATIONS, path_space.steps // _STEPS)
    search = _Search(objective, path_space, speed_weight, progress)
    with one_thread():
        values = [search.value(path) for path in paths]
        _warn_of_flat(values)
        ranked = [(paths[i], values[i]) for i in np.argsort(values)]
        control, value = search.best_from(ranked, candidates, iterations)
    return Plan(
        objective.problem.times, path_space.arclength(control), control, path_space, float(value),
        dict(zip(targets, map(float, values), strict=True)),
    )  # fmt: skip


def _require_plannable(
    objective: PathObjective, path_space: PathSpace, speed_weight: float
) -> None:
    """Raise GlissandoError unless objective and path space have the same steps."""
    require_kind(objective, PathObjective, "objective of a path", "give path_objective_of(…)")
    require_kind(path_space, PathSpace, "path space", "give path_space_of(…)")
    problem = objective.problem
    if (path_space.steps, path_space.step) != (problem.steps, problem.step):
        raise GlissandoError(
            f"The path space has {path_space.steps} steps of {path_space.step:g} s and the problem "
            f"{problem.steps} of {problem.step:g} s; give both the same."
        )
    if not 0.0 <= speed_weight < np.inf:
        raise GlissandoError(
            f"A speed's weight of {speed_weight:g} cannot be; give 0 or more, finite."
        )


def starts(
    path_space: PathSpace, zones: Sequence[Zone], begin: float, seed: int
) -> dict[str, Array]:
    """Target arclengths (T + 2,) of the start paths by name, m.

    The targets are fixed, in the zones, oscillating or sweeping over the reach, random, and
    switching at random times between both ends and the zones. The horizon begins at `begin`, s.
    """
    low, high = path_space.lower, path_space.upper
    time, stroke = path_space.control_times, high - low
    out = {
        f"fixed at {1e3 * place:.4g} mm": np.full(time.size, place)
        for place in (path_space.start, low, 0.5 * (low + high), high)
    }
    in_zones = [0.5 * np.add(*zone.ends(time + begin)) for zone in zones]
    out |= {f"in zone {i + 1}": place for i, place in enumerate(in_zones)}
    for part in (1.0, 0.5, 0.25):
        speed = part * path_space.speed
        turns = time * speed / (2.0 * stroke) + 0.5 * (high - path_space.start) / stroke
        place = low + 2.0 * stroke * np.abs(turns % 1.0 - 0.5)
        out[f"oscillating at {1e3 * speed:.3g} mm/s"] = place
    out["sweeping out"] = np.linspace(low, high, time.size)
    out["sweeping in"] = np.linspace(high, low, time.size)
    rng = np.random.default_rng(seed)
    for i in range(_RANDOM):
        stops = rng.uniform(low, high, rng.integers(2, 8))
        out[f"random {i + 1}"] = np.interp(time, np.linspace(0.0, time[-1], stops.size), stops)
    places = np.array([np.full(time.size, low), np.full(time.size, high), *in_zones])
    for i in range(_DWELLING):
        changes = np.sort(rng.uniform(0.0, time[-1], rng.integers(1, 8)))
        chosen = rng.integers(0, len(places), changes.size + 1)
        turn = chosen[np.searchsorted(changes, time)]
        out[f"dwelling {i + 1}"] = places[turn, np.arange(time.size)]
    return out


def _warn_of_flat(values: Sequence[float]) -> None:
    """Warn if all starts have the same value, for instance a probability of 0 or 1."""
    if len(values) > 1 and np.ptp(values) <= _FLAT * max(map(abs, values)):
        warnings.warn(
            f"Every path has the value {values[0]:.3g}, so none is better than another: give an "
            f"objective that varies, of a chance a bound in metres near the error.",
            PlanWarning,
            stacklevel=3,
        )


@dataclass(frozen=True)
class _Search:
    """Search for the path of least objective plus weighted mean square speed."""

    objective: PathObjective
    path_space: PathSpace
    speed_weight: float
    progress: Callable[[float, float], None] | None = None

    def value(self, control: Array) -> float:
        """Value of a path with control points (T + 2,)."""
        value = self.objective.value(self.path_space.arclength(control))
        return value + self.speed_weight * self._mean_square_speed(control)[0]

    def best_from(
        self, ranked: Sequence[tuple[Array, float]], candidates: int, iterations: int
    ) -> tuple[Array, float]:
        """Improve the best distinct starts briefly, then the best result; returns path and value.

        Args:
            ranked: Control points (T + 2,) of starts with their values, the best first.
            candidates: Number of starts that are improved.
            iterations: Largest number of iterations for the best of these.
        """
        distance = _ALIKE * (self.path_space.upper - self.path_space.lower)
        briefly = max(1, iterations // _BRIEFLY)
        paths = _distinct([path for path, _ in ranked], distance, candidates)
        best, before, total = ranked[0], 0, len(paths) * briefly + iterations

        def shown(done: int) -> None:
            if self.progress:
                self.progress(before + done, total)

        for path in paths:
            best = min(best, self.improve(path, briefly, shown), key=itemgetter(1))
            before += briefly
        return min(best, self.improve(best[0], iterations, shown), key=itemgetter(1))

    def improve(
        self, control: Array, iterations: int, progress: Callable[[int], None]
    ) -> tuple[Array, float]:
        """Path found by descent from one within the limits, and its value.

        The value is infinite if no start strictly inside the limits is found.
        """
        space, middle = self.path_space, self._middle_path[2:-1]

        def value(free: Array) -> tuple[float, Array]:
            control = space.control(free)
            value, by_place = self.objective(space.arclength(control))
            square, by_control = self._mean_square_speed(control)
            gradient = space.free_gradient(by_place, self.speed_weight * by_control)
            return value + self.speed_weight * square, gradient

        inside = control[2:-1] + _DRAWN * (middle - control[2:-1])
        if not is_inside(inside, space.polytope):
            return control, np.inf
        free, best = descend(value, inside, space.polytope, iterations, progress=progress)
        return space.control(free), best

    def _mean_square_speed(self, control: Array) -> tuple[float, Array]:
        """Mean square speed of a path at its knots, and its gradient (T + 2,)."""
        speed = np.diff(control) / self.path_space.step
        gradient = np.zeros(control.size)
        gradient[1:] += speed
        gradient[:-1] -= speed
        return float(np.mean(speed**2)), gradient * 2.0 / (self.path_space.step * speed.size)

    @cached_property
    def _middle_path(self) -> Array:
        """Path (T + 2,) strictly inside all limits: slowly away from the ends of the slide."""
        space = self.path_space
        room = 0.1 * (space.upper - space.lower)
        target = np.clip(space.start, space.lower + room, space.upper - room)
        for ease in (0.5, 0.9, 0.99, 1.0):
            with suppress(GlissandoError):
                space = replace(
                    space, speed=ease * space.speed, acceleration=ease * space.acceleration
                )
                break
        return space.follow(np.full(space.steps + 2, target))


def _distinct(paths: Sequence[Array], distance: float, count: int) -> list[Array]:
    """The first `count` paths whose pairwise RMS distance exceeds `distance`, m."""
    distinct: list[Array] = []
    for path in paths:
        if len(distinct) < count and all(np.mean((path - p) ** 2) > distance**2 for p in distinct):
            distinct.append(path)
    return distinct
