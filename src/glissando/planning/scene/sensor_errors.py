"""Uncertain parameters of a scene's sensors, which are estimated jointly with the model error.

The error of a mount, constant or drifting, is not white noise: all readings share it. Sensor errors
ζ of unit variance, each a stationary Gauss–Markov process or a constant, are part of the filter's
state, so that a plan does not overestimate the information of readings about the body.
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
    """Sensor parameters that are estimated with a model error, m components in total.

    Attributes:
        parameters: Estimated parameters; none of them shifts arclengths or times of readings.
        stated: All parameters of the sensors, including known and neglected ones.
        pose: Pose (4, 4) of the body at which future readings are linearised; None for identity.
    """

    parameters: tuple[SensorParameter, ...] = ()
    stated: tuple[SensorParameter, ...] = ()
    pose: Array | None = None

    @property
    def std(self) -> Array:
        """Standard deviations (m,) of the parameters."""
        return np.concatenate([np.zeros(0), *(p.std for p in self.parameters)])

    @property
    def time_scale(self) -> Array:
        """Correlation times (m,) of the components, s; infinite for constants."""
        each = (np.full(p.std.size, p.correlation_time) for p in self.parameters)
        return np.concatenate([np.zeros(0), *each])

    def rows(self, sensor: SlidingSensor, time: float) -> tuple[Array, Array]:
        """Whitened rows of a coil by its pose (r, 6) and by ζ (r, m).

        They are scaled to the information of all readings in `time` seconds.
        """
        pose = np.eye(4) if self.pose is None else self.pose
        readings = sensor.readings(pose[None], np.zeros(1), np.zeros(1))
        at = State(pose[None], np.zeros((1, 6)), np.zeros((1, 6)))
        by_state = readings.jacobian(at)
        white = np.sqrt(sensor.rate * time) * sqrt_information(readings.cov)
        return white @ by_state[0, :, :6], white @ self.slopes(readings, at, by_state)[0]

    def slopes(self, readings: Readings, at: State, by_state: Array) -> Array:
        """Jacobians (M, r, m) of residuals by ζ, of readings at states (M,).

        Args:
            readings: Readings corrected by `expected`.
            at: The states.
            by_state: Jacobians (M, r, 18) of the residuals by the states.
        """
        out, ends = np.zeros((*by_state.shape[:2], self.std.size)), [0]
        for each in self.parameters:
            ends.append(ends[-1] + each.std.size)
        affecting = [k for k, each in enumerate(self.parameters) if readings.name in each.streams]
        pairs = [
            (each, np.tile(each.value, (len(readings), 1)))
            for each in (self.parameters[k] for k in affecting)
        ]
        slopes = by_parameters(readings, readings, at, by_state, pairs) if pairs else []
        for k, slope in zip(affecting, slopes, strict=True):
            out[..., ends[k] : ends[k + 1]] = slope * self.parameters[k].std
        return out

    def expected(self, readings: Readings) -> Readings:
        """Raw readings corrected by the expected values of all sensor parameters."""
        return corrected(readings, self.stated)


def sensor_errors(
    sensors: Sequence[SlidingSensor], robot: Robot, pose: Array
) -> tuple[SensorErrors, list[str]]:
    """Uncertain parameters of a scene's sensors, and names of those that must be neglected.

    Parameters that shift arclengths or times of readings are neglected.

    Args:
        sensors: The sensors.
        robot: The robot, with its sensor parameters.
        pose: Pose (4, 4) of the body at which future readings are linearised.
    """
    streams = {sensor.name for sensor in sensors}
    stated = tuple(p for p in robot.sensor_parameters if streams & set(p.streams))
    unknown = [p for p in stated if not p.known]
    counted = tuple(replace(p, streams=tuple(streams & set(p.streams))) for p in unknown
                    if not p.moves)  # fmt: skip
    return SensorErrors(counted, stated, pose), [p.name for p in unknown if p.moves]
