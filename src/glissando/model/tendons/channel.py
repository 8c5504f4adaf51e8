"""A channel beside the backbone, straight or helical, that a tendon or a sliding sensor runs in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import Array


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

    def path(self, arclength: Array) -> tuple[Array, Array]:
        """Places r (P, 3) in the cross-section at arclengths (P,), and their slopes dr/ds."""
        rate = 2.0 * np.pi / self.pitch
        turn = self.angle + rate * np.asarray(arclength, dtype=float)
        flat = np.zeros_like(turn)
        place = self.radius * np.stack([np.cos(turn), np.sin(turn), flat], axis=-1)
        slope = self.radius * rate * np.stack([-np.sin(turn), np.cos(turn), flat], axis=-1)
        return place, slope

    def tangent(self, arclength: Array, strain: Array) -> Array:
        """Tangent ν + u × r + dr/ds (…, P, 3) in the body frame where strain is (…, P, 6).

        Its length is the channel's length for a length of backbone. Source: (M5), (M8).
        """
        place, slope = self.path(arclength)
        return strain[..., :3] + np.cross(strain[..., 3:], place) + slope
