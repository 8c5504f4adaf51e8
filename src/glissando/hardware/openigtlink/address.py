"""Addresses of OpenIGTLink peers: whom to call, or where to listen, and what their numbers mean.

Units and axes of a peer are millimetres and RAS as 3D Slicer has them, or others. 3D Slicer's world
is RAS: x to the right of the patient, y to the front (anterior), z to the head (superior). In LPS x
points left and y to the back. Our world frame is taken for RAS as it stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array

PORT = 18944  # by custom
_LOCAL = "127.0.0.1"
_UNITS = {"mm": 1e-3, "m": 1.0}
_AXES = ("ras", "lps")
_CLOCKS = ("fitted", "shared", "arrival", "sender")
_LONGEST = (1 << 31) - 1  # ms: what the message that asks has room for
SENT = ("frames", "tip", "line", "tube", "ellipsoids", "points", "status", "readings")
"""What can be sent of an update; all but the readings unless the address says otherwise."""
_HINT = (
    "give igtl://host:port to call a server, igtl-server://host:port to be one; after a ? "
    "unit=mm|m, axes=ras|lps, clock=fitted|shared|arrival|sender, start=MS, send="
    f"{','.join(SENT)}."
)
_PREFIXES = {
    0x0: 1.0, 0x1: 1e1, 0x2: 1e2, 0x3: 1e3, 0x4: 1e6, 0x5: 1e9, 0x6: 1e12, 0x7: 1e15,
    0x9: 1e-1, 0xA: 1e-2, 0xB: 1e-3, 0xC: 1e-6, 0xD: 1e-9, 0xE: 1e-12, 0xF: 1e-15,
}  # fmt: skip
"""Of a SENSOR's unit, by its first four bits; six units of ten bits follow."""
_METRES = (0x01 << 54, 0x01 << 54 | 1 << 50)  # with or without its exponent of one
_UNIT_BITS = (1 << 60) - 1


@dataclass(frozen=True)
class Address:
    """Where a peer is and how it counts.

    Attributes:
        host: Name or number; where we listen, the interface.
        port: TCP port; 0 is any free one where we listen.
        listens: Whether we wait for peers, instead of calling one.
        scale: Metres of the peer's unit of length.
        axes: "ras", or "lps" where x and y point the other way.
        clock: How stamps become times: "fitted" to their arrivals, "shared" if both computers have
            one clock (NTP), "arrival" if stamps mean nothing, "sender" to keep the sender's time.
        start: Milliseconds between the TDATA we ask the peer for; 0 asks for none.
        send: What an update consists of, of `SENT`.
    """

    host: str
    port: int
    listens: bool
    scale: float = 1e-3
    axes: str = "ras"
    clock: str = "fitted"
    start: int = 0
    send: tuple[str, ...] = SENT[:-1]

    @classmethod
    def parse(cls, text: str) -> Address:
        """The address of a text: igtl://host:port to call, igtl-server://host:port to listen.

        Without a host it is 127.0.0.1, without a port 18944. After a question mark may stand
        unit=m, axes=lps, clock=shared, start=20, send=tip,tube, joined by &.

        Raises:
            DeviceError: The text is no such address.

        >>> address = Address.parse("igtl-server://:18945?unit=m")
        >>> address.host, address.port, address.listens, address.scale
        ('127.0.0.1', 18945, True, 1.0)
        """
        try:
            parts = urlsplit(text)
            host, port = parts.hostname or _LOCAL, PORT if parts.port is None else parts.port
            options = dict(parse_qsl(parts.query, strict_parsing=bool(parts.query)))
            unit, axes = options.pop("unit", "mm"), options.pop("axes", "ras").lower()
            clock, start = options.pop("clock", "fitted"), int(options.pop("start", "0"))
            send = tuple(options.pop("send", ",".join(SENT[:-1])).split(","))
        except ValueError as problem:
            raise DeviceError(f"{text!r} is no address ({problem}); {_HINT}") from None
        listens = parts.scheme == "igtl-server"
        sound = unit in _UNITS and axes in _AXES and clock in _CLOCKS and 0 <= start <= _LONGEST
        sound &= {*send} <= {*SENT}
        if not (listens or parts.scheme == "igtl") or options or parts.path or not sound:
            raise DeviceError(f"{text!r} is no address; {_HINT}")
        return cls(host, port, listens, _UNITS[unit], axes, clock, start, send)

    @classmethod
    def of_rig(cls, text: str) -> Address:
        """The address of a device of a rig, whose times are this computer's.

        Raises:
            DeviceError: The text is none, or keeps another time.
        """
        out = cls.parse(text)
        if out.clock == "sender":
            raise DeviceError(
                f"{text}: a recording keeps this computer's time; give clock=fitted, shared or "
                f"arrival."
            )
        return out


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
        if not unit & _UNIT_BITS and prefix == 1.0:
            return self.scale
        if unit & _UNIT_BITS not in _METRES or prefix is None:
            raise DeviceError(f"A place in the unit {unit:#018x} is no length; send metres.")
        return prefix
