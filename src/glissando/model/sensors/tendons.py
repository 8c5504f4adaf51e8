"""Tendons as a sensor: displacements depend on the shape of the whole robot at one time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from glissando.errors import SensorError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.given_arrays import numbers
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, STRAIN, State
from glissando.model.tendons.channel import Channel

_A_TURN = 16.0  # places for each turn of a helical channel
_STRAIGHT = np.array([0.0, 0.0, 1.0])
_EACH = {"radius": "m", "angle": "rad", "end": "m"}
_MORE = {"pitch": "m", "slack": "m", "compliance": "m", "one_sided": "1"}


@dataclass(frozen=True, kw_only=True)
class TendonReadings(Readings, kind="tendon"):
    """Displacements of T tendons: `values` (M, T), or (M, 2 T) with their tensions. Source: (M5).

    A displacement, positive when pulled, is the shortening of the channel from the straight robot
    plus slack plus stretch. `arclength` is that of the end of the longest tendon. Tensions count
    as exact; without them stretch is part of the noise.

    Attributes:
        radius: Distance of each channel from the backbone (T,), m.
        angle: Angle of each channel in the cross-section of the base (T,), rad.
        end: Arclength at which each tendon is attached (T,), m.
        pitch: Metres for a whole turn (T,), zero for a straight channel.
        slack: Displacement at which each becomes taut in the straight robot (T,), m.
        compliance: Stretch per newton (T,), m/N; zero unless given.
        one_sided: Whether each (T,) may go slack: a reading is then only an upper bound of the
            channel's length.
    """

    radius: Array
    angle: Array
    end: Array
    pitch: Array = field(default_factory=lambda: np.zeros(1))
    slack: Array = field(default_factory=lambda: np.zeros(1))
    compliance: Array = field(default_factory=lambda: np.zeros(1))
    one_sided: Array = field(default_factory=lambda: np.zeros(1))

    rows: ClassVar[int] = 1  # in a file: one standard deviation for all tendons
    settings: ClassVar[Mapping[str, str]] = _EACH
    optional_settings: ClassVar[Mapping[str, str]] = _MORE
    mounted: ClassVar[bool] = False
    spans: ClassVar[bool] = True

    @classmethod
    def value_columns(cls, settings: Mapping[str, Array]) -> Mapping[str, str]:
        """One displacement a tendon, and one tension each where compliances are given."""
        count = np.size(settings["radius"])
        columns = {f"tendon_{j}": "m" for j in range(count)}
        if np.any(settings.get("compliance", 0.0)):
            columns |= {f"tension_{j}": "1" for j in range(count)}
        return columns

    @property
    def row_count(self) -> int:
        """One row a tendon."""
        return int(np.size(self.radius))

    @property
    def expected_shape(self) -> tuple[int, ...]:
        """One displacement a tendon, and one tension each if there are compliances.

        Raises:
            SensorError: Settings differ in number, or are out of range.
        """
        count = np.size(self.radius)
        for name in (*_EACH, *_MORE):
            value = np.atleast_1d(numbers(self.label, name, getattr(self, name)))
            if value.shape not in ((1,), (count,)):
                raise SensorError(
                    f"{self.label}: {name} has {value.size} numbers for {count} tendons; give one "
                    f"each."
                )
            least = {"end": 1e-6, "compliance": 0.0, "radius": 0.0}.get(name, -np.inf)
            if not np.all(np.isfinite(value) & (value >= least)):
                raise SensorError(
                    f"{self.label}: {name} is {value.tolist()}; give finite numbers"
                    f"{' above zero' * (least > 0.0) or ' from zero' * (least == 0.0)}."
                )
            object.__setattr__(self, name, np.broadcast_to(value, count).copy())
        return (2 * count if np.any(self.compliance) else count,)

    @property
    def longest_step(self) -> float:
        """A fraction of the shortest pitch, m; infinite if all channels are straight."""
        return float(np.abs(self.pitch[self.pitch != 0.0]).min(initial=np.inf)) / _A_TURN

    def residual_over(self, arclength: Array, at: State) -> Array:
        """Expected minus measured (M, T), m, from the states along the whole robot.

        Args:
            arclength: Places (N,), m, from the base to the tip.
            at: States (M, N) there.

        Raises:
            SensorError: A tendon ends beyond the last place.
        """
        residual, _ = self._residual_and_jacobian(arclength, at)
        return residual

    def jacobian_over(self, arclength: Array, at: State) -> Array:
        """∂residual/∂[pose, strain, velocity] at each place (M, T, N, 18)."""
        return self._residual_and_jacobian(arclength, at)[1]

    def _residual_and_jacobian(self, arclength: Array, at: State) -> tuple[Array, Array]:
        if np.any(self.end > arclength[-1] + 1e-9):
            raise SensorError(
                f"{self.label}: tendon {int(np.argmax(self.end))} ends at {self.end.max():g} m, "
                f"beyond the robot's {arclength[-1]:g} m; end it on the robot."
            )
        m, count = len(self), self.row_count
        expected, jacobian = np.zeros((m, count)), np.zeros((m, count, arclength.size, DOF))
        every = zip(self.radius, self.angle, self.pitch, strict=True)
        for j, (radius, angle, pitch) in enumerate(every):
            channel = Channel(radius, angle, pitch or np.inf)
            place, slope = channel.path(arclength)
            tangent = channel.tangent(arclength, at.strain)
            speed = np.linalg.norm(tangent, axis=-1)
            unit, share = tangent / speed[..., None], up_to(arclength, self.end[j])
            straight = np.linalg.norm(slope + _STRAIGHT, axis=-1)
            expected[:, j] = (straight - speed) @ share
            lever = (np.broadcast_to(se3.hat3(place), (m, *place.shape, 3)) @ unit[..., None])[
                ..., 0
            ]
            jacobian[:, j, :, STRAIN] = -share[:, None] * np.concatenate([unit, lever], axis=-1)
        stretch = self.values[:, count:] * self.compliance if np.any(self.compliance) else 0.0
        residual = expected + self.slack + stretch - self.values[:, :count]
        is_slack = (self.one_sided > 0.0) & (residual > 0.0)
        return np.where(is_slack, 0.0, residual), np.where(is_slack[..., None, None], 0.0, jacobian)


def up_to(arclength: Array, end: float) -> Array:
    """Quadrature weights (N,) for the integral up to `end` of linear interpolation from nodes."""
    weights, steps = np.zeros(arclength.size), np.diff(arclength)
    part = np.clip((end - arclength[:-1]) / steps, 0.0, 1.0)
    weights[:-1] += steps * part * (1.0 - 0.5 * part)
    weights[1:] += steps * 0.5 * part**2
    return weights
