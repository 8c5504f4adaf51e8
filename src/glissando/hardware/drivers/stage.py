"""A lead-screw stage: its screw, limits and home, and conversion to the servo's units."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from glissando.errors import DeviceError
from glissando.hardware.drivers.position_stage import PositionStage
from glissando.io.toml_table import read_toml
from glissando.model.table import Table

TICKS = 4096  # per revolution
_RPM = 0.229  # unit of speed
_RPM2 = 214.577  # rev/min², unit of acceleration
_MOST_UNITS = 265  # speed: 60.7 rpm
_MOST_ACCELERATION = 32767
_MOST_TICKS = 1_000_000  # of the servo's ±1,048,575 in extended position mode


@dataclass(frozen=True)
class Stage(PositionStage):
    """A carriage on a lead screw that an XL430-W250 turns.

    `direction` is 1 if travel grows while the servo turns counter-clockwise; `home` is the travel
    at a mechanical stop outside the stroke.

    Attributes:
        lead: Travel per revolution, m.
        hold: Whether the torque stays on at the end.
        watchdog: Seconds without a command after which a moving servo stops by itself.
        id: ID of the servo on its bus.
        baud: Baud rate of its serial line.

    Raises:
        DeviceError: A value is out of range, such as a speed above the servo's 60.7 rpm.

    >>> Stage(lead=0.002, stroke=(0.0, 0.06))
    Traceback (most recent call last):
    glissando.errors.DeviceError: 24 mm/s would turn the screw of 2 mm lead at 720 rpm; the servo
    does 60.7 rpm, 2.02 mm/s. Ask for less, or fit a screw of at least 23.7 mm lead.
    """

    lead: float = field(kw_only=True)
    hold: bool = False
    watchdog: float = 0.2
    id: int = 1
    baud: int = 57600

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.stroke
        if not 0.0 < self.lead < math.inf:
            raise DeviceError(
                f"A lead of {self.lead:g} m cannot be; give metres a revolution above zero."
            )
        if (high - low) / self.lead * TICKS > _MOST_TICKS:
            raise DeviceError(
                f"A stroke from {low:g} to {high:g} m cannot be; give at most "
                f"{_MOST_TICKS // TICKS} revolutions."
            )
        if self.home is not None and not (self.home <= low or self.home >= high):
            raise DeviceError(
                f"Home, a mechanical stop at {self.home:g} m, lies inside the stroke from {low:g} "
                f"to {high:g} m; shorten the stroke or leave home out."
            )
        if not 0 <= self.id <= 252:
            raise DeviceError(f"A servo with id {self.id} cannot be; give 0 to 252.")
        if not 0.02 <= self.watchdog <= 2.54:
            raise DeviceError(f"A watchdog of {self.watchdog:g} s cannot be; give 0.02 to 2.54 s.")
        self.require_speed(self.speed)
        self.require_acceleration(self.acceleration)

    @classmethod
    def load(cls, path: Path, key: str = "slide") -> Self:
        """Read a stage from table `key` of a TOML file. Raises DeviceError."""
        table = read_toml(path, DeviceError).subtable(key)
        return cls.from_table(table)

    @classmethod
    def _own(cls, table: Table) -> dict[str, Any]:
        return {
            "lead": table.number("lead"),
            "hold": table.flag("hold"),
            "watchdog": table.number("watchdog", cls.watchdog),
            "id": int(table.number("id", cls.id, positive=False)),
            "baud": int(table.number("baud", cls.baud)),
        }

    def require_speed(self, speed: float) -> None:
        """Raise DeviceError unless a speed is positive and the servo can reach it."""
        if not speed > 0.0:
            raise DeviceError(f"A speed of {speed:g} m/s cannot be; give one above zero.")
        rpm, most = 60.0 * speed / self.lead, _MOST_UNITS * _RPM
        if rpm > most:
            raise DeviceError(
                f"{1e3 * speed:.4g} mm/s would turn the screw of {1e3 * self.lead:g} mm lead at "
                f"{rpm:.4g} rpm; the servo does {most:.1f} rpm, {1e3 * self.lead * most / 60:.3g} "
                f"mm/s. Ask for less, or fit a screw of at least {60e3 * speed / most:.3g} mm lead."
            )

    def require_acceleration(self, acceleration: float) -> None:
        """Raise DeviceError unless the servo's register can represent this acceleration."""
        unit = _RPM2 / 3600.0 * self.lead
        if not 0.5 * unit <= acceleration <= _MOST_ACCELERATION * unit:
            raise DeviceError(
                f"An acceleration of {acceleration:g} m/s² cannot be with a lead of "
                f"{1e3 * self.lead:g} mm; give {0.5 * unit:.2g} to "
                f"{_MOST_ACCELERATION * unit:.4g} m/s²."
            )

    def require_allowed(self, speed: float) -> None:
        """Raise DeviceError unless the servo can reach a speed and the stage allows it."""
        self.require_speed(speed)
        super().require_allowed(speed)

    def ticks(self, travel: float) -> float:
        """Signed ticks of a travel in metres."""
        return self.direction * travel / self.lead * TICKS

    def travel(self, ticks: float) -> float:
        """Signed travel in metres of a number of ticks."""
        return self.direction * ticks / TICKS * self.lead

    def speed_units(self, speed: float) -> int:
        """Register value of a speed in m/s; at least 1, as 0 means no limit."""
        return int(np.clip(round(speed / self.lead * 60.0 / _RPM), 1, _MOST_UNITS))

    def speed_of(self, units: float) -> float:
        """Signed speed in m/s of a number of the servo's units."""
        return self.direction * units * _RPM / 60.0 * self.lead

    def acceleration_units(self, acceleration: float) -> int:
        """Register value of an acceleration in m/s²; at least 1, as 0 means no limit."""
        units = acceleration / self.lead * 3600.0 / _RPM2
        return int(np.clip(round(units), 1, _MOST_ACCELERATION))

    def lasting(self, way: float, speed: float, acceleration: float) -> float:
        """Seconds from rest to rest over `way` m with a trapezoidal or triangular speed profile."""
        way, top = abs(way), min(speed, math.sqrt(abs(way) * acceleration))
        return way / top + top / acceleration if way else 0.0
