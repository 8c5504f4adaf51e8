"""How a servo's set point moves from rest: trapezoids, triangles and rectangles of speed."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Profile:
    """A motion by pieces of constant acceleration, then rest.

    Attributes:
        start: Time, s.
        position: Position at that time, in any unit of length.
        pieces: Duration, speed at its beginning, and acceleration of each piece.
    """

    start: float
    position: float
    pieces: tuple[tuple[float, float, float], ...] = ()

    @property
    def duration(self) -> float:
        """Seconds until rest."""
        return sum(piece[0] for piece in self.pieces)

    def at(self, time: float) -> tuple[float, float]:
        """Position and speed at a time.

        >>> to(0.0, 0.0, 60.0, speed=24.0, acceleration=100.0).at(1.0)
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


def to(start: float, position: float, goal: float, *, speed: float, acceleration: float) -> Profile:
    """From rest to rest at a goal; a rectangle of speed without acceleration, 0.

    Args:
        start: When it begins, s.
        position: Where it begins.
        goal: Where it ends.
        speed: Largest speed.
        acceleration: Size of the acceleration; 0 changes speed at once.
    """
    way = goal - position
    if not way:
        return Profile(start, position)
    if acceleration <= 0.0:
        return Profile(start, position, ((abs(way) / speed, math.copysign(speed, way), 0.0),))
    top = min(speed, math.sqrt(acceleration * abs(way)))
    ramp, even = top / acceleration, max(abs(way) / top - top / acceleration, 0.0)
    top, acceleration = math.copysign(top, way), math.copysign(acceleration, way)
    return Profile(
        start, position, ((ramp, 0.0, acceleration), (even, top, 0.0), (ramp, top, -acceleration))
    )
