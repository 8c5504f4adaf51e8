"""The sliding sensor: kind, noise and rate of its readings, number and spacing of its coils."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from glissando.errors import GlissandoError, RobotFileError
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.model.sensors.readings import SENSORS, Readings
from glissando.model.sensors.sensors import sensor_class

_FASTEST = 10_000.0  # Hz, largest sampling rate


def _sliding_kinds() -> list[str]:
    """Kinds of sensors that implement `values_at`, their values at a pose."""
    return [
        kind
        for kind, sensor in SENSORS.items()
        if any("values_at" in vars(base) for base in sensor.__mro__ if base is not Readings)
    ]


@dataclass(frozen=True)
class SlidingSensor:
    """The coils on the slide, all of one kind.

    Attributes:
        cov: Covariance of a reading, as `Readings` take it.
        rate: Sampling rate of each coil, Hz.
        kind: Kind of the readings, for instance coil, pose or position.
        coils: Number C of coils; the arclength of a path is that of the first.
        spacing: Distance from each coil to the next one towards the base, m.
        name: Name of the sensor's stream, by which sensor parameters refer to it.
        mount: Pose (4, 4) of a coil in the body frame.
        arclength_std: Standard deviation of the arclength of a reading, m.
        settings: Fields that the class of readings declares as its settings.

    Raises:
        GlissandoError: Kind, rate, number or spacing are invalid, or a setting is missing.
    """

    cov: Array
    rate: float = 40.0
    kind: str = "coil"
    coils: int = 1
    spacing: float = 0.0
    name: str = "coil"
    mount: Array = field(default_factory=lambda: np.eye(4))
    arclength_std: float = 0.0
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cov", np.asarray(self.cov, dtype=float))
        if self.kind not in (kinds := _sliding_kinds()):
            raise GlissandoError(f"A {self.kind!r} cannot slide; choose one of {', '.join(kinds)}.")
        sensor = sensor_class(self.kind)
        needed = set(sensor.settings) - set(sensor.optional_settings)
        if missing := sorted(needed - set(self.settings)):
            raise GlissandoError(
                f"A {self.kind} has a {missing[0]} that is not given; give settings={{"
                f"'{missing[0]}': …}}."
            )
        if not self.rate > 0.0:
            raise GlissandoError(
                f"A sensor at {self.rate:g} Hz reads nothing; give a rate above 0."
            )
        if self.rate > _FASTEST:
            raise GlissandoError(
                f"A sensor at {self.rate:g} Hz cannot be planned; give {_FASTEST:g} Hz at most."
            )
        if self.coils < 1 or self.spacing < 0.0 or (self.coils > 1 and self.spacing == 0.0):
            raise GlissandoError(
                f"{self.coils} coils at {self.spacing:g} m cannot be; give 1 or more, apart."
            )

    @property
    def behind(self) -> Array:
        """Distances (C,) of the coils from the first one, towards the base, m."""
        return np.asarray(self.spacing * np.arange(self.coils))

    def reading_times(self, start: float, duration: float) -> Array:
        """Times (M,) of one coil's readings, evenly spread over `duration` s from `start`."""
        count = max(1, round(duration * self.rate))
        return np.asarray(start + (np.arange(count) + 0.5) * (duration / count))

    def readings(self, T_wb: Array, arclength: Array, time: Array) -> Readings:
        """Noise-free readings (M,) at poses (M, 4, 4) of the body, arclengths and times (M,)."""
        sensor = sensor_class(self.kind)
        return sensor(
            time=time, arclength=arclength,
            values=sensor.values_at(T_wb @ self.mount, **self.settings), cov=self.cov,
            mount=self.mount, name=self.name, arclength_std=self.arclength_std, **self.settings,
        )  # fmt: skip


def sliding_sensor(robot: Robot, kind: str = "coil", **options: Any) -> SlidingSensor:
    """Create a sliding sensor with the noise stated in the robot file.

    Args:
        robot: The robot.
        kind: Kind of the sensor's readings.
        **options: Further attributes of `SlidingSensor`.

    Raises:
        RobotFileError: The robot file states no noise of this kind of sensor.

    >>> from glissando import load_robot
    >>> sliding_sensor(load_robot("sliding700"), rate=20.0).rate
    20.0
    """
    if kind not in robot.sensor_std:
        raise RobotFileError(
            f"Robot {robot.name} states no noise of a {kind}; add [sensors.{kind}] with a std."
        )
    return SlidingSensor(robot.sensor_std[kind] ** 2, kind=kind, **options)
