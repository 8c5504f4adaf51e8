"""A carriage on a lead screw, with play in its nut and hard stops at both ends of the stage."""

from __future__ import annotations

from dataclasses import dataclass, field

TICKS = 4096.0  # a revolution


@dataclass
class Screw:
    """Travel of a carriage in metres from the screw's angle in ticks.

    `lead` m a revolution, `direction` ±1, `play` m between nut and screw, hard `ends` m, and the
    carriage's travel where it starts, with the screw at `angle` ticks in the middle of its play.
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
        """Least and largest angle, in ticks, that the hard ends allow."""
        low, high = (
            self.angle + self.direction * TICKS * (end - self.start) / self.lead
            for end in (self.ends[0] - 0.5 * self.play, self.ends[1] + 0.5 * self.play)
        )
        return min(low, high), max(low, high)

    def turn(self, angle: float) -> float:
        """Turn the screw to an angle in ticks; the carriage's travel, dragged by its nut."""
        nut = self.start + self.direction * self.lead * (angle - self.angle) / TICKS
        self.travel = min(max(self.travel, nut - 0.5 * self.play), nut + 0.5 * self.play)
        return self.travel
