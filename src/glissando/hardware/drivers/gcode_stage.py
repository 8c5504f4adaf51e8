"""A stage on an axis of a GRBL controller: its settings, and what its status reports say."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from glissando.errors import DeviceError
from glissando.hardware.drivers.position_stage import PositionStage
from glissando.model.table import Table

_STATUS = re.compile(rb"<(\w+)(?::\d+)?\|(MPos|WPos):([-\d.,]+)")


@dataclass(frozen=True)
class GcodeStage(PositionStage):
    """A stage on one axis of a GRBL controller; its `home` is the travel after its cycle ($H).

    Attributes:
        axis: The axis' letter.
        baud: Rate of the serial line.

    Raises:
        DeviceError: A value is impossible.
    """

    axis: str = "X"
    baud: int = 115200

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.axis not in tuple("XYZABC"):
            raise DeviceError(f"There is no axis {self.axis!r}; give X, Y, Z, A, B or C.")

    @classmethod
    def _own(cls, table: Table) -> dict[str, Any]:
        baud = int(table.number("baud", cls.baud))
        return {"axis": table.text("axis", cls.axis), "baud": baud}


def parse_status(line: bytes) -> tuple[str, list[float]]:
    """State and position in mm of a status report.

    Raises:
        DeviceError: It is none, or reports work positions.

    >>> parse_status(b"<Idle|MPos:1.000,0.000,-2.500|FS:0,0>")
    ('Idle', [1.0, 0.0, -2.5])
    """
    match = _STATUS.match(line)
    try:
        if match is None or match[2] != b"MPos":
            raise ValueError
        return match[1].decode(), [float(number) for number in match[3].split(b",")]
    except ValueError:
        raise DeviceError(
            f"The controller answered {line[:60]!r} and no machine position; set $10=1."
        ) from None
