"""Tendon tensions and loads over time, from shapes of robot files or from TOML files."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.mechanics import strange_gravity
from glissando.model.table import Table
from glissando.simulation.rod import Loads, Wrench


@dataclass(frozen=True)
class Actuation:
    """Tendon tensions over time with constant loads; tensions are interpolated by 3x² − 2x³.

    Attributes:
        time: Times (K,), s.
        tensions: Tension of every tendon at these times (K, T), N.
        gravity: Gravity (3,) in the world frame, m/s².
        wrenches: Dead loads.
    """

    time: Array
    tensions: Array
    gravity: Array
    wrenches: tuple[Wrench, ...] = ()

    def loads_at(self, time: float) -> Loads:
        """Loads at a time, s; constant before the first and after the last time."""
        last = self.time.size - 1
        k = int(np.clip(np.searchsorted(self.time, time, "right") - 1, 0, last))
        tensions = self.tensions[k]
        if k < last:
            x = np.clip((time - self.time[k]) / (self.time[k + 1] - self.time[k]), 0.0, 1.0)
            tensions = tensions + x * x * (3.0 - 2.0 * x) * (self.tensions[k + 1] - tensions)
        return Loads(tensions, self.gravity, self.wrenches)

    def lasting(self, duration: float) -> Actuation:
        """Copy with the times scaled to run from 0 to `duration` seconds."""
        if self.time.size == 1:
            return self
        start, stop = self.time[0], self.time[-1]
        return replace(self, time=(self.time - start) * (duration / (stop - start)))


def read_actuation(table: Table, tendons: int, gravity: Array) -> Actuation:
    """Read an actuation: tensions, time (one per row of tensions), gravity, and [[loads]].

    Args:
        table: The table.
        tendons: Number of tendons.
        gravity: Default gravity (3,) if the table has none, m/s².

    Raises:
        SimulationError: A key is missing, misspelt or impossible.
    """
    tensions = table.matrix("tensions", tendons)
    time = np.zeros(1)
    if len(tensions) > 1 or table.peek("time") is not None:
        time = table.vector("time", len(tensions))
        if np.any(np.diff(time) <= 0.0):
            raise table.fail("time", f"is {time.tolist()}; give times that increase.")
    if np.any(tensions < 0.0):
        raise table.fail("tensions", f"is {tensions.tolist()}; a tendon only pulls, give N ≥ 0.")
    gravity = table.vector("gravity", 3, gravity)
    if strange := strange_gravity(gravity):
        raise table.fail("gravity", strange)
    wrenches = []
    for entry in table.tables("loads"):
        force, moment = (entry.vector(key, 3, np.zeros(3)) for key in ("force", "moment"))
        wrenches.append(Wrench(entry.number("arclength"), force, moment))
        entry.close()
    table.close()
    return Actuation(time, tensions, gravity, tuple(wrenches))
