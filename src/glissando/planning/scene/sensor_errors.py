"""What is unknown of a scene's sensors: numbers beside the model error by which all readings err.

A mount that is a little off, or that drifts, is no noise: readings repeat it. Its numbers ζ of unit
variance, each a stationary Gauss–Markov process or a constant, are estimated with the model error,
so a plan counts on no more than readings can tell of the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.noise import sqrt_information
from glissando.model.robot import Robot
from glissando.model.sensors.parameter_jacobians import by_parameters
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.planning.sliding_sensor import SlidingSensor


@dataclass(frozen=True)
class SensorErrors:
    """Sensor parameters that are estimated beside a model error, m numbers together.

    Attributes:
        parameters: They, none of which says where or when readings were taken.
        stated: All of the sensors, also those that are known, or left out.
        pose: Pose (4, 4) of the body at which their slopes are taken for readings to come.
    """

    parameters: tuple[SensorParameter, ...] = ()
    stated: tuple[SensorParameter, ...] = ()
    pose: Array | None = None

    @property
    def std(self) -> Array:
        """Standard deviations (m,)."""
        return np.concatenate([np.zeros(0), *(p.std for p in self.parameters)])

    @property
    def time_scale(self) -> Array:
        """How long each number lasts (m,), s; infinite if it is constant."""
        each = (np.full(p.std.size, p.correlation_time) for p in self.parameters)
        return np.concatenate([np.zeros(0), *each])

    def rows(self, sensor: SlidingSensor, time: float) -> tuple[Array, Array]:
        """Whitened rows of a coil by its pose (r, 6) and by ζ (r, m).

        They are worth all its readings of a time in seconds.
        """
        pose = np.eye(4) if self.pose is None else self.pose
        readings = sensor.readings(pose[None], np.zeros(1), np.zeros(1))
        at = State(pose[None], np.zeros((1, 6)), np.zeros((1, 6)))
        by_state = readings.jacobian(at)
        white = np.sqrt(sensor.rate * time) * sqrt_information(readings.cov)
        return white @ by_state[0, :, :6], white @ self.slopes(readings, at, by_state)[0]

    def slopes(self, readings: Readings, at: State, by_state: Array) -> Array:
        """Slopes (M, r, m) of residuals by ζ, of readings at states (M,).

        Args:
            readings: The readings as expected, see `expected`.
            at: The states.
            by_state: Slopes (M, r, 18) of the residuals by them.
        """
        out, ends = np.zeros((*by_state.shape[:2], self.std.size)), [0]
        for each in self.parameters:
            ends.append(ends[-1] + each.std.size)
        own = [k for k, each in enumerate(self.parameters) if readings.name in each.streams]
        pairs = [
            (each, np.tile(each.value, (len(readings), 1)))
            for each in (self.parameters[k] for k in own)
        ]
        slopes = by_parameters(readings, readings, at, by_state, pairs) if pairs else []
        for k, slope in zip(own, slopes, strict=True):
            out[..., ends[k] : ends[k + 1]] = slope * self.parameters[k].std
        return out

    def expected(self, readings: Readings) -> Readings:
        """What a sensor gave, with every parameter of its own at its expected value."""
        return corrected(readings, self.stated)


def sensor_errors(
    sensors: Sequence[SlidingSensor], robot: Robot, pose: Array
) -> tuple[SensorErrors, list[str]]:
    """What is unknown of a scene's sensors, and names of parameters that cannot be counted.

    Args:
        sensors: The sensors.
        robot: The robot, with its sensor parameters.
        pose: Pose (4, 4) of the body at which slopes are taken.
    """
    streams = {sensor.name for sensor in sensors}
    stated = tuple(p for p in robot.sensor_parameters if streams & set(p.streams))
    unknown = [p for p in stated if not p.known]
    counted = tuple(replace(p, streams=tuple(streams & set(p.streams))) for p in unknown
                    if not p.moves)  # fmt: skip
    return SensorErrors(counted, stated, pose), [p.name for p in unknown if p.moves]
