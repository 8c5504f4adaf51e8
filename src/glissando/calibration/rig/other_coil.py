"""Coils of a session that are not calibrated, but transformed into the world by the result."""

from __future__ import annotations

from dataclasses import dataclass

from glissando.geometry.se3 import Array
from glissando.model.tendons.channel import Channel


@dataclass(frozen=True)
class OtherCoil:
    """A coil of the same tracker that is not calibrated.

    Attributes:
        name: Name of the coil.
        time: Stamps of the tracker (M,), s.
        poses: Poses of the coil in the tracker's frame, T_tc (M, 4, 4).
        arclength: Stated arclength of the coil at travel 0, m.
        travel: Travel of the coil's own stage at the stamps (M,), m; NaN where the stage was not
            recorded, zeros for a fixed coil, None if it slides with the calibrated coil.
        channel: Channel beside the backbone in which the coil slides, or None.
    """

    name: str
    time: Array
    poses: Array
    arclength: float
    travel: Array | None
    channel: Channel | None = None
