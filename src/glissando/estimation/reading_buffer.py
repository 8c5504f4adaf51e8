"""Buffer of an online estimator: readings that wait, and readings in the window."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import reduce
from itertools import pairwise

import numpy as np

from glissando.errors import SensorError
from glissando.estimation.held_readings import HeldReadings
from glissando.estimation.innovation_gate import InnovationGate
from glissando.model.sensors.compiled_readings import CompiledReadings, ReadingRows
from glissando.model.sensors.readings import Readings
from glissando.model.tendons.channel import ends_of

_AHEAD = 2.0  # s: time stamps further ahead of the present are errors of a clock
_FEW = 100_000  # most pairs of time stamps that are compared directly
_SPARE = 64  # readings and parts of streams that are held before old ones are discarded


class ReadingBuffer:
    """Buffers readings by stream on a robot of some `length`; the `gate` counts refused ones.

    Readings in the window are held in order of arrival; others wait until time reaches them.
    Readings that the window `takes_as_row` are stored as rows as well.
    """

    def __init__(
        self, length: float, gate: InnovationGate, takes_as_row: Callable[[Readings], bool]
    ) -> None:
        self._held: dict[str, list[Readings]] = {}  # in parts, as they came
        self._waiting: dict[str, Readings] = {}
        self._last: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._newest: dict[str, float] = {}
        self._measured: set[str] = set()
        self._rows, self._takes_as_row = ReadingRows(), takes_as_row
        self._numbers: dict[str, int] = {}
        self._labels: list[tuple[str, int]] = []  # label and residuals of a reading, by number
        self._single: set[str] = set()  # streams that are not stored as rows
        self._length, self._gate, self._many = length, gate, _SPARE

    def take(self, readings: Readings, oldest: float) -> None:
        """Let readings of one stream wait; `oldest` is the time of the oldest node.

        Readings off the robot, before that node, or repeated are refused, and those of a tracker
        that stopped measuring, as no measurement repeats all digits of the one before. Raises
        SensorError if the stream had readings of another class before.
        """
        name, time, place = readings.label, readings.time, readings.arclength
        before = self._waiting.get(name)
        parts = self._held.get(name)
        if before is None and parts:
            before = parts[-1]
        if before is not None and type(before) is not type(readings):
            raise SensorError(f"{name} was {type(before).__name__}; name each stream by itself.")
        if not len(readings):
            return
        channel, slack = readings.channel, 1e-9 * self._length
        low, high = ends_of(channel, self._length)
        times, (lowest, highest) = time.tolist(), _ends(place)
        first, last = min(times), max(times)
        faults: list[tuple[str, np.ndarray | None]] = []
        if lowest < low - slack or highest > high + slack:
            faults += [("off the robot", (place < low - slack) | (place > high + slack))]
        if first < oldest:
            faults += [("late", time < oldest)]
        newest = self._newest.get(name, -np.inf)
        if first <= newest or any(b <= a for a, b in pairwise(times)):
            faults += [("repeated", self._repeated(readings))]
        if readings.tracker:
            faults += [("repeated", self._frozen(readings))]
        bad_ones = [(reason, bad) for reason, bad in faults if bad is not None and bad.any()]
        if bad_ones:
            good = np.ones(len(readings), dtype=bool)
            for reason, bad in bad_ones:
                good &= self._gate.refuse(name, reason, good & bad)
            readings = readings.select(good)
        if len(readings):
            waiting = self._waiting.get(name)
            self._waiting[name] = readings if waiting is None else waiting.joined(readings)
            self._newest[name] = max(last, newest)

    def _repeated(self, readings: Readings) -> np.ndarray:
        """Mask of rows with the time and place of an earlier row; one time may have many places."""
        time, place = readings.time, readings.arclength
        again = np.zeros(len(readings), dtype=bool)
        order = np.lexsort((place, time))  # repeated rows stay in order
        same = (np.diff(time[order]) == 0.0) & (np.diff(place[order]) == 0.0)
        again[order[1:]] = same
        if time.min() > self._newest.get(readings.label, -np.inf):
            return again
        for other in (self._all_held(readings.label), self._waiting.get(readings.label)):
            if other is None or not len(other) or time.min() > other.time.max():
                continue
            if time.size * other.time.size <= _FEW:
                same = (time[:, None] == other.time) & (place[:, None] == other.arclength)
                again |= same.any(axis=1)
            else:
                again |= np.isin(time + 1j * place, other.time + 1j * other.arclength)
        return again

    def _frozen(self, readings: Readings) -> np.ndarray | None:
        """Mask of rows with the values of the row before; None if the stream never changed."""
        label, values, place = readings.label, readings.values, readings.arclength
        time, before = readings.time, self._last.get(label)
        several = len(time) > 1 and time[-2] == time[-1]  # several places at one time
        last = time == time[-1] if several else slice(-1, None)
        self._last[label] = values[last], place[last]
        count = 0 if before is None else len(before[0])
        if before is not None:
            if len(values) == 1 == count and not (values == before[0]).all():
                self._measured.add(label)
                return None
            values, place = np.concatenate([before[0], values]), np.concatenate([before[1], place])
        flat = values.reshape(len(values), -1)
        if several or count > 1:  # places are compared with themselves
            order = np.argsort(place, kind="stable")
            flat = flat[order]
            same = (flat[1:] == flat[:-1]).all(axis=1)[np.diff(place[order]) == 0.0]
        else:
            same = (flat[1:] == flat[:-1]).all(axis=1)
        if not same.all():
            self._measured.add(label)
        if not (same.any() and label in self._measured):
            return None
        again = readings.repeated(values, place)
        return again[count:]

    def due(self, until: float) -> np.ndarray:
        """Times of waiting readings up to a time, in order."""
        waiting = [r.time[r.time <= until] for r in self._waiting.values()]
        return np.sort(np.concatenate([np.zeros(0), *waiting]))

    def refuse_ahead(self, now: float) -> None:
        """Refuse waiting readings whose time stamps are too far ahead of the present."""
        if max(self._newest.values(), default=now) <= now + _AHEAD:
            return
        for name, waiting in list(self._waiting.items()):
            if len(waiting) and _ends(waiting.time)[1] > now + _AHEAD:
                ahead = waiting.time > now + _AHEAD
                waiting = waiting.select(self._gate.refuse(name, "ahead", ahead))
                self._waiting[name] = waiting
                left = (
                    r.time.max()
                    for r in (waiting, self._all_held(name))
                    if r is not None and len(r)
                )
                self._newest[name] = float(max(left, default=-np.inf))

    def arrive(self, oldest: float, until: float) -> tuple[Counter[str], float]:
        """Hold waiting readings up to a time; number of new rows by stream, and the earliest time.

        New rows are the last of the rows held of a stream.
        """
        fresh: Counter[str] = Counter()
        earliest, self._rows.old = np.inf, self._rows.count
        for name, now in list(self._waiting.items()):
            first, last = _ends(now.time) if len(now) else (np.inf, np.inf)
            if first > until:
                continue
            if last > until:
                due = now.time <= until
                self._waiting[name], now = now.select(~due), now.select(due)
            else:
                del self._waiting[name]
            if first < oldest:
                now = now.select(self._gate.refuse(name, "late", now.time < oldest))
                if not len(now):
                    continue
                first = float(now.time.min())
            self._hold(name, now)
            fresh[name], earliest = len(now), min(earliest, first)
        return fresh, earliest

    def _hold(self, name: str, readings: Readings) -> None:
        """Append readings to those held of a stream."""
        self._held.setdefault(name, []).append(readings)
        if name in self._single:
            return
        if not self._takes_as_row(readings):
            self._single.add(name)
            if name in self._numbers:
                number = self._numbers[name]
                self._rows.keep(self._rows.stream[: self._rows.count] != number)
            return
        if name not in self._numbers:
            self._numbers[name] = len(self._labels)
            self._labels.append((name, readings.row_count))
        assert isinstance(readings, CompiledReadings)
        self._rows.append(self._numbers[name], readings)

    def _all_held(self, name: str) -> Readings | None:
        """Held readings of a stream, joined."""
        parts = self._held.get(name)
        if not parts:
            return None
        if len(parts) > 1:
            parts[:] = [reduce(lambda one, other: one.joined(other), parts)]
        return parts[0]

    def streams(self, begin: float, *, single: bool = False) -> list[Readings]:
        """Held readings at and after a time, by stream; `single` for those not stored as rows."""
        names = (name for name in self._held if name in self._single or not single)
        held = (self._all_held(name) for name in names)
        recent = [r.select(r.time >= begin) for r in held if r is not None]
        return [r for r in recent if len(r)]

    def since(self, begin: float) -> HeldReadings:
        """Held readings at and after a time, as rows or by stream."""
        which = (self._rows.time >= begin).nonzero()[0]
        single = self.streams(begin, single=True) if self._single else []
        return HeldReadings(single, self._rows, which, self._labels)

    def discard(self, name: str, time: float, arclength: float) -> None:
        """Discard a reading that the gate refuses."""
        held, rows = self._all_held(name), self._rows
        assert held is not None
        out = (held.time == time) & (held.arclength == arclength)
        self._held[name] = [held.select(self._gate.refuse(name, "gated", out))]
        if name in self._numbers and name not in self._single:
            out = (rows.time == time) & (rows.arclength == arclength)
            rows.keep(~(out & (rows.stream[: rows.count] == self._numbers[name])))

    def forget(self, oldest: float) -> None:
        """Discard readings older than a time, as soon as there are many."""
        if sum(map(len, self._held.values())) + self._rows.count < self._many:
            return
        for name, parts in self._held.items():
            ends = [_ends(part.time) if len(part) else (-np.inf, -np.inf) for part in parts]
            self._held[name] = [
                part if first >= oldest else part.select(part.time >= oldest)
                for part, (first, last) in zip(parts, ends, strict=True)
                if last >= oldest
            ]
        self._rows.keep(self._rows.time >= oldest)
        self._many = _SPARE + 2 * (sum(map(len, self._held.values())) + self._rows.count)


def _ends(values: np.ndarray) -> tuple[float, float]:
    """Smallest and largest of some values, usually few."""
    each = values.tolist() if values.size < _SPARE else (values.min(), values.max())
    return min(each), max(each)
