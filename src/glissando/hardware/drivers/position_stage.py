"""Settings of every stage: its stroke, its limits, and paths that satisfy them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array
from glissando.model.table import Table


@dataclass(frozen=True)
class PositionStage:
    """Limits of a stage.

    Attributes:
        stroke: Travels (low, high) between which commands are allowed, m.
        direction: 1 if travel grows with the device's own position, else −1.
        home: Travel after the device has homed itself, m; None if it cannot.
        speed: Largest commanded speed, m/s.
        acceleration: Largest acceleration that is commanded or planned, m/s².
        lag: Deviation from its path at which the stage is stopped, m.

    Raises:
        DeviceError: A value is out of range.
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
        if not all(map(math.isfinite, (low, high, *positive))):
            raise DeviceError(f"{self} holds a value that is not a number; correct it.")
        if not low < high:
            raise DeviceError(
                f"A stroke from {low:g} to {high:g} m cannot be; give a lower and a higher end."
            )
        if self.direction not in (1, -1):
            raise DeviceError(f"A direction of {self.direction:g} cannot be; give 1 or -1.")
        if min(positive) <= 0.0:
            raise DeviceError(f"{self} cannot be; give speed, acceleration and lag above zero.")
        if high - low > 5.0 or self.speed > 5.0 or self.acceleration > 50.0 or self.lag > 0.5:
            raise DeviceError(
                f"A stroke of {high - low:g} m at {self.speed:g} m/s and {self.acceleration:g} "
                f"m/s², {self.lag:g} m from its path at most, is not a laboratory's stage; give "
                f"metres, m/s and m/s²."
            )
        if self.home is not None and not low - 1.0 <= self.home <= high + 1.0:
            raise DeviceError(
                f"Home at {self.home:g} m lies far off the stroke from {low:g} to {high:g} m; give "
                f"metres, not millimetres."
            )

    @classmethod
    def from_table(cls, table: Table) -> Self:
        """Read a stage from a TOML table with the attributes as keys. Raises DeviceError."""
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
        """Read the attributes of a subclass from the table."""
        return {}

    def require_allowed(self, speed: float) -> None:
        """Raise DeviceError unless a speed in m/s is positive and at most the stage's limit."""
        if not 0.0 < speed <= self.speed * (1.0 + 1e-6):
            raise DeviceError(
                f"{1e3 * speed:.4g} mm/s is asked for; this stage allows {1e3 * self.speed:g} "
                f"mm/s. Ask for less, or raise its `speed`."
            )

    def require_inside(self, travel: float) -> None:
        """Raise DeviceError unless a travel lies within the stroke."""
        low, high = self.stroke
        if not low - 1e-9 <= travel <= high + 1e-9:
            raise DeviceError(
                f"A travel of {1e3 * travel:.4g} mm lies outside the stroke from {1e3 * low:g} to "
                f"{1e3 * high:g} mm; stay inside, or widen the stroke if the stage allows it."
            )

    def path(self, time: ArrayLike, travel: ArrayLike) -> tuple[Array, Array]:
        """Check a path, and return its times, shifted to begin at zero, and its travels.

        Args:
            time: Times (K,), s.
            travel: Travels (K,) at these times, m.

        Raises:
            DeviceError: Shapes differ, times do not increase, or the path leaves the stroke or is
                too fast.
        """
        times, places = np.asarray(time, dtype=float), np.asarray(travel, dtype=float)
        if times.ndim != 1 or times.size < 2 or times.shape != places.shape:
            raise DeviceError(
                f"A path of times {times.shape} and travels {places.shape} cannot be; give two or "
                f"more of each."
            )
        if not np.all(np.isfinite([times, places])) or np.any(np.diff(times) <= 0.0):
            raise DeviceError("The times of a path must increase, and all its numbers be finite.")
        for place in (places.min(), places.max()):
            self.require_inside(float(place))
        speed = float(np.abs(np.diff(places) / np.diff(times)).max())
        if speed > 0.0:
            self.require_allowed(speed)
        return times - times[0], places


def optional_number(table: Table, key: str) -> float | None:
    """Finite number of either sign, or None if the key is absent."""
    if table.peek(key) is None:
        table.skip(key)
        return None
    return table.number(key, positive=False)
