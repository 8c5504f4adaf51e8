"""Imperfections of robot and sensors, and the smooth random fields from which they are drawn."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from glissando.errors import SimulationError
from glissando.geometry.se3 import Array

_LENGTHS = ("bias_length", "field_size", "set_length")  # must be positive
_MOST = 1e6
_WAVES = 64  # plane waves a random field is made of
ROLLS = ("arbitrary", "minimal", "true")


@dataclass(frozen=True)
class Imperfections:
    """Imperfections of robot and sensors; zero switches a part off.

    Lengths in m and angles in rad are RMS norms over all components. Jitter and bias are multiplied
    by 1 + (d / field_size)² at the distance d from the field's centre.

    Attributes:
        jitter, jitter_angle: White noise of the coil.
        bias, bias_angle: Errors of the coil that depend on its position.
        bias_length: Correlation length of the bias in space.
        field_centre: Centre of the tracker's field in the world (3,).
        field_size: Distance from the centre at which jitter and bias are doubled.
        registration, registration_angle: Error of the tracker's frame, about the field's centre,
            constant in a session.
        play: Radial clearance of the inner tube, which touches the wall along a smooth line.
        backlash: Free travel between motor and coil.
        encoder: White noise of the motor's position.
        dropouts: Rate of drop-outs, 1/s.
        dropout_duration: Shortest and longest drop-out (2,), s.
        roll: Roll that the tracker reports: 'arbitrary' (offset by a constant per session),
            'minimal' (that of the least rotation from the tracker's frame) or 'true'.
        mocap, mocap_angle: White noise of motion capture.
        latency: Delay of the tracker's stamps after the end of the exposure, s.
        exposure: Duration of the exposure, s, over which the reported pose is averaged.
        drive_stiffness: Stiffness of the tube between motor and coil, N/m; zero for a rigid tube.
        drive_mass, drive_damping, drive_friction, drive_stiction: As in `DriveTube`.
        gyro, accelerometer: White noise of inertial sensors per axis, rad/s and m/s².
        set_curvature: Curvature of the unloaded tubes (permanent set), RMS about each axis, rad/m.
        set_length: Correlation length of the set along the body.
    """

    jitter: float = 1.2e-4
    jitter_angle: float = 1e-3
    bias: float = 7.5e-4
    bias_angle: float = 7e-3
    bias_length: float = 0.1
    field_centre: Array = field(default_factory=lambda: np.zeros(3))
    field_size: float = 1.0
    registration: float = 1e-3
    registration_angle: float = 5e-3
    play: float = 3e-4
    backlash: float = 2e-4
    encoder: float = 1e-5
    dropouts: float = 0.05
    dropout_duration: Array = field(default_factory=lambda: np.array([0.14, 0.34]))
    roll: str = "arbitrary"
    mocap: float = 1.5e-4
    mocap_angle: float = 1.5e-3
    latency: float = 0.0
    exposure: float = 0.0
    drive_stiffness: float = 0.0
    drive_mass: float = 2e-3
    drive_damping: float = 0.5
    drive_friction: float = 0.2
    drive_stiction: float = 1.5
    gyro: float = 2e-3
    accelerometer: float = 0.02
    set_curvature: float = 0.3
    set_length: float = 0.15

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.type != "float":
                continue
            least = 1e-6 if entry.name in (*_LENGTHS, "drive_mass") else 0.0
            if not (isinstance(value, (int, float, np.number)) and least <= value <= _MOST):
                raise SimulationError(
                    f"{entry.name} is {value}; give a number from {least:g} to {_MOST:g}, SI units."
                )
        for name in ("latency", "exposure"):
            if getattr(self, name) > 1.0:
                raise SimulationError(
                    f"{name} is {getattr(self, name):g} s; give seconds, 1 at most."
                )
        if self.drive_stiction < 1.0:
            raise SimulationError(
                f"drive_stiction is {self.drive_stiction:g}; give 1 or more, times the friction."
            )
        low, high = self.dropout_duration
        if not 0.0 <= low <= high:
            raise SimulationError(
                f"dropout_duration is {low:g} to {high:g} s; give the shortest and the longest."
            )
        if self.roll not in ROLLS:
            raise SimulationError(f"roll is {self.roll!r}; give one of {', '.join(ROLLS)}.")

    def without(self, *names: str) -> Imperfections:
        """Copy with the named parts switched off; 'all' includes the noise of motion capture.

        A part contains both position and angle. Raises SimulationError for an unknown name.
        """
        for name in names:
            if name not in (*PARTS, "all"):
                raise SimulationError(f"{name!r} is not an imperfection; name some of {_LISTED}.")
        parts = [*PARTS] if "all" in names else names
        off: dict[str, Any] = {key: 0.0 for name in parts for key in PARTS[name] if key != "roll"}
        return replace(self, **off, roll="true" if "roll" in parts else self.roll)


PARTS = {
    "jitter": ("jitter", "jitter_angle"),
    "bias": ("bias", "bias_angle"),
    "registration": ("registration", "registration_angle"),
    "play": ("play",),
    "backlash": ("backlash",),
    "encoder": ("encoder",),
    "dropouts": ("dropouts",),
    "roll": ("roll",),
    "mocap": ("mocap", "mocap_angle"),
    "latency": ("latency",),
    "exposure": ("exposure",),
    "drive": ("drive_stiffness",),
    "gyro": ("gyro",),
    "accelerometer": ("accelerometer",),
    "set": ("set_curvature",),
}
"""Parts that `Imperfections.without` can switch off, and the fields that it sets to zero."""
_LISTED = ", ".join((*PARTS, "all"))


@dataclass(frozen=True)
class SmoothField:
    """Smooth random function of position with unit variance per component.

    A sum of plane waves with random directions, which approximates a Gaussian random field with a
    squared exponential covariance.
    """

    waves: Array
    phase: Array

    @staticmethod
    def draw(
        rng: np.random.Generator, dimensions: int, components: int, length: float
    ) -> SmoothField:
        """Draw a field over `dimensions` with independent components and correlation length, m."""
        waves = rng.standard_normal((components, _WAVES, dimensions)) / max(length, 1e-9)
        return SmoothField(waves, rng.uniform(0.0, 2.0 * np.pi, (components, _WAVES)))

    def __call__(self, place: Array) -> Array:
        """Values (M, C) at places (M, D)."""
        components, waves, dimensions = self.waves.shape
        argument = place @ self.waves.reshape(-1, dimensions).T + self.phase.ravel()
        argument = argument.reshape(-1, components, waves)
        return np.sqrt(2.0 / _WAVES) * np.sum(np.cos(argument), axis=-1)
