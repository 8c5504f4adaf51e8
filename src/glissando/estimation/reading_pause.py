"""Pauses of the readings: where nodes lie in them, and when a robot at rest is known as well.

A node stands for the time around it. One step over a long pause would say that the robot had been
at rest through half of it, so nodes go on at the usual step, then farther apart as the pause lasts.
"""

from __future__ import annotations

import numpy as np

from glissando.estimation.reading_buffer import ReadingBuffer

_USUAL = 1.0  # s: the usual step until two updates say what it is
_LONE = 1 / 60  # s that a node without another stands for until then: half a step at 30 Hz
_VOID = 2.0  # usual steps without a reading, which make a pause
_GROWTH = 0.2  # of the pause so far: the longest step in it
_CURVED = 0.2  # rad: where the tip's direction is known less well, belief is not linear
_LOST = 2.0  # rad: where it is known less well, the robot may as well be at rest

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
        curved: Whether belief is too wide to be linear, and nothing was read.
    """

    def __init__(self) -> None:
        self.step, self.lone, self.heard = _USUAL, _LONE, -np.inf
        self.curved = False
        self._limits: Spread | None = None

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
        self.heard, self.curved = newest, False

    def note(self, spread: Spread) -> None:
        """Nothing was read, and this is what is known of the tip."""
        self.curved = is_curved(spread)

    @property
    def has_rest(self) -> bool:
        """Whether it is known how much a robot at rest spreads."""
        return self._limits is not None

    def set_rest(self, spread: Spread, length: float) -> None:
        """Belief at rest spreads so much on a robot of that length."""
        self._limits = min(spread[0], length), min(spread[1], _LOST)

    def is_at_rest(self, spread: Spread) -> bool:
        """Whether a robot at rest is known as well as this."""
        limits = self._limits
        return limits is not None and (spread[0] >= limits[0] or spread[1] >= limits[1])
