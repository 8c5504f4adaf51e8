"""A stage that is sent positions: its limits, whatever speaks with it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

from glissando.errors import DeviceError
from glissando.hardware.drivers.stage import Stroke, optional_number
from glissando.io.toml_table import Table

_MM = 1e3


@dataclass(frozen=True)
class PositionStage(Stroke):
    """Limits of a stage that is sent positions.

    Attributes:
        stroke: Travels (low, high) that a command may ask for, m.
        direction: 1 if travel grows with the stage's own position, else −1.
        home: Travel after the stage has homed itself, if it does, m.
        speed: Largest speed that is commanded, m/s.
        acceleration: Largest acceleration that a path may ask for, m/s².
        lag: Distance from its path at which the stage is stopped, m.

    Raises:
        DeviceError: A value is impossible.
    """

    stroke: tuple[float, float]
    direction: float = 1
    home: float | None = None
    speed: float = 0.024
    acceleration: float = 0.1
    lag: float = 0.005

    def __post_init__(self) -> None:
        low, high = self.stroke
        positive = self.speed, self.acceleration, self.lag
        if not all(map(math.isfinite, (low, high, *positive))) or not low < high:
            raise DeviceError(f"A stroke from {low:g} to {high:g} m cannot be; give low, high.")
        if min(positive) <= 0.0 or self.direction not in (1, -1):
            raise DeviceError(
                f"{self} cannot be; give speed, acceleration and lag above zero, direction 1 or -1."
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
            speed=table.number("speed", cls.speed),
            acceleration=table.number("acceleration", cls.acceleration),
            lag=table.number("lag", cls.lag),
            **cls._own(table),
        )
        table.close()
        return stage

    @classmethod
    def _own(cls, table: Table) -> dict[str, Any]:
        """What else the table says of a stage of this kind."""
        return {}

    def require_allowed(self, speed: float) -> None:
        """Raise DeviceError unless the stage allows a speed in m/s."""
        if not 0.0 < speed <= self.speed * (1.0 + 1e-6):
            raise DeviceError(
                f"{_MM * speed:.4g} mm/s is asked for; this stage allows {_MM * self.speed:g} "
                f"mm/s. Ask for less, or raise its `speed`."
            )
