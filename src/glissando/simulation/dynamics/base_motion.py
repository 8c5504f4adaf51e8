"""Motion of the base between poses, at rest at each pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.errors import SimulationError
from glissando.geometry import se3
from glissando.geometry.se3 import Array


@dataclass(frozen=True)
class BaseMotion:
    """Motion of the base between poses along screws, with the time profile 10 x³ − 15 x⁴ + 6 x⁵.

    Velocity and acceleration are zero at every pose and continuous everywhere.

    Attributes:
        time: Times (K,), s.
        pose: Poses T_wb (K, 4, 4) of the base at these times.

    Raises:
        SimulationError: Times do not increase, or are not one per pose.
    """

    time: Array
    pose: Array

    def __post_init__(self) -> None:
        if self.time.shape != (len(self.pose),) or np.any(np.diff(self.time) <= 0.0):
            raise SimulationError(
                f"The base's times are {self.time.tolist()}; give one a pose, that increase."
            )

    def at(self, time: float) -> tuple[Array, Array]:
        """Pose (4, 4) and rates (4, 3) at a time, s.

        Rates are velocity, angular velocity and their time derivatives in world axes.
        """
        last = self.time.size - 1
        k = int(np.clip(np.searchsorted(self.time, time, "right") - 1, 0, max(last - 1, 0)))
        rates = np.zeros((4, 3))
        if last == 0:
            return self.pose[0], rates
        span = self.time[k + 1] - self.time[k]
        x = float(np.clip((time - self.time[k]) / span, 0.0, 1.0))
        screw = se3.log(se3.inverse(self.pose[k]) @ self.pose[k + 1])
        share = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        speed = 30.0 * (x * (1.0 - x)) ** 2 / span
        gain = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / span**2
        pose = self.pose[k] @ se3.exp(share * screw)
        turn = pose[:3, :3]
        linear, angular = turn @ screw[:3], turn @ screw[3:]
        rates[0], rates[1] = speed * linear, speed * angular
        rates[2] = gain * linear + np.cross(rates[1], rates[0])
        rates[3] = gain * angular
        return pose, rates
