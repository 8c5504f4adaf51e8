"""What goes wrong on a servo's line, in an order that a seed fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from glissando.errors import DeviceError

_HELP = "corrupt=P short=P late=P:SECONDS silent=AT:COUNT dead=AT overload=AT restart=AT"


@dataclass(frozen=True)
class Faults:
    """Faults of a line: shares of status packets, or the number of the packet they begin at.

    `corrupt` and `short` are shares; `late` is (share, seconds). From packet `silent[0]` on,
    `silent[1]` packets are lost; from packet `dead` on the servo neither hears nor answers. At
    packet `overload` it raises that error, at `restart` it loses power for a moment.
    """

    corrupt: float = 0.0
    short: float = 0.0
    late: tuple[float, float] = (0.0, 0.0)
    silent: tuple[int, int] = (0, 0)
    dead: int | None = None
    overload: int | None = None
    restart: int | None = None

    @staticmethod
    def read(words: Sequence[str]) -> Faults:
        """From words such as `corrupt=0.01` and `late=0.1:0.05`. Raises DeviceError.

        >>> Faults.read(["corrupt=0.01", "silent=100:5"]).silent
        (100, 5)
        """
        found: dict[str, Any] = {}
        for word in words:
            name, _, text = word.partition("=")
            if name not in (field.name for field in fields(Faults)):
                raise DeviceError(f"A servo has no fault {name!r}; give some of {_HELP}.")
            kind = float if name in ("corrupt", "short", "late") else int
            try:
                values = tuple(kind(part) for part in text.split(":"))
                if len(values) != (2 if name in ("late", "silent") else 1) or min(values) < 0.0:
                    raise ValueError(text)
            except ValueError:
                raise DeviceError(f"The fault {word!r} cannot be; give some of {_HELP}.") from None
            found[name] = values if len(values) == 2 else values[0]
        return Faults(**found)


class Line:
    """A line that spoils status packets on their way; `sent` counts them."""

    def __init__(self, faults: Faults, seed: int = 0) -> None:
        self.faults = faults
        self.sent = 0
        self._random = np.random.default_rng(seed)

    @property
    def dead(self) -> bool:
        """Whether the servo is cut off by now."""
        return self.faults.dead is not None and self.sent >= self.faults.dead

    def spoil(self, packet: bytes, now: float) -> tuple[float, bytes]:
        """When a packet arrives, and what is left of it."""
        number, faults = self.sent, self.faults
        self.sent += 1
        draw = self._random.random(3)  # three for each packet: faults do not move one another
        place = int(self._random.integers(len(packet)))
        if draw[0] < faults.corrupt:
            packet = packet[:place] + bytes([packet[place] ^ 0x5A]) + packet[place + 1 :]
        if draw[1] < faults.short:
            packet = packet[:place]
        if 0 <= number - faults.silent[0] < faults.silent[1]:
            packet = b""
        return now + (faults.late[1] if draw[2] < faults.late[0] else 0.0), packet
