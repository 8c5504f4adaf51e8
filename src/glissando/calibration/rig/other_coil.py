"""Coils of a session beside the one that is calibrated: they come into the world with it."""

from __future__ import annotations

from dataclasses import dataclass

from glissando.geometry.se3 import Array
from glissando.model.tendons.channel import Channel


@dataclass(frozen=True)
class OtherCoil:
    """A coil of the same tracker.

    Attributes:
        name: Its name.
        time: Stamps of the tracker (M,), s.
        poses: Poses of the coil in the tracker's frame, T_tc (M, 4, 4).
        arclength: Its stated arclength at travel 0, m.
        travel: Travel of its own stage at the stamps (M,), m, NaN while that was not read, zeros
            of a fixed coil; None of one that slides with the calibrated coil.
        channel: The channel beside the backbone that it slides in, if there is one.
    """

    name: str
    time: Array
    poses: Array
    arclength: float
    travel: Array | None
    channel: Channel | None = None
