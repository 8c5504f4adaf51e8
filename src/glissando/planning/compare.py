"""A plan beside paths that know nothing: what each is foretold to leave uncertain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.slide_path import SlideLimits, SlidePath
from glissando.planning.objectives import Objective
from glissando.planning.planning_problem import PlanningProblem
from glissando.planning.prediction import PredictedInformation
from glissando.planning.zones import Zone, zone_points

_TURNS = 6  # stops of a random path


@dataclass(frozen=True)
class Foretold:
    """What the estimator will say of the zones after a path (T,), at full size.

    `value` by the objective; `std` the root of the mean position variance, and `worst` the largest
    such root of any point, metres.
    """

    arclength: Array
    value: float
    std: float
    worst: float

    def as_json(self) -> dict[str, float]:
        """Its numbers."""
        return {"value": self.value, "std": self.std, "worst": self.worst}


def baseline_paths(
    limits: SlideLimits, upper: float, start: float, time: Array, seed: int = 0
) -> dict[str, Array]:
    """Arclengths (T,) at times (T,) from the start: oscillating from there, fixed there, random.

    The sensor is at `upper` metres when drawn out, at `start` in the beginning.
    """
    last, at = float(time[-1]), upper - start
    way = limits.stroke / limits.speed + limits.speed / limits.acceleration
    ends = [0.0 if at > 0.5 * limits.stroke else limits.stroke]
    while len(ends) * way < last + way:
        ends.append(limits.stroke - ends[-1])
    rng = np.random.default_rng(seed)
    stops = [at, *rng.uniform(0.0, limits.stroke, max(_TURNS, len(ends)))]
    speed = float(np.clip(np.abs(np.diff(stops)).sum() / last, 1e-4, limits.speed))
    paths = {
        "oscillating": SlidePath.moves([at, *ends], limits),
        "fixed": SlidePath.hold(at, last, limits),
        "random": SlidePath.moves(stops, limits, speed=speed),
    }
    return {name: upper - path.at(time) for name, path in paths.items()}


def evaluate_path(
    outlook: PlanningProblem, zones: Sequence[Zone], objective: Objective, arclength: Array
) -> Foretold:
    """What is foretold after a path (T,) of the outlook's steps."""
    return _judged(outlook, outlook.told(arclength), zones, objective, arclength)


def everywhere(outlook: PlanningProblem, zones: Sequence[Zone], objective: Objective) -> Foretold:
    """What a sensor at every place at once would leave: no path can do better.

    Coils a quarter of a node apart, or at both ends and the middle of a shorter reach, read at full
    rate.
    """
    low, high = outlook.lattice[0], outlook.lattice[-1]
    apart = 0.25 * float(np.diff(outlook.ahead.grid.arclength).min())
    places = np.linspace(low, high, max(3, 1 + int(np.ceil((high - low) / apart))))
    known = outlook.ahead
    for place in places:
        known = outlook.told(np.full(outlook.steps, place), known)
    return _judged(outlook, known, zones, objective, places)


def _judged(
    outlook: PlanningProblem,
    known: PredictedInformation,
    zones: Sequence[Zone],
    objective: Objective,
    path: Array,
) -> Foretold:
    length, span = float(known.grid.arclength[-1]), (outlook.start, outlook.last)
    place, time, weight = zone_points(zones, outlook.middles, span, length)
    cov = known.cov_pose(place, time)
    variance = np.einsum("zii->z", cov[:, :3, :3])
    value = objective(cov[:, : objective.rows, : objective.rows], weight)[0]
    return Foretold(path, value, float(np.sqrt(weight @ variance)), float(np.sqrt(variance.max())))
