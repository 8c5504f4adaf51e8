"""Pauses of the readings: where nodes lie in them, and when a robot at rest is known as well.

A node stands for the time around it. One step over a long pause would say that the robot had been
at rest through half of it, so nodes go on at the usual step, then farther apart as the pause lasts.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from glissando.estimation.reading_buffer import ReadingBuffer

_USUAL = 1.0  # s: the usual step until two updates say what it is
_LONE = 1 / 60  # s that a node without another stands for until then: half a step at 30 Hz
_VOID = 2.0  # usual steps without a reading, which make a pause
_GROWTH = 0.2  # of the pause so far: the longest step in it
_CURVED = 0.2  # rad: where the tip's direction is known less well, belief is not linear
_LOST = 2.0  # rad: where it is known less well, the robot may as well be at rest
_GAPS, _LATE = 8, 2.0  # gaps between readings that are kept, and how often the longest is a silence

Spread = tuple[float, float]
"""RMS displacement (m) of the tip, and swing (rad) of its tangent."""


def is_curved(spread: Spread) -> bool:
    """Whether belief is too wide to be linear."""
    return spread[1] > _CURVED


class ReadingPause:
    """When a reading was heard last, and what is known of the tip since.

    Attributes:
        step: The usual step between nodes, s.
        heard: Time of the newest node with a reading, s.
        lone: What a node stands for until there is another, s: half a step.
        curved: Whether belief is too wide to be linear since nothing was read.
    """

    def __init__(self) -> None:
        self.step, self.lone, self.heard = _USUAL, _LONE, -np.inf
        self.curved = False
        self._limits: Spread | None = None
        self._gaps: deque[float] = deque(maxlen=_GAPS)
        self._heard_since_rest = False

    def next_node(self, newest: float, time: float, buffer: ReadingBuffer) -> float:
        """The next node on the way from the newest to a time, with the readings that wait."""
        if time - newest <= _VOID * self.step:
            return time
        stops = np.append(buffer.due(time), time)
        void = np.flatnonzero(np.diff(stops, prepend=newest) > _VOID * self.step)
        if not void.size:
            return time
        if void[0]:  # readings first
            return max(float(stops[void[0] - 1]), newest + self.step)
        return self.next_in_void(newest, float(stops[0]))

    def next_in_void(self, newest: float, time: float) -> float:
        """The next node on the way from the newest to a time until which nothing is read."""
        if time - newest <= _VOID * self.step:
            return time
        ahead = newest + max(self.step, _GROWTH * (newest - self.heard))
        return ahead if ahead + self.step <= time else time

    def end(self, before: float | None, newest: float) -> None:
        """Something was read in the interval between two nodes."""
        if before is not None and self.heard == before < newest:
            self.step, self.lone = newest - before, 0.5 * (newest - before)
        if self._heard_since_rest:
            self._gaps.append(newest - self.heard)
        self.heard, self.curved, self._heard_since_rest = newest, False, True

    def note(self, spread: Spread) -> None:
        """The tip is known so well, and nothing has read it since the last update."""
        self.curved = is_curved(spread)

    @property
    def has_rest(self) -> bool:
        """Whether it is known how much a robot at rest spreads."""
        return self._limits is not None

    def begin_at_rest(self) -> None:
        """What was read before says nothing more, and how often it came neither."""
        self.curved = self._heard_since_rest = False
        self._gaps.clear()

    def set_rest(self, spread: Spread, length: float) -> None:
        """Belief at rest spreads so much on a robot of that length."""
        self._limits = min(spread[0], length), min(spread[1], _LOST)

    def is_at_rest(self, spread: Spread, time: float) -> bool:
        """Whether a robot at rest is known as well as this, and all sensors are silent at a time.

        Sensors that are slower than updates are read now and then, and hold the rest of the body
        where the tip is lost.
        """
        limits = self._limits
        if limits is None or time - self.heard <= _LATE * max(self._gaps, default=0.0):
            return False
        return spread[0] >= limits[0] or spread[1] >= limits[1]
