"""Set point of a servo over time: trapezoidal, triangular or rectangular speed profiles."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Profile:
    """A motion of piecewise constant acceleration, followed by rest.

    Attributes:
        start: Start time, s.
        position: Position at the start time, in any unit of length.
        pieces: Duration, initial speed and acceleration of each piece.
    """

    start: float
    position: float
    pieces: tuple[tuple[float, float, float], ...] = ()

    @property
    def duration(self) -> float:
        """Seconds from the start until rest."""
        return sum(piece[0] for piece in self.pieces)

    def at(self, time: float) -> tuple[float, float]:
        """Position and speed at a time.

        >>> to(0.0, 0.0, 60.0, speed=24.0, acceleration=100.0).at(1.0)
        (21.12, 24.0)
        """
        position, remaining = self.position, max(time - self.start, 0.0)
        for duration, speed, acceleration in self.pieces:
            into = min(remaining, duration)
            position += into * (speed + 0.5 * acceleration * into)
            if remaining < duration:
                return position, speed + acceleration * into
            remaining -= duration
        return position, 0.0


def to(start: float, position: float, goal: float, *, speed: float, acceleration: float) -> Profile:
    """Profile from rest to rest at a goal.

    Args:
        start: Start time, s.
        position: Initial position.
        goal: Final position.
        speed: Largest speed.
        acceleration: Magnitude of the acceleration; 0 for steps in speed.
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
