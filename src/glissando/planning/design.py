"""Design study of a sliding sensor: uncertainty over stroke, speed, rate and number of coils."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.planning.compare import evaluate_path
from glissando.planning.objectives import Objective
from glissando.planning.path_objective import path_objective_of
from glissando.planning.path_space import PathSpace
from glissando.planning.plan_slide import plan_slide
from glissando.planning.planning_problem import PlanningProblem, predict_information
from glissando.planning.sliding_sensor import sliding_sensor
from glissando.planning.zones import Zone

_ALIKE = 1.02  # ratio of two standard deviations that count as equal
NUMBERS = {"stroke": ("mm", 1e3), "speed": ("mm/s", 1e3), "rate": ("Hz", 1.0), "coils": ("", 1.0)}
"""Parameters of a design with their display unit, and the factor from SI units to it."""

_APART = 1e-3  # m, least distance of two coils that count as distinct


@dataclass(frozen=True)
class Design:
    """A slide with its sensor, and the uncertainty after its best path.

    Attributes:
        stroke: Stroke, m.
        speed: Largest speed, m/s.
        rate: Sampling rate of each coil, Hz.
        coils: Number of coils.
        value: Value of the objective over all zones, by the same model as `std`.
        std: Root of the mean position variance in each zone (Z,), m.
    """

    stroke: float
    speed: float
    rate: float
    coils: int
    value: float
    std: tuple[float, ...]


def sweep(
    robot: Robot,
    zones: Sequence[Zone],
    *,
    strokes: Sequence[float],
    speeds: Sequence[float],
    rates: Sequence[float],
    coils: Sequence[int],
    acceleration: float,
    upper: float,
    objective: Objective,
    horizon: float = 10.0,
    stream: str = "coil",
) -> Iterator[Design]:
    """Evaluate every combination of the parameters, each on its own best path.

    Several coils are spaced by one stroke, or evenly over the rest of the body if it is shorter.
    Combinations whose coils would coincide, as with a stroke of the whole body, are skipped.

    Args:
        robot: The robot.
        zones: Zones of interest.
        strokes: Strokes, m.
        speeds: Largest speeds, m/s.
        rates: Sampling rates of each coil, Hz.
        coils: Numbers of coils.
        acceleration: Largest acceleration, m/s².
        upper: Largest arclength of the first coil, where each path starts, m.
        objective: Objective over the zones.
        horizon: Duration of a path, s.
        stream: Name of the sensors' stream, by which sensor parameters refer to them.

    Raises:
        GlissandoError: A stroke is longer than the body, or no combination fits on it.
    """
    for stroke in strokes:
        if not 0.0 < stroke <= upper + 1e-9:
            raise GlissandoError(f"A stroke of {stroke:g} m does not fit a body of {upper:g} m.")
    pairs = itertools.product(strokes, coils)
    fitting = [(*p, spacing) for p in pairs if (spacing := _spacing(*p, upper)) >= _APART]
    if not fitting:
        raise GlissandoError(
            f"No design has room for {', '.join(map(str, coils))} coils behind each other; give "
            f"fewer, or shorter strokes."
        )
    for (stroke, count, spacing), rate in itertools.product(fitting, rates):
        sensor = sliding_sensor(robot, rate=rate, coils=count, spacing=spacing, name=stream)
        lower = upper - stroke
        problem = predict_information(robot, (lower, upper), horizon, sensor)
        path_objective = path_objective_of(problem, zones, objective)
        for speed in speeds:
            path_space = PathSpace(
                lower, upper, speed, acceleration, problem.step, problem.steps, start=upper
            )
            plan = plan_slide(path_objective, path_space, zones)
            value, std = _evaluated(problem, zones, objective, plan.arclength)
            yield Design(stroke, speed, rate, count, value, std)


def _evaluated(
    problem: PlanningProblem, zones: Sequence[Zone], objective: Objective, arclength: Array
) -> tuple[float, tuple[float, ...]]:
    """Objective of all zones and the deviation in each, of one path by the full model."""
    prediction = problem.predict(arclength)
    full = [
        evaluate_path(problem, part, objective, arclength, prediction)
        for part in (zones, *([zone] for zone in zones))
    ]
    return full[0].value, tuple(each.std for each in full[1:])


def _spacing(stroke: float, count: int, upper: float) -> float:
    """Distance between neighbouring coils, m; `upper` for a single coil."""
    return min(stroke, (upper - stroke) / (count - 1)) if count > 1 else upper


def pareto_front(designs: Sequence[Design]) -> NDArray[np.bool_]:
    """Mask (D,) of the designs on the Pareto front of cost and uncertainty.

    The cost is stroke, speed and number of coils; the uncertainty is the root mean square of `std`
    over the zones. A design is dominated by one that costs no more and is less uncertain, or that
    costs less in one of the three, no more in the others, and is as certain within 2 %.
    """
    cost = np.array([[d.stroke, d.speed, d.coils] for d in designs], dtype=float)
    std = np.sqrt(np.mean(np.array([d.std for d in designs]) ** 2, axis=1))
    no_dearer = np.all(cost[:, None] <= cost, axis=2)
    cheaper = no_dearer & np.any(cost[:, None] < cost, axis=2)
    beaten = (cheaper & (std[:, None] <= _ALIKE * std)) | (no_dearer & (std[:, None] < std))
    return np.asarray(~np.any(beaten, axis=0))
