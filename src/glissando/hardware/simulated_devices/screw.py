"""A carriage on a lead screw, with backlash in its nut and hard stops at both ends."""

from __future__ import annotations

from dataclasses import dataclass, field

TICKS = 4096.0  # per revolution


@dataclass
class Screw:
    """Travel of a carriage in metres from the screw's angle in ticks.

    `lead` is in m per revolution, `direction` ±1, `play` the backlash in m, `ends` the hard stops
    in m, and `start` the initial travel, with the screw at `angle` ticks in the middle of its play.
    """

    lead: float = 0.0254
    direction: float = 1.0
    play: float = 0.0
    ends: tuple[float, float] = (-0.002, 0.062)
    start: float = 0.0
    angle: float = 0.0
    travel: float = field(init=False)

    def __post_init__(self) -> None:
        self.travel = self.start

    @property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest angle, in ticks, that the hard stops allow."""
        low, high = (
            self.angle + self.direction * TICKS * (end - self.start) / self.lead
            for end in (self.ends[0] - 0.5 * self.play, self.ends[1] + 0.5 * self.play)
        )
        return min(low, high), max(low, high)

    def turn(self, angle: float) -> float:
        """Turn the screw to an angle in ticks; returns the carriage's travel, with backlash, m."""
        nut = self.start + self.direction * self.lead * (angle - self.angle) / TICKS
        self.travel = min(max(self.travel, nut - 0.5 * self.play), nut + 0.5 * self.play)
        return self.travel
