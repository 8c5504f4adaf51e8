"""Evaluation of paths by the covariance that the estimator will report, and baseline paths."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.slide_path import SlideLimits, SlidePath
from glissando.planning.objectives import Objective
from glissando.planning.path_objective import PathObjective
from glissando.planning.plan_slide import Plan
from glissando.planning.planning_problem import PlanningProblem
from glissando.planning.prediction import PredictedInformation
from glissando.planning.zones import Zone, zone_points

_STOPS = 6  # stops of a random path, at least


@dataclass(frozen=True)
class PathEvaluation:
    """Uncertainty of the zones after a path, as the estimator will report it.

    Attributes:
        arclength: Arclengths (T,) of the path, m.
        value: Value of the objective.
        std: Root of the mean position variance, m.
        worst: Root of the largest position variance of any point, m.
    """

    arclength: Array
    value: float
    std: float
    worst: float


def baseline_paths(
    limits: SlideLimits, upper: float, start: float, time: Array, seed: int = 0
) -> dict[str, Array]:
    """Baseline paths that ignore the zones: oscillating, fixed at the start, and random.

    Args:
        limits: Limits of the stage.
        upper: Arclength of the sensor at zero displacement of the stage, m.
        start: Initial arclength of the sensor, m.
        time: Times (T,) from the start, s.
        seed: Seed of the random stops.

    Returns:
        Arclengths (T,) by name, m.
    """
    last, displacement = float(time[-1]), upper - start
    duration = limits.stroke / limits.speed + limits.speed / limits.acceleration
    ends = [0.0 if displacement > 0.5 * limits.stroke else limits.stroke]
    while len(ends) * duration < last + duration:
        ends.append(limits.stroke - ends[-1])
    rng = np.random.default_rng(seed)
    stops = [displacement, *rng.uniform(0.0, limits.stroke, max(_STOPS, len(ends)))]
    speed = float(np.clip(np.abs(np.diff(stops)).sum() / last, 1e-4, limits.speed))
    paths = {
        "oscillating": SlidePath.moves([displacement, *ends], limits),
        "fixed": SlidePath.hold(displacement, last, limits),
        "random": SlidePath.moves(stops, limits, speed=speed),
    }
    return {name: upper - path.at(time) for name, path in paths.items()}


def evaluate_path(
    problem: PlanningProblem,
    zones: Sequence[Zone],
    objective: Objective,
    arclength: Array,
    prediction: PredictedInformation | None = None,
) -> PathEvaluation:
    """Evaluate a path by the estimator's full model, without model reduction.

    Args:
        problem: The planning problem.
        zones: Zones of interest.
        objective: Objective over the zones.
        arclength: Arclengths (T,) of the first coil at the problem's `times`, m.
        prediction: Information after the path; by default it is computed from the path.
    """
    prediction = prediction or problem.predict(arclength)
    length, span = float(prediction.grid.arclength[-1]), (problem.start, problem.end)
    place, time, weight = zone_points(zones, problem.zone_times, span, length)
    cov = prediction.cov_pose(place, time)
    variance = np.einsum("zii->z", cov[:, :3, :3])
    value = objective(cov[:, : objective.rows, : objective.rows], weight)[0]
    std, worst = float(np.sqrt(weight @ variance)), float(np.sqrt(variance.max()))
    return PathEvaluation(arclength, value, std, worst)


def best_evaluated(
    plan: Plan,
    path_objective: PathObjective,
    zones: Sequence[Zone],
    targets: Mapping[str, Array],
    speed_weight: float = 0.0,
    progress: Callable[[float, float], None] | None = None,
) -> Plan:
    """Best of a plan and of paths that follow targets, by the estimator's full model.

    The reduced model by which a plan is found errs by some per cent, which can reverse the order of
    two similar paths.

    Args:
        plan: The plan.
        path_objective: Objective by which it was planned.
        zones: Zones of interest.
        targets: Arclengths (T + 2,) at the path space's `control_times` by name, m.
        speed_weight: Weight of the mean square speed, as `plan_slide` takes it.
        progress: Called with the number of paths evaluated so far, and of all.

    Returns:
        The given plan, or a copy with the path that evaluates better.
    """
    space, problem = plan.path_space, path_objective.problem
    values = []
    controls = [plan.control, *space.follow(np.stack(list(targets.values())))]
    wear = [speed_weight * float(np.mean((np.diff(c) / space.step) ** 2)) for c in controls]
    for control in controls:
        path = space.arclength(control)
        values.append(evaluate_path(problem, zones, path_objective.objective, path).value)
        if progress:
            progress(len(values), len(controls))
    best = int(np.argmin(np.add(values, wear)))
    if best == 0:
        return plan
    path = space.arclength(controls[best])
    value = path_objective.value(path) + wear[best]
    return replace(plan, arclength=path, control=controls[best], value=value)


def evaluate_everywhere(
    problem: PlanningProblem, zones: Sequence[Zone], objective: Objective
) -> PathEvaluation:
    """Evaluate coils at every place at once, a lower bound on the uncertainty after any path.

    The coils are spaced a quarter of the smallest node distance (at least three over the reach) and
    read at full rate.
    """
    low, high = problem.reach
    spacing = 0.25 * float(np.diff(problem.ahead.grid.arclength).min())
    places = np.linspace(low, high, max(3, 1 + int(np.ceil((high - low) / spacing))))
    prediction = problem.ahead
    for place in places:
        prediction = problem.predict(np.full(problem.steps, place), prediction)
    return evaluate_path(problem, zones, objective, places, prediction)
