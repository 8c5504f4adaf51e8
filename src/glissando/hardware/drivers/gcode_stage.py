"""A stage on an axis of a GRBL controller: its limits, and what its status reports say."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Self

from glissando.errors import DeviceError
from glissando.hardware.drivers.stage import Stroke, optional_number
from glissando.io.toml_table import Table

_MM = 1e3
_STATUS = re.compile(rb"<(\w+)(?::\d)?\|(MPos|WPos):([-\d.,]+)")


@dataclass(frozen=True)
class GcodeStage(Stroke):
    """A stage on one axis of a GRBL controller.

    Attributes:
        stroke: Travels (low, high) that a command may ask for, m.
        direction: 1 if travel grows with the axis' position, else −1.
        home: Travel after the controller's homing cycle ($H), if it has one, m.
        axis: The axis' letter.
        speed: Largest speed that is commanded, m/s.
        acceleration: Largest acceleration that a path may ask for, m/s².
        lag: Distance from its path at which the stage is stopped, m.
        baud: Rate of the serial line.

    Raises:
        DeviceError: A value is impossible.
    """

    stroke: tuple[float, float]
    direction: float = 1
    home: float | None = None
    axis: str = "X"
    speed: float = 0.024
    acceleration: float = 0.1
    lag: float = 0.005
    baud: int = 115200

    def __post_init__(self) -> None:
        low, high = self.stroke
        positive = self.speed, self.acceleration, self.lag
        if not all(map(math.isfinite, (low, high, *positive))) or not low < high:
            raise DeviceError(f"A stroke from {low:g} to {high:g} m cannot be; give low, high.")
        if min(positive) <= 0.0 or self.direction not in (1, -1) or self.axis not in "XYZABC":
            raise DeviceError(
                f"{self} cannot be; give speed, acceleration and lag above zero, direction 1 or "
                f"-1, and an axis X, Y, Z, A, B or C."
            )
        if high - low > 5.0 or self.speed > 5.0:
            raise DeviceError(
                f"A stroke of {high - low:g} m at {self.speed:g} m/s is no stage of a laboratory; "
                f"give metres and metres a second."
            )

    @classmethod
    def from_table(cls, table: Table) -> Self:
        """The stage of a TOML table with the names of this class. Raises DeviceError."""
        low, high = table.vector("stroke", 2)
        stage = cls(
            stroke=(float(low), float(high)),
            direction=table.number("direction", 1, positive=False),
            home=optional_number(table, "home"),
            axis=table.text("axis", cls.axis),
            speed=table.number("speed", cls.speed),
            acceleration=table.number("acceleration", cls.acceleration),
            lag=table.number("lag", cls.lag),
            baud=int(table.number("baud", cls.baud)),
        )
        table.close()
        return stage

    def require_allowed(self, speed: float) -> None:
        """Raise DeviceError unless the stage allows a speed in m/s."""
        if not 0.0 < speed <= self.speed * (1.0 + 1e-6):
            raise DeviceError(
                f"{_MM * speed:.4g} mm/s is asked for; this stage allows {_MM * self.speed:g} "
                f"mm/s. Ask for less, or raise its `speed`."
            )


def parse_status(line: bytes) -> tuple[str, list[float]]:
    """State and position in mm of a status report.

    Raises:
        DeviceError: It is none, or reports work positions.

    >>> parse_status(b"<Idle|MPos:1.000,0.000,-2.500|FS:0,0>")
    ('Idle', [1.0, 0.0, -2.5])
    """
    found = _STATUS.match(line)
    try:
        if found is None or found[2] != b"MPos":
            raise ValueError
        return found[1].decode(), [float(number) for number in found[3].split(b",")]
    except ValueError:
        raise DeviceError(
            f"The controller answered {line[:60]!r} and no machine position; set $10=1."
        ) from None
