"""What an update of a live estimate says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.loads import WrenchEstimate
from glissando.estimation.state_estimate import StateEstimate
from glissando.geometry.se3 import Array
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.sensors.readings import Readings


@dataclass(frozen=True)
class Loads:
    """What acts on the robot where its prior expects loads: at the tip, and at its `points`.

    Attributes:
        arclength: The places (M,), m.
        position: Where they are (M, 3), m, world frame.
        wrench: What acts there, along the axes of the world.
    """

    arclength: Array
    position: Array
    wrench: WrenchEstimate

    @property
    def std_force(self) -> Array:
        """Standard deviations (M,) of the forces along themselves, N."""
        size = np.linalg.norm(self.wrench.force, axis=-1, keepdims=True)
        along = self.wrench.force / np.maximum(size, 1e-300)
        return np.sqrt(np.einsum("mi,mij,mj->m", along, self.wrench.cov[:, :3, :3], along))


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
        ready: Session time at which the shape was there, s.
        latency: Seconds from when the update was due to when the shape was there.
        computing: Seconds of these that the estimate took.
        skipped: Updates so far that were left out because the machine was too slow.
        problems: Why sources or sinks are silent, or stamps of another moment, if they are.
    """

    number: int
    time: float
    stamp: int
    arclength: Array
    state: StateEstimate
    newest: StateEstimate
    readings: Sequence[Readings]
    smoother: FixedLagSmoother
    ready: float
    latency: float
    computing: float
    skipped: int
    problems: tuple[str, ...]

    @property
    def tip(self) -> Array:
        """Position (3,) of the last point, m."""
        return self.state.position[-1]

    def loads(self) -> Loads | None:
        """What acts on the robot by now; None unless its prior knows its mechanics."""
        prior = self.smoother.prior
        if not isinstance(prior, MechanicalPrior):
            return None
        posterior = self.smoother.posterior()
        places, newest = np.union1d(prior.points, self.arclength[-1:]), posterior.grid.time[-1]
        wrench = posterior.load(places, newest, frame="world")
        return Loads(places, posterior.at(places, newest).position, wrench)

    @property
    def std_tip(self) -> float:
        """Root of the total position variance of the last point, m."""
        return float(self.state.std_position[-1])
