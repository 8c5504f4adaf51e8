"""What an update of a live estimate says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.posterior import StateEstimate
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings


@dataclass(frozen=True)
class Update:
    """The newest shape with its confidence.

    Attributes:
        number: How many updates came before.
        time: Session time of the shape, s.
        stamp: The same as an OpenIGTLink stamp of the wall clock.
        arclength: Points (N,) along the robot, m.
        state: Estimate at these points.
        newest: Estimate at the robot's own nodes, as `FixedLagSmoother.advance` returns it.
        readings: Readings that came since the last update.
        smoother: The estimator, to ask for more, such as `smoother.dropped`.
        latency: Seconds from when the update was due to when the shape was there.
        computing: Seconds of these that the estimate took.
        skipped: Updates so far that were left out because the machine was too slow.
        problems: Why sources or sinks are silent, if they are.
    """

    number: int
    time: float
    stamp: int
    arclength: Array
    state: StateEstimate
    newest: StateEstimate
    readings: Sequence[Readings]
    smoother: FixedLagSmoother
    latency: float
    computing: float
    skipped: int
    problems: tuple[str, ...]

    @property
    def tip(self) -> Array:
        """Position (3,) of the last point, m."""
        return self.state.position[-1]

    @property
    def std_tip(self) -> float:
        """Root of the total position variance of the last point, m."""
        return float(self.state.std_position[-1])
