"""Motion of a slide from its readings, over a whole recording or online."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import Any

import numpy as np

from glissando.geometry.se3 import Array

_TURN = 2e-4  # m of travel over which the direction changes after a reversal
_MOST = 1024  # readings of the slide that are kept
_AHEAD = 0.1  # s for which motion is extrapolated beyond the newest reading
_APART = 1.0  # s: longer gaps give no speed, and no travel after the newest reading


@dataclass(frozen=True)
class SlideMotion:
    """Travel, speed and direction of a slide at one time.

    Attributes:
        travel: Travel, m.
        speed: Rate of the travel, m/s.
        way: Direction of the last motion, −1 to 1, see `slide_motion`.
    """

    travel: float
    speed: float = 0.0
    way: float = 0.0


class SlideTrack:
    """Record of a slide's readings up to the present."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, SlideMotion]] = deque(maxlen=_MOST)

    @property
    def known(self) -> bool:
        """Whether there is any reading."""
        return bool(self._readings)

    def add(self, time: float, travel: float) -> None:
        """Add a reading of the travel, m, at a time, s; one that is not newer is ignored."""
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
        """Motion at a time, s; None before the first reading and a second after the newest.

        Travel is interpolated linearly between readings, and extrapolated at the last speed for a
        tenth of a second beyond the newest.
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
    """Fields `slide_speed` and `slide_way` of a sliding sensor's readings.

    They are its speed (M,), m/s, and the direction of its last motion (M,), −1 to 1.

    The speed is the mean since the reading before, so that correcting for a shorter lag leads to a
    place between the two. The direction is zero until the sensor moves, and after a reversal
    changes over 0.2 mm of travel, in which a tube's play is taken up.
    """
    if not np.any(np.diff(arclength)):
        return {"slide_speed": np.zeros(()), "slide_way": np.zeros(())}
    moved, lasts = np.diff(arclength, prepend=arclength[:1]), np.diff(time, prepend=time[:1])
    speed = np.divide(moved, lasts, out=np.zeros_like(moved), where=lasts > 0.0)
    return {"slide_speed": speed, "slide_way": side_of_play(arclength, _TURN)}


def side_of_play(travel: Array, width: float) -> Array:
    """Side (L,) of a play of some width, m, at which a slide is after travel (L,), −1 to 1.

    >>> side_of_play(np.array([0.0, 1e-3, 2e-3, 1e-3]), 1e-4).tolist()
    [0.0, 1.0, 1.0, -1.0]
    """
    sides = accumulate(np.diff(travel).tolist(), partial(_side_after, width), initial=0.0)
    return np.array(list(sides))


def _side_after(width: float, side: float, moved: float) -> float:
    """Side of the play after a step of travel, m, from the side before the step."""
    return min(1.0, max(-1.0, side + moved / (0.5 * width)))
