"""How a slide moved: over a whole recording, or while its readings still come in."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import Any

import numpy as np

from glissando.geometry.se3 import Array

_TURN = 2e-4  # m, over which a slide that turns is said to move the other way
_MOST = 1024  # readings of the slide that are kept
_AHEAD = 0.1  # s beyond its newest reading for which it is said to go on
_APART = 1.0  # s between readings that say nothing of a speed, or after one, of the travel


@dataclass(frozen=True)
class SlideMotion:
    """A slide at a time.

    Attributes:
        travel: Its travel, m.
        speed: How fast that grew, m/s.
        way: Which way it moved last, −1 to 1, see `slide_motion`.
    """

    travel: float
    speed: float = 0.0
    way: float = 0.0


class SlideTrack:
    """The readings of a slide up to now."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, SlideMotion]] = deque(maxlen=_MOST)

    @property
    def known(self) -> bool:
        """Whether it was read at all."""
        return bool(self._readings)

    def add(self, time: float, travel: float) -> None:
        """Add a reading of the travel, m, at a time, s; one that is not newer is left out."""
        if not self._readings:
            self._readings.append((time, SlideMotion(travel)))
            return
        before, last = self._readings[-1]
        if time > before:
            moved = travel - last.travel
            speed = moved / (time - before) if time - before < _APART else 0.0
            way = _side_after(_TURN, last.way, moved)
            self._readings.append((time, SlideMotion(travel, speed, way)))

    def at(self, time: float) -> SlideMotion | None:
        """The slide at a time, s; None before its first reading, and a second after its newest.

        Between two readings it moves straight, and beyond the newest goes on for a tenth of a
        second as it did.
        """
        after: tuple[float, SlideMotion] | None = None
        for when, motion in reversed(self._readings):
            if when <= time:
                if after is None and time - when > _APART:
                    return None
                return self._between(when, motion, after, time)
            after = when, motion
        return None

    @staticmethod
    def _between(
        when: float, motion: SlideMotion, after: tuple[float, SlideMotion] | None, time: float
    ) -> SlideMotion:
        lasts, speed = min(time - when, _AHEAD), motion.speed
        if after is not None:
            lasts, speed = time - when, (after[1].travel - motion.travel) / (after[0] - when)
        moved = speed * lasts
        return SlideMotion(motion.travel + moved, speed, _side_after(_TURN, motion.way, moved))


def slide_motion(time: Array, arclength: Array) -> dict[str, Any]:
    """The fields `slide_speed` and `slide_way` of a sliding sensor's readings.

    They are how fast it moved (M,), m/s, and which way it moved last (M,), −1 to 1.

    The speed is that since the reading before, so that a lag shorter than this leads between the
    two. The way is zero until the sensor moves, and turns over 0.2 mm of travel, as a tube's play
    is taken up.
    """
    if not np.any(np.diff(arclength)):
        return {"slide_speed": np.zeros(()), "slide_way": np.zeros(())}
    moved, lasts = np.diff(arclength, prepend=arclength[:1]), np.diff(time, prepend=time[:1])
    speed = np.divide(moved, lasts, out=np.zeros_like(moved), where=lasts > 0.0)
    return {"slide_speed": speed, "slide_way": side_of_play(arclength, _TURN)}


def side_of_play(travel: Array, width: float) -> Array:
    """On which side (L,) of a play, its width in m, travel (L,) has left a slide, from −1 to 1.

    >>> side_of_play(np.array([0.0, 1e-3, 2e-3, 1e-3]), 1e-4).tolist()
    [0.0, 1.0, 1.0, -1.0]
    """
    sides = accumulate(np.diff(travel).tolist(), partial(_side_after, width), initial=0.0)
    return np.array(list(sides))


def _side_after(width: float, side: float, moved: float) -> float:
    """The side of a play after a step, m, from that before it."""
    return min(1.0, max(-1.0, side + moved / (0.5 * width)))
