"""Replies of an NDI Aurora: readings of its ports, frames, and error codes."""

from __future__ import annotations

from dataclasses import dataclass

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array

ERRORS = {
    0x01: "it does not know the command; its firmware may be too old",
    0x02: "the command was too long",
    0x03: "the command was too short",
    0x04: "the command reached it garbled; check cable and baud rate",
    0x05: "it waited too long for the rest of the command",
    0x06: "it cannot use these settings of the serial line; ask for another baud rate",
    0x07: "it cannot use a parameter of the command",
    0x08: "it has no coil under this handle; plug the coil in and connect again",
    0x0C: "it is in the wrong mode for the command: it tracks and should not, or the reverse",
    0x0D: "no coil is plugged in; plug one in",
    0x0E: "the coil's port is not initialised",
    0x0F: "the coil's port is not enabled",
    0x10: "it has not been initialised since it was switched on or reset",
    0x11: "it could not stop tracking; switch it off and on",
    0x12: "it could not start tracking; check the field generator's cable",
    0x13: "the coil's memory (SROM) is absent or damaged",
    0x15: "it cannot initialise: check the field generator's cable, then switch it off and on",
    0x19: "its firmware is incomplete; ask NDI for an update",
    0x1A: "it has an internal fault; switch it off and on",
    0x23: "a parameter of the command is out of range",
    0x28: "more coils are plugged in than it can track; unplug some",
    0x2A: "it is out of memory; switch it off and on",
    0x2B: "the handle has not been given out",
    0x2C: "the coil has been unplugged; plug it in and connect again",
    0x2D: "it has no handles left; unplug a coil, or switch it off and on",
    0x2F: "it does not know the port's description",
    0x32: "it cannot do this now",
    0x33: "it lacks this feature",
    0x34: "it lacks this parameter",
    0x39: "it does not permit this",
    0x40: "the definition of the coil is wrong; check its SROM file",
}
"""Meaning of an ERROR reply, by its number."""

OUT_OF_VOLUME, PARTIALLY_OUT, BROKEN_COIL = 0x040, 0x080, 0x100
# Two sources number the hot-plug bits one apart; any of the three counts as a hot plug [inferred].
HOT_PLUG = 0x00E0


class GarbledError(DeviceError):
    """A reply arrived damaged or incomplete; a repeated request may succeed."""


class RefusedError(DeviceError):
    """The device refused a command; `code` is the number of its error."""

    def __init__(self, code: int):
        self.code = code
        meaning = ERRORS.get(code, "look it up in its guide")
        super().__init__(f"The Aurora answered ERROR{code:02X}: {meaning}.")


@dataclass(frozen=True)
class PortReading:
    """Reading of one coil in one reply.

    Attributes:
        handle: The coil's handle.
        condition: 'valid', 'missing', 'disabled' or 'unoccupied'.
        number: Frame number, an unsigned 32-bit counter; None if absent from the reply.
        status: Status bits of the port; None if absent from the reply.
        pose: T_tracker,coil (4, 4), metres; None unless valid. For a coil of five degrees of
            freedom the roll about its axis is arbitrary.
        quality: NDI's quality indicator, 0 at best; not a standard deviation.
    """

    handle: int
    condition: str
    number: int | None = None
    status: int | None = None
    pose: Array | None = None
    quality: float = float("nan")

    @property
    def missing(self) -> bool:
        """Whether the tracker cannot locate the coil."""
        return self.condition == "missing"

    @property
    def out_of_volume(self) -> bool:
        """Whether the coil is outside the volume for which the tracker's accuracy is specified."""
        return self._has(OUT_OF_VOLUME)

    @property
    def partially_out(self) -> bool:
        """Whether the coil is partially outside that volume."""
        return self._has(PARTIALLY_OUT)

    @property
    def broken(self) -> bool:
        """Whether the tracker considers the coil's wire broken."""
        return self._has(BROKEN_COIL)

    @property
    def good(self) -> bool:
        """Whether there is a pose, measured fully inside the volume."""
        return self.pose is not None and not (self.out_of_volume or self.partially_out)

    def _has(self, bits: int) -> bool:
        return self.status is not None and bool(self.status & bits)


@dataclass(frozen=True)
class Reply:
    """A TX or BX reply: a reading for each enabled port, and the system's status bits."""

    ports: tuple[PortReading, ...]
    status: int

    @property
    def hot_plugged(self) -> bool:
        """Whether a coil was plugged in or out since the last reply."""
        return bool(self.status & HOT_PLUG)


@dataclass(frozen=True)
class Frame:
    """One frame of the tracker.

    Attributes:
        number: Frame number, unwrapped.
        time: Time of measurement, estimated from `number`, s of the host's monotonic clock.
        std_time: Standard deviation of `time`, s.
        arrival: Time at which the reply arrived, by the same clock.
        ports: Readings of the coils, in the tracker's order of handles.
    """

    number: int
    time: float
    std_time: float
    arrival: float
    ports: tuple[PortReading, ...]
