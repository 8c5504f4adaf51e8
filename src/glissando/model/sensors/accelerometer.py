"""Accelerometers: acceleration less gravity, in the sensor's own frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from glissando.errors import SensorError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, POSE, VELOCITY, AcceleratedState, State

_HEAVIEST = 30.0  # m/s², above which a unit is wrong
_R, _W = slice(POSE.start + 3, POSE.stop), slice(VELOCITY.start + 3, VELOCITY.stop)


@dataclass(frozen=True, kw_only=True)
class AccelerometerReadings(Readings, kind="accelerometer"):
    """Specific force in the sensor's own frame: `values` (M, 3) in m/s². Source: (33).

    At rest it is the reaction to gravity, which depends on the tilt. Estimators pass states with
    acceleration; for a state without it the residual is zero, and readings have no effect.

    Attributes:
        gravity: Acceleration of free fall (3,) in the world, m/s².
        span: Averaging time of a reading (1,), s. With a prior whose acceleration is white noise,
            readings are the more uncertain the shorter it is.
    """

    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    span: Array = field(default_factory=lambda: np.full(1, 0.01))

    rows: ClassVar[int] = 3
    columns: ClassVar[Mapping[str, str]] = dict.fromkeys(("fx", "fy", "fz"), "m/s²")
    optional_settings: ClassVar[Mapping[str, str]] = {"gravity": "m/s²", "span": "s"}
    value_shape: ClassVar[tuple[int, ...] | None] = (3,)
    accelerates: ClassVar[bool] = True

    @property
    def expected_shape(self) -> tuple[int, ...]:
        """(3,): three forces. Raises SensorError for an impossible gravity or span."""
        gravity, span = np.asarray(self.gravity, float), np.atleast_1d(np.asarray(self.span, float))
        if gravity.shape != (3,) or not np.linalg.norm(gravity) <= _HEAVIEST:
            raise SensorError(
                f"{self.label}: gravity is {gravity}; give three numbers in m/s², "
                f"[0, 0, -9.81] where z points up."
            )
        if span.shape != (1,) or not 0.0 < span[0] <= 1.0:
            raise SensorError(f"{self.label}: span is {span}; give seconds, above 0 and up to 1.")
        object.__setattr__(self, "gravity", gravity)
        object.__setattr__(self, "span", span)
        return (3,)

    def residual(self, at: State) -> Array:
        """R_bcᵀ (a − Rᵀ g + ω̇ × r + ω × (ω × r)), minus the reading."""
        if not isinstance(at, AcceleratedState):
            return np.zeros((len(self), 3))
        place, spin = self.mount[..., :3, 3], at.velocity[..., 3:]
        force = at.acceleration[..., :3] - self._weight(at)
        force = force + np.cross(at.acceleration[..., 3:], place)
        force += np.cross(spin, np.cross(spin, place))
        return np.einsum("...ji,...j->...i", self.mount[..., :3, :3], force) - self.values

    def jacobian(self, at: State) -> Array:
        """∂residual/∂[pose, strain, velocity, acceleration] (M, 3, 24)."""
        if not isinstance(at, AcceleratedState):
            return np.zeros((len(self), 3, DOF))
        lever, spin = se3.hat3(self.mount[..., :3, 3]), at.velocity[..., 3:]
        slope = np.zeros((len(self), 3, DOF + 6))
        slope[..., _R] = -se3.hat3(self._weight(at))
        slope[..., _W] = -se3.hat3(np.cross(spin, self.mount[..., :3, 3])) - se3.hat3(spin) @ lever
        slope[..., DOF : DOF + 3] = np.eye(3)
        slope[..., DOF + 3 :] = -lever
        return np.swapaxes(self.mount[..., :3, :3], -1, -2) @ slope

    def _weight(self, at: State) -> Array:
        return np.einsum("...ji,j->...i", at.pose[..., :3, :3], self.gravity)
