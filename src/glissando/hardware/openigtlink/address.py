"""Addresses of OpenIGTLink peers: whom to call, or where to listen, and what their numbers mean."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import parse_qsl, urlsplit

from glissando.errors import DeviceError

PORT = 18944  # by custom
_LOCAL = "127.0.0.1"
_UNITS = {"mm": 1e-3, "m": 1.0}
_AXES = ("ras", "lps")
_CLOCKS = ("fitted", "shared", "arrival", "sender")
_LONGEST = (1 << 31) - 1  # ms: what the message that asks has room for
SENT = ("frames", "tip", "line", "tube", "ellipsoids", "points", "status", "readings")
"""What can be sent of an update; all but the readings unless the address says otherwise."""


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


_HINT = (
    "give igtl://host:port to call a server, igtl-server://host:port to be one; after a ? "
    "unit=mm|m, axes=ras|lps, clock=fitted|shared|arrival|sender, start=MS, send="
    f"{','.join(SENT)}."
)
