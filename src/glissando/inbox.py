"""Readings on their way into an online estimator: those that wait, and those it holds."""

from __future__ import annotations

import numpy as np

from glissando.errors import SensorError
from glissando.gate import Gate
from glissando.readings import Readings
from glissando.se3 import Array

_AHEAD = 2.0  # s: stamps further ahead of the newest node are a clock's fault


class Inbox:
    """Readings by stream on a robot of some `length`; what is refused is counted by the `gate`.

    `held` are those in the window, in order of arrival; others wait until time reaches them.
    """

    def __init__(self, length: float, gate: Gate) -> None:
        self.held: dict[str, Readings] = {}
        self._waiting: dict[str, Readings] = {}
        self._length, self._gate = length, gate

    def take(self, readings: Readings, span: tuple[float, float] | None) -> None:
        """Let readings of one stream wait; `span` is from the oldest to the newest node.

        Those off the robot, before the span, absurdly far after it, or there already are refused.
        Raises SensorError when the stream changed its kind.
        """
        name, refuse = readings.label, self._gate.refuse
        before = self._waiting.get(name, self.held.get(name))
        if before is not None and type(before) is not type(readings):
            raise SensorError(f"{name} was {type(before).__name__}; name each stream by itself.")
        kept = np.ones(len(readings), dtype=bool)
        kept &= refuse(name, "off the robot", kept & ~self._on_robot(readings))
        if span is not None:
            kept &= refuse(name, "late", kept & (readings.time < span[0]))
            kept &= refuse(name, "ahead", kept & (readings.time > span[1] + _AHEAD))
        kept &= refuse(name, "repeated", kept & self._repeated(readings))
        readings = readings.select(kept)
        if len(readings):
            waiting = self._waiting.get(name)
            self._waiting[name] = readings if waiting is None else waiting.joined(readings)

    def _on_robot(self, readings: Readings) -> np.ndarray:
        slack = 1e-9 * self._length
        reached = readings.arclength <= self._length + slack
        return (readings.arclength >= -slack) & reached

    def _repeated(self, readings: Readings) -> np.ndarray:
        """Rows that have a stamp of before; at one moment a stream may read several places."""
        seen = np.diff(np.column_stack([readings.time, readings.arclength]), axis=0, prepend=np.nan)
        again = ~np.any(seen != 0.0, axis=1)
        for other in (self.held.get(readings.label), self._waiting.get(readings.label)):
            if other is not None and len(other):
                same = readings.time[:, None] == other.time
                same &= readings.arclength[:, None] == other.arclength
                again |= np.any(same, axis=1)
        return again

    def arrive(self, oldest: float, until: float) -> dict[str, Array]:
        """Hold what waits up to a time; times of the new rows by stream."""
        fresh = {}
        for name, waiting in list(self._waiting.items()):
            due = waiting.time <= until
            if not np.any(due):
                continue
            now = waiting.select(due)
            now = now.select(self._gate.refuse(name, "late", now.time < oldest))
            if np.all(due):
                del self._waiting[name]
            else:
                self._waiting[name] = waiting.select(~due)
            if len(now) == 0:
                continue
            held = self.held.get(name)
            self.held[name] = now if held is None or not len(held) else held.joined(now)
            fresh[name] = now.time
        return fresh

    def since(self, begin: float) -> list[Readings]:
        """Held readings at and after a time, a stream each."""
        found = [r.select(r.time >= begin) for r in self.held.values()]
        return [r for r in found if len(r)]

    def discard(self, name: str, time: float, arclength: float) -> None:
        """Let go of a reading that is beyond belief."""
        held = self.held[name]
        out = (held.time == time) & (held.arclength == arclength)
        self.held[name] = held.select(self._gate.refuse(name, "gated", out))

    def forget(self, oldest: float) -> None:
        """Let go of what is older."""
        for name, held in self.held.items():
            if len(held) and held.time.min() < oldest:
                self.held[name] = held.select(held.time >= oldest)
