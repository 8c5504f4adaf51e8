"""A channel beside the backbone, straight or helical, that a tendon or a sliding sensor runs in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.errors import SensorError
from glissando.geometry import se3
from glissando.geometry.se3 import Array

_WIDEST = 0.1  # m
MOST_TURNED = 7.0
"""Largest angle in radians: a turn and a margin for learning. Larger ones are in degrees."""
LONGEST_PITCH = 20.0
"""Largest pitch in metres; a longer one is in another unit, or the channel is straight."""

_BEYOND = 2.0 * np.pi  # radii: change of a channel's length as the robot bends by a whole turn


@dataclass(frozen=True)
class Channel:
    """A channel at a constant distance from the backbone.

    Attributes:
        radius: The distance, m.
        angle: Angle in the cross-section of the base, rad.
        pitch: Metres for a whole turn about the backbone; infinite for a straight channel.
    """

    radius: float
    angle: float = 0.0
    pitch: float = np.inf

    def __post_init__(self) -> None:
        if not 0.0 <= self.radius < _WIDEST:
            raise SensorError(
                f"A channel {self.radius:g} m from the backbone cannot be; give metres, below "
                f"{_WIDEST:g}."
            )
        if not abs(self.angle) <= MOST_TURNED:
            raise SensorError(
                f"A channel at the angle {self.angle:g} rad, more than a turn; give radians "
                f"({self.angle:g} degrees are {np.deg2rad(self.angle):.4g} rad)."
            )
        if not abs(self.pitch) >= self.radius:
            raise SensorError(
                f"A channel that turns about the backbone every {self.pitch:g} m cannot be; give "
                f"the pitch in metres, or none if it is straight."
            )
        if LONGEST_PITCH < abs(self.pitch) < np.inf:
            raise SensorError(
                f"A channel that turns about the backbone every {self.pitch:g} m hardly turns; "
                f"give metres ({self.pitch:g} mm are {self.pitch / 1e3:g} m), or no pitch if it is "
                f"straight."
            )

    def path(self, arclength: Array) -> tuple[Array, Array]:
        """Positions r (P, 3) in the cross-section at arclengths (P,), and derivatives dr/ds."""
        rate = 2.0 * np.pi / self.pitch
        turn = self.angle + rate * np.asarray(arclength, dtype=float)
        flat = np.zeros_like(turn)
        place = self.radius * np.stack([np.cos(turn), np.sin(turn), flat], axis=-1)
        slope = self.radius * rate * np.stack([-np.sin(turn), np.cos(turn), flat], axis=-1)
        return place, slope

    def tangent(self, arclength: Array, strain: Array) -> Array:
        """Tangent ν + u × r + dr/ds (…, P, 3) in the body frame where strain is (…, P, 6).

        Its norm is the channel's length per length of backbone. Source: (M5), (M8).
        """
        place, slope = self.path(arclength)
        return strain[..., :3] + np.cross(strain[..., 3:], place) + slope

    def travels(self, length: float) -> tuple[float, float]:
        """Least and greatest travel, m, on a robot of a `length`, m, bent by up to a whole turn."""
        spare = _BEYOND * self.radius
        straight = length * float(np.hypot(1.0, 2.0 * np.pi * self.radius / self.pitch))
        return -spare, straight + spare

    def frame(self, arclength: Array, strain: Array) -> Array:
        """Poses (P, 4, 4), in the cross-section, of frames whose z points along the channel.

        They are rotated from the cross-section's frame by the smallest angle.

        Args:
            arclength: Arclengths (P,), m.
            strain: Strain (P, 6) at these.
        """
        tangent = self.tangent(arclength, strain)
        tangent = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
        axis = np.cross([0.0, 0.0, 1.0], tangent)
        sine = np.linalg.norm(axis, axis=-1, keepdims=True)
        turn = np.zeros((len(tangent), 6))
        turn[:, 3:] = axis * np.arctan2(sine, tangent[:, 2:]) / np.maximum(sine, 1e-12)
        pose = se3.exp(turn)
        pose[:, :3, 3] = self.path(arclength)[0]
        return pose

    def to_table(self) -> dict[str, float]:
        """Table of a recording, in metres and radians, with a pitch of 0 for a straight channel."""
        pitch = self.pitch if np.isfinite(self.pitch) else 0.0
        return {"radius": self.radius, "angle": self.angle, "pitch": pitch}


def ends_of(channel: Channel | None, length: float) -> tuple[float, float]:
    """Least and greatest arclength, m, of sensors on a robot: along the channel if there is one.

    Args:
        channel: The channel in which the sensors slide, or None on the backbone.
        length: Length of the robot, m.
    """
    return channel.travels(length) if channel else (0.0, length)
