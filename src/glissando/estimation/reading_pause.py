"""Pauses of the readings: time nodes in a pause, and when the estimate returns to rest.

A node represents the time around it. One step over a long pause would imply that the robot was at
rest through half of it, so nodes continue at the usual step, then farther apart as the pause lasts.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from glissando.estimation.reading_buffer import ReadingBuffer

_USUAL = 1.0  # s: the usual step until two updates determine it
_LONE = 1 / 60  # s that a single node represents until then: half a step at 30 Hz
_VOID = 2.0  # usual steps without a reading that make a pause
_GROWTH = 0.2  # share of the pause so far: the longest step in it
_CURVED = 0.2  # rad: std of the tip's direction above which the estimate is not linear
_LOST = 2.0  # rad: std of the tip's direction above which the estimate returns to rest
_GAPS, _LATE = 8, 2.0  # gaps between readings that are kept; times the longest that make a silence

Spread = tuple[float, float]
"""RMS displacement (m) of the tip, and swing (rad) of its tangent."""


def is_curved(spread: Spread) -> bool:
    """Whether the spread is too large for a linear estimate."""
    return spread[1] > _CURVED


class ReadingPause:
    """Time since the last reading, and the uncertainty of the tip in a pause.

    Attributes:
        step: The usual step between nodes, s.
        heard: Time of the newest node with a reading, s.
        lone: Time that a single node represents until there is another, s: half a step.
        curved: Whether the estimate is too uncertain to be linear since the last reading.
    """

    def __init__(self) -> None:
        self.step, self.lone, self.heard = _USUAL, _LONE, -np.inf
        self.curved = False
        self._limits: Spread | None = None
        self._gaps: deque[float] = deque(maxlen=_GAPS)
        self._heard_since_rest = False

    def next_node(self, newest: float, time: float, buffer: ReadingBuffer) -> float:
        """Time of the next node on the way from the newest to a time, given waiting readings."""
        if time - newest <= _VOID * self.step:
            return time
        stops = np.append(buffer.due(time), time)
        void = np.flatnonzero(np.diff(stops, prepend=newest) > _VOID * self.step)
        if not void.size:
            return time
        if void[0]:  # readings come first
            return max(float(stops[void[0] - 1]), newest + self.step)
        return self.next_in_void(newest, float(stops[0]))

    def next_in_void(self, newest: float, time: float) -> float:
        """Time of the next node on the way to a time until which there are no readings."""
        if time - newest <= _VOID * self.step:
            return time
        ahead = newest + max(self.step, _GROWTH * (newest - self.heard))
        return ahead if ahead + self.step <= time else time

    def end(self, before: float | None, newest: float) -> None:
        """Record that there are readings in the interval between two nodes."""
        if before is not None and self.heard == before < newest:
            self.step, self.lone = newest - before, 0.5 * (newest - before)
        if self._heard_since_rest:
            self._gaps.append(newest - self.heard)
        self.heard, self.curved, self._heard_since_rest = newest, False, True

    def note(self, spread: Spread) -> None:
        """Record the spread of the tip after an update without readings."""
        self.curved = is_curved(spread)

    @property
    def has_rest(self) -> bool:
        """Whether the spread at rest has been set."""
        return self._limits is not None

    def begin_at_rest(self) -> None:
        """Forget earlier readings and the gaps between them."""
        self.curved = self._heard_since_rest = False
        self._gaps.clear()

    def set_rest(self, spread: Spread, length: float) -> None:
        """Set the spread of the tip at rest, for a robot of that length."""
        self._limits = min(spread[0], length), min(spread[1], _LOST)

    def is_at_rest(self, spread: Spread, time: float) -> bool:
        """Whether the tip is as uncertain as at rest, and all sensors are silent at a time.

        Sensors that are slower than updates have readings now and then, which determine the rest of
        the body even where the tip is uncertain.
        """
        limits = self._limits
        if limits is None or time - self.heard <= _LATE * max(self._gaps, default=0.0):
            return False
        return spread[0] >= limits[0] or spread[1] >= limits[1]
