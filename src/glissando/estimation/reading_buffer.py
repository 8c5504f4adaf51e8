"""Readings on their way into an online estimator: those that wait, and those it holds."""

from __future__ import annotations

from collections import Counter

import numpy as np

from glissando.errors import SensorError
from glissando.estimation.innovation_gate import InnovationGate
from glissando.model.sensors.readings import Readings

_AHEAD = 2.0  # s: stamps further ahead of the time now are a clock's fault
_FEW = 100_000  # pairs of stamps that are compared each with each
_SPARE = 32  # old readings of a stream that are held before they are let go of at once


class ReadingBuffer:
    """Readings by stream on a robot of some `length`; what is refused is counted by the `gate`.

    `held` are those in the window, in order of arrival; others wait until time reaches them.
    """

    def __init__(self, length: float, gate: InnovationGate) -> None:
        self.held: dict[str, Readings] = {}
        self._waiting: dict[str, Readings] = {}
        self._last: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._measured: set[str] = set()
        self._length, self._gate = length, gate

    def take(self, readings: Readings, oldest: float) -> None:
        """Let readings of one stream wait; `oldest` is the time of the oldest node.

        Those off the robot, before that node, or there already are refused, and those of a tracker
        that stopped measuring: no measurement has all digits of the one before. Raises SensorError
        when the stream changed its kind.
        """
        name = readings.label
        before = self._waiting.get(name, self.held.get(name))
        if before is not None and type(before) is not type(readings):
            raise SensorError(f"{name} was {type(before).__name__}; name each stream by itself.")
        time, place, channel = readings.time, readings.arclength, readings.channel
        low, high = channel.travels(self._length) if channel else (0.0, self._length)
        slack = 1e-9 * self._length
        faults = [("off the robot", (place < low - slack) | (place > high + slack))]
        faults += [("late", time < oldest), ("repeated", self._repeated(readings))]
        if readings.tracker:
            faults.append(("repeated", self._frozen(readings)))
        kept = np.ones(len(readings), dtype=bool)
        for reason, bad in faults:
            if bad.any():
                kept &= self._gate.refuse(name, reason, kept & bad)
        readings = readings.select(kept)
        if len(readings):
            waiting = self._waiting.get(name)
            self._waiting[name] = readings if waiting is None else waiting.joined(readings)

    def _repeated(self, readings: Readings) -> np.ndarray:
        """Rows that have a stamp of before; at one moment a stream may read several places."""
        time, place = readings.time, readings.arclength
        again = np.zeros(len(readings), dtype=bool)
        if len(readings) > 1:
            again[1:] = (time[1:] == time[:-1]) & (place[1:] == place[:-1])
        for other in (self.held.get(readings.label), self._waiting.get(readings.label)):
            if other is None or not len(other) or time.min(initial=np.inf) > other.time.max():
                continue
            if time.size * other.time.size <= _FEW:
                same = (time[:, None] == other.time) & (place[:, None] == other.arclength)
                again |= same.any(axis=1)
            else:
                again |= np.isin(time + 1j * place, other.time + 1j * other.arclength)
        return again

    def _frozen(self, readings: Readings) -> np.ndarray:
        """Rows whose values are those of the row before; none of a stream that never changed."""
        values, place = readings.values, readings.arclength
        if not len(readings):
            return np.zeros(0, dtype=bool)
        before = self._last.get(readings.label)
        self._last[readings.label] = values[-1:], place[-1:]
        if before is not None:
            values, place = np.concatenate([before[0], values]), np.concatenate([before[1], place])
        flat = values.reshape(len(values), -1)
        same = (flat[1:] == flat[:-1]).all(axis=1)
        again = readings.repeated(values, place) if same.any() else np.zeros(len(values), bool)
        if not same.all():
            self._measured.add(readings.label)
        elif readings.label not in self._measured:
            again[:] = False
        return again[-len(readings) :]

    def due(self, until: float) -> np.ndarray:
        """Times of readings that wait up to a time, in order."""
        waiting = [r.time[r.time <= until] for r in self._waiting.values()]
        return np.sort(np.concatenate([np.zeros(0), *waiting]))

    def refuse_ahead(self, now: float) -> None:
        """Refuse readings that wait with stamps absurdly far ahead of the time now."""
        for name, waiting in list(self._waiting.items()):
            ahead = waiting.time > now + _AHEAD
            if ahead.any():
                self._waiting[name] = waiting.select(self._gate.refuse(name, "ahead", ahead))

    def arrive(self, oldest: float, until: float) -> tuple[Counter[str], float]:
        """Hold what waits up to a time; how many rows of each stream are new, and their earliest.

        New rows are the last that are held of a stream.
        """
        fresh: Counter[str] = Counter()
        earliest = np.inf
        for name, waiting in list(self._waiting.items()):
            due = waiting.time <= until
            if not due.any():
                continue
            now = waiting.select(due)
            if now is waiting:
                del self._waiting[name]
            else:
                self._waiting[name] = waiting.select(~due)
            late = now.time < oldest
            if late.any():
                now = now.select(self._gate.refuse(name, "late", late))
            if len(now) == 0:
                continue
            held = self.held.get(name)
            self.held[name] = now if held is None or not len(held) else held.joined(now)
            fresh[name], earliest = len(now), min(earliest, float(now.time.min()))
        return fresh, earliest

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
        """Let go of what is older, of many at once."""
        for name, held in self.held.items():
            if np.count_nonzero(held.time < oldest) > _SPARE:
                self.held[name] = held.select(held.time >= oldest)
