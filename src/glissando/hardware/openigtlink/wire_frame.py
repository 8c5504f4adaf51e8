"""Units and axes of a peer: millimetres and RAS as 3D Slicer has them, or others.

3D Slicer's world is RAS: x to the right of the patient, y to the front (anterior), z to the head
(superior). In LPS x points left and y to the back. Our world frame is taken for RAS as it stands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array
from glissando.hardware.openigtlink.address import Address

_PREFIXES = {
    0x0: 1.0, 0x1: 1e1, 0x2: 1e2, 0x3: 1e3, 0x4: 1e6, 0x5: 1e9, 0x6: 1e12, 0x7: 1e15,
    0x9: 1e-1, 0xA: 1e-2, 0xB: 1e-3, 0xC: 1e-6, 0xD: 1e-9, 0xE: 1e-12, 0xF: 1e-15,
}  # fmt: skip
"""Of a SENSOR's unit, by its first four bits; six units of ten bits follow."""
_METRES = (0x01 << 54, 0x01 << 54 | 1 << 50)  # with or without its exponent of one
_UNITS = (1 << 60) - 1


@dataclass(frozen=True)
class WireFrame:
    """How a peer states positions: metres a unit of `scale`, and the signs (3,) of its axes."""

    scale: float = 1e-3
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @classmethod
    def of(cls, address: Address) -> WireFrame:
        """The frame that an address states."""
        lps = address.axes == "lps"
        return cls(address.scale, (-1.0, -1.0, 1.0) if lps else (1.0, 1.0, 1.0))

    def pose_in(self, pose: Array) -> Array:
        """A peer's pose (4, 4), in metres and our axes."""
        out = np.array(pose, dtype=float)
        out[:3, 3] *= self.scale
        out[:3] *= np.array(self.signs)[:, None]
        return out

    def poses_out(self, poses: Array) -> Array:
        """Our poses (…, 4, 4) as the peer takes them."""
        out = np.array(poses, dtype=float)
        out[..., :3, 3] /= self.scale
        out[..., :3, :] *= np.array(self.signs)[:, None]
        return out

    def points_out(self, points: Array) -> Array:
        """Our points (…, 3) as the peer takes them."""
        return points * np.array(self.signs) / self.scale

    def length_unit(self, unit: int) -> float:
        """Metres of a SENSOR's unit; the frame's own where it states none.

        Raises:
            DeviceError: The unit is none of length.
        """
        prefix = _PREFIXES.get(unit >> 60)
        if not unit & _UNITS and prefix == 1.0:
            return self.scale
        if unit & _UNITS not in _METRES or prefix is None:
            raise DeviceError(f"A place in the unit {unit:#018x} is no length; send metres.")
        return prefix
