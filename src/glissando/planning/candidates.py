"""Candidate sensors for a robot: fixed sensors, a fibre along the body, a sliding coil."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import sensor_class
from glissando.planning.prediction import PredictedInformation
from glissando.solver.measurement_factors import states_at

_GRATINGS = 16  # number of gratings of a fibre along the body
_CORES = {"core_radius": np.full(3, 35e-6), "core_angle": 2.0 * np.pi * np.arange(3) / 3.0}
FIBRE, SLIDE = "fbg", "slide"
_WIDEST = 0.3  # rad, largest plausible standard deviation of a pose's angles
_LARGEST = {  # largest plausible standard deviation of a reading's first row, and its unit
    **dict.fromkeys(("coil", "pose", "position"), (0.05, "m")),
    "orientation": (1.0, "rad"),
    "gyro": (5.0, "rad/s"),
    "strain": (0.5, ""),
    FIBRE: (0.01, ""),
}


@dataclass(frozen=True)
class Candidate:
    """A sensor that could be bought.

    Attributes:
        name: Name shown in tables.
        kind: Kind of its readings.
        cost: Price, in any unit.
        cov: Covariance of a reading, as `Readings` take it.
        rate: Sampling rate, Hz.
        places: Maps times (M,), s, to arclengths (M, P) of its readings, m; P > 1 for a fibre.
        settings: Further fields of readings of this kind, such as a fibre's cores.
    """

    name: str
    kind: str
    cost: float
    cov: Array
    rate: float
    places: Callable[[Array], Array]
    settings: Mapping[str, Any] = field(default_factory=dict)

    def readings(self, ahead: PredictedInformation, time: Array) -> Readings:
        """Simulated readings at times (M,) of the expected motion, M · P of them.

        Their values are noise-free, or zero for sensors that are linear in the state.
        """
        places = self.places(time)
        place, when = places.ravel(), np.repeat(time, places.shape[1])
        sensor = sensor_class(self.kind)
        try:
            pose = states_at(ahead.prior, ahead.grid, ahead.mean, place, when).pose
            values = sensor.values_at(pose, **self.settings)
        except NotImplementedError:  # linear in strain or velocity: values do not alter Jacobians
            shape = sensor.value_shape or (np.size(self.settings["core_radius"]),)
            values = np.zeros((place.size, *shape))
        fields = {"values": values, "cov": self.cov, "name": self.name, **self.settings}
        return sensor(time=when, arclength=place, **fields)


def candidates_of(
    robot: Robot,
    kind: str,
    cost: float,
    *,
    std: Array | None = None,
    count: int = 15,
    rate: float = 40.0,
    slide: tuple[float, float, float] | None = None,
) -> list[Candidate]:
    """Candidates of one kind: fixed sensors at evenly spaced places, one fibre, or one slide.

    Args:
        robot: The robot, whose file states the noise of its sensors.
        kind: Kind of the readings; "fbg" is a fibre along the body, "slide" a sliding coil.
        cost: Price of one sensor.
        std: Standard deviation of the rows, one for all of them or, for a pose or coil, one of the
            position and one of the rotation; by default that of the robot file.
        count: Number of places for fixed sensors.
        rate: Sampling rate, Hz.
        slide: Lowest and highest arclength of the slide, m, and its speed, m/s.

    Raises:
        GlissandoError: The cost is not positive, the noise is unknown or implausible, the kind has
            no arclength to choose, or a slide is wanted and `slide` is None.
    """
    if not (np.isfinite(cost) and cost > 0.0):
        raise GlissandoError(f"A {kind} that costs {cost:g} cannot be; give a cost above 0.")
    reading_kind = "coil" if kind == SLIDE else kind
    sensor = sensor_class(reading_kind)
    if sensor.spans:
        raise GlissandoError(f"A {kind} reads the whole robot, and has no place to choose.")
    std_of_rows = robot.sensor_std.get(reading_kind) if std is None else std
    if std_of_rows is None:
        raise GlissandoError(
            f"Robot {robot.name} states no noise of a {reading_kind}; give {kind}=COST:STD, or add "
            f"[sensors.{reading_kind}] with a std to its file."
        )
    noise = _std(std_of_rows, reading_kind, 3 if kind == FIBRE else sensor.rows) ** 2
    if kind == SLIDE:
        if slide is None:
            raise GlissandoError("A slide needs a reach and a speed.")
        low, high, speed = slide
        swing = _oscillation(low, high, speed)
        return [Candidate(f"slide {_mm(low)}–{_mm(high)}", reading_kind, cost, noise, rate, swing)]
    if kind == FIBRE:
        nodes = np.linspace(0.0, robot.length, _GRATINGS)
        return [Candidate("fibre", reading_kind, cost, noise, rate, _fixed(nodes), _CORES)]
    places = np.linspace(robot.length / count, robot.length, count)
    return [
        Candidate(f"{kind} {_mm(s)}", reading_kind, cost, noise, rate, _fixed([s])) for s in places
    ]


def _std(value: Array, kind: str, rows: int) -> Array:
    """Standard deviations (rows,) of a reading; raises GlissandoError if they are implausible."""
    std, (most, unit) = np.atleast_1d(value), _LARGEST.get(kind, (np.inf, ""))
    if std.size == 2 and rows in (5, 6):
        std = np.repeat(std, 3)[:rows]
    likely = np.all(np.isfinite(std) & (std > 0.0)) and std[0] <= most
    if rows in (5, 6) and np.any(std[3:] > _WIDEST):
        raise GlissandoError(
            f"A {kind} with a standard deviation of {std[3:].max():g} rad is not likely: probably "
            f"degrees; give radians, up to {_WIDEST:g}."
        )
    if std.shape not in ((1,), (rows,)) or not likely:
        raise GlissandoError(
            f"A {kind} with a standard deviation of {', '.join(f'{x:g}' for x in std)} is not "
            f"likely; give one number above 0, or one for each of {rows} rows, up to {most:g} "
            f"{unit}".rstrip()
            + "."
        )
    return np.broadcast_to(std, (rows,))


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.0f} mm"


def _fixed(places: Any) -> Callable[[Array], Array]:
    row = np.asarray(places, dtype=float)
    return lambda time: np.broadcast_to(row, (time.size, row.size))


def _oscillation(low: float, high: float, speed: float) -> Callable[[Array], Array]:
    """Path of a slide that oscillates at constant speed, from the upper end."""

    def places(time: Array) -> Array:
        turns = speed * time / (high - low)
        return np.asarray(high - (high - low) * (1.0 - np.abs(1.0 - turns % 2.0)))[:, None]

    return places
