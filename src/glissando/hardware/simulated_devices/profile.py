"""How a servo's set point moves: trapezoids, triangles, rectangles and constant speeds."""

from __future__ import annotations

import math
from dataclasses import dataclass

Piece = tuple[float, float, float]
"""Duration, speed at its beginning, acceleration."""


@dataclass(frozen=True)
class Profile:
    """A motion from `position` at time `start` by pieces of constant acceleration, then rest.

    Any unit of length; seconds.
    """

    start: float
    position: float
    pieces: tuple[Piece, ...] = ()

    @property
    def duration(self) -> float:
        """Seconds until rest; infinite for a constant speed."""
        return sum(piece[0] for piece in self.pieces)

    def at(self, time: float) -> tuple[float, float]:
        """Position and speed at a time.

        >>> to(0.0, 0.0, 0.0, 60.0, speed=24.0, acceleration=100.0).at(1.0)
        (21.12, 24.0)
        """
        position, left = self.position, max(time - self.start, 0.0)
        for duration, speed, acceleration in self.pieces:
            into = min(left, duration)
            position += into * (speed + 0.5 * acceleration * into)
            if left < duration:
                return position, speed + acceleration * into
            left -= duration
        return position, 0.0


def to(
    start: float,
    position: float,
    speed_now: float,
    goal: float,
    *,
    speed: float,
    acceleration: float,
) -> Profile:
    """From a position and speed to rest at a goal, at most this fast and this sharp.

    Without acceleration, 0, speed changes at once: a rectangle.
    """
    way = goal - position
    if acceleration <= 0.0:
        level = (abs(way) / speed, math.copysign(speed, way), 0.0)
        return Profile(start, position, (level,) if way else ())
    braking = 0.5 * speed_now * abs(speed_now) / acceleration  # the way it takes to stop
    if way * speed_now < 0.0 or abs(braking) > abs(way):
        stop = (abs(speed_now) / acceleration, speed_now, -math.copysign(acceleration, speed_now))
        rest = to(start, position + braking, 0.0, goal, speed=speed, acceleration=acceleration)
        return Profile(start, position, (stop, *rest.pieces))
    sign, now, left = math.copysign(1.0, way), abs(speed_now), abs(way)
    top = min(speed, math.sqrt(acceleration * left + 0.5 * now**2))
    change, brake = abs(top - now) / acceleration, top / acceleration
    even = left - 0.5 * change * (top + now) - 0.5 * brake * top  # the way at constant speed
    ramps = (
        (change, sign * now, sign * math.copysign(acceleration, top - now)),
        (max(even, 0.0) / top if top else 0.0, sign * top, 0.0),
        (brake, sign * top, -sign * acceleration),
    )
    return Profile(start, position, tuple(ramp for ramp in ramps if ramp[0] > 0.0))


def at_speed(
    start: float, position: float, speed_now: float, speed: float, *, acceleration: float
) -> Profile:
    """From a position and speed to a constant speed, for ever."""
    change = speed - speed_now
    ramp: tuple[Piece, ...] = ()
    if acceleration > 0.0 and change:
        ramp = ((abs(change) / acceleration, speed_now, math.copysign(acceleration, change)),)
    return Profile(start, position, (*ramp, (math.inf, speed, 0.0)) if speed else ramp)
