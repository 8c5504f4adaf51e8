"""Addresses of OpenIGTLink peers: host and port, mode, units, axes and clock.

The unit of length and the axes are millimetres and RAS as in 3D Slicer, or others. RAS is 3D
Slicer's world: x to the right of the patient, y to the front (anterior), z to the head (superior).
In LPS x points left and y to the back. The world frame of glissando is taken to be RAS.
"""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array

PORT = 18944  # the customary port
_LOCAL = "127.0.0.1"
_UNITS = {"mm": 1e-3, "m": 1.0}
_AXES = ("ras", "lps")
_CLOCKS = ("fitted", "shared", "arrival", "sender")
_LONGEST = (1 << 31) - 1  # ms: the largest interval that the request can represent
SENT = ("frames", "tip", "line", "tube", "ellipsoids", "points", "status", "readings")
"""Parts of an update that can be sent; all but the readings by default."""
_HINT = (
    "give igtl://host:port to call a server, igtl-server://host:port to be one; after a ? "
    "unit=mm|m, axes=ras|lps, clock=fitted|shared|arrival|sender, start=MS, send="
    f"{','.join(SENT)}."
)
_PREFIXES = {
    0x0: 1.0, 0x1: 1e1, 0x2: 1e2, 0x3: 1e3, 0x4: 1e6, 0x5: 1e9, 0x6: 1e12, 0x7: 1e15,
    0x9: 1e-1, 0xA: 1e-2, 0xB: 1e-3, 0xC: 1e-6, 0xD: 1e-9, 0xE: 1e-12, 0xF: 1e-15,
}  # fmt: skip
"""SI prefix of a SENSOR's unit, by its first four bits; six base units of ten bits follow."""
_METRES = (0x01 << 54, 0x01 << 54 | 1 << 50)  # with or without the exponent one
_UNIT_BITS = (1 << 60) - 1


@dataclass(frozen=True)
class Address:
    """Address of a peer, with its conventions.

    Attributes:
        host: Name or address of the host; of the network interface for a server.
        port: TCP port; for a server, 0 is any free one.
        listens: Whether to be a server and wait for peers, instead of connecting to one.
        scale: The peer's unit of length, m.
        axes: "ras", or "lps" if x and y have the opposite sign.
        clock: Conversion of stamps to times: "fitted" to their arrivals, "shared" if both computers
            have one clock (NTP), "arrival" to ignore stamps, "sender" to keep the sender's time.
        start: Interval in ms at which the peer is requested to send TDATA; 0 for no request.
        send: Parts of an update that are sent, from `SENT`.
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
        """Parse igtl://host:port (connect) or igtl-server://host:port (listen).

        The default host is 127.0.0.1, the default port 18944. Options may follow a question mark:
        unit=m, axes=lps, clock=shared, start=20, send=tip,tube, joined by &.

        Raises:
            DeviceError: The text is not such an address.

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
            raise DeviceError(f"{text!r} is not an address ({problem}); {_HINT}") from None
        listens = parts.scheme == "igtl-server"
        valid = unit in _UNITS and axes in _AXES and clock in _CLOCKS and 0 <= start <= _LONGEST
        valid &= {*send} <= {*SENT}
        if not (listens or parts.scheme == "igtl") or options or parts.path or not valid:
            raise DeviceError(f"{text!r} is not an address; {_HINT}")
        return cls(host, port, listens, _UNITS[unit], axes, clock, start, send)

    @classmethod
    def of_rig(cls, text: str) -> Address:
        """Parse the address of a device of a rig, whose times are on this computer's clock.

        Raises:
            DeviceError: The text is not an address, or has clock=sender.
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
    """Convention of a peer for positions: unit of length, m, and signs (3,) of the axes."""

    scale: float = 1e-3
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @classmethod
    def of(cls, address: Address) -> WireFrame:
        """Convention that an address states."""
        lps = address.axes == "lps"
        return cls(address.scale, (-1.0, -1.0, 1.0) if lps else (1.0, 1.0, 1.0))

    def pose_in(self, pose: Array) -> Array:
        """Convert a peer's pose (4, 4) to metres and the axes of glissando."""
        out = np.array(pose, dtype=float)
        out[:3, 3] *= self.scale
        out[:3] *= np.array(self.signs)[:, None]
        return out

    def poses_out(self, poses: Array) -> Array:
        """Convert poses (…, 4, 4) to the peer's unit and axes."""
        out = np.array(poses, dtype=float)
        out[..., :3, 3] /= self.scale
        out[..., :3, :] *= np.array(self.signs)[:, None]
        return out

    def points_out(self, points: Array) -> Array:
        """Convert points (…, 3) to the peer's unit and axes."""
        return points * np.array(self.signs) / self.scale

    def length_unit(self, unit: int) -> float:
        """Unit of a SENSOR message in metres; `scale` if the message states none.

        Raises:
            DeviceError: The unit is not one of length.
        """
        prefix = _PREFIXES.get(unit >> 60)
        if not unit & _UNIT_BITS and prefix == 1.0:
            return self.scale
        if unit & _UNIT_BITS not in _METRES or prefix is None:
            raise DeviceError(f"A place in the unit {unit:#018x} is not a length; send metres.")
        return prefix
