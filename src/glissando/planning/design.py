"""What a sliding sensor is worth before it is built: stroke, speed, rate and number of coils."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glissando.errors import GlissandoError
from glissando.model.robot import Robot
from glissando.planning.compare import evaluate_path
from glissando.planning.objectives import Objective, Trace
from glissando.planning.path_objective import judge_of
from glissando.planning.path_space import PathSpace
from glissando.planning.plan_slide import plan_slide
from glissando.planning.planning_problem import predict_information
from glissando.planning.sliding_sensor import sliding_sensor
from glissando.planning.zones import Zone

_ALIKE = 1.02  # two confidences this near are the same
NUMBERS = {"stroke": ("mm", 1e3), "speed": ("mm/s", 1e3), "rate": ("Hz", 1.0), "coils": ("", 1.0)}
"""Numbers of a design with the unit they are shown in, and how many of it the SI unit is."""


@dataclass(frozen=True)
class Design:
    """A slide of `stroke` m and `speed` m/s, read at `rate` Hz, with so many `coils`.

    `std` (Z,) is the root of the mean position variance in each zone on its best path, metres, and
    `value` that of the objective.
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
    horizon: float = 10.0,
    spacing: float | None = None,
    objective: Objective | None = None,
) -> Iterator[Design]:
    """Every design of these, each judged on its own best path from the drawn-out end, in order.

    Coils follow each other at `spacing` metres, by default a stroke apart or as near as the body
    makes them be; the mean variance counts unless another `objective` does. Raises GlissandoError
    for a stroke longer than the body.
    """
    objective = Trace() if objective is None else objective
    for stroke, count, rate in itertools.product(strokes, coils, rates):
        if not 0.0 < stroke <= upper + 1e-9:
            raise GlissandoError(f"A stroke of {stroke:g} m does not fit a body of {upper:g} m.")
        apart = 0.0
        if count > 1:
            most = (upper - stroke) / (count - 1)
            apart = min(most, stroke if spacing is None else spacing)
        sensor = sliding_sensor(robot, rate=rate, coils=count, spacing=apart)
        outlook = predict_information(robot, (upper - stroke, upper), horizon, sensor)
        judge = judge_of(outlook, zones, objective)
        for speed in speeds:
            track = PathSpace(
                upper - stroke, upper, speed, acceleration, outlook.step, outlook.steps, upper
            )  # fmt: skip
            plan = plan_slide(judge, track, zones)
            told = [evaluate_path(outlook, [zone], objective, plan.arclength).std for zone in zones]
            yield Design(stroke, speed, rate, count, plan.value, tuple(told))


def pareto_front(designs: Sequence[Design]) -> NDArray[np.bool_]:
    """Which designs (D,) are worth what they cost: the Pareto front of costs and confidence.

    Not one that another is as sure as within 2 %, over all zones, for less of a stroke, speed or
    number of coils and no more of the others; nor one that is less sure for the same.
    """
    cost = np.array([[d.stroke, d.speed, d.coils] for d in designs], dtype=float)
    std = np.sqrt(np.mean(np.array([d.std for d in designs]) ** 2, axis=1))
    no_dearer = np.all(cost[:, None] <= cost, axis=2)
    cheaper = no_dearer & np.any(cost[:, None] < cost, axis=2)
    beaten = (cheaper & (std[:, None] <= _ALIKE * std)) | (no_dearer & (std[:, None] < std))
    return np.asarray(~np.any(beaten, axis=0))
