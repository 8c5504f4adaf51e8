"""Result of one update of a live estimate."""

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
    """Estimated loads at the tip and at the `points` where the prior places loads.

    Attributes:
        arclength: Arclengths (M,) of the loads, m.
        position: Positions (M, 3) of these points in the world frame, m.
        wrench: Forces and moments at these points, in world axes.
    """

    arclength: Array
    position: Array
    wrench: WrenchEstimate

    @property
    def std_force(self) -> Array:
        """Standard deviations (M,) of the forces in their own directions, N."""
        size = np.linalg.norm(self.wrench.force, axis=-1, keepdims=True)
        direction = self.wrench.force / np.maximum(size, 1e-300)
        return np.sqrt(np.einsum("mi,mij,mj->m", direction, self.wrench.cov[:, :3, :3], direction))


@dataclass(frozen=True)
class Update:
    """Current shape with its covariance.

    Attributes:
        number: Number of earlier updates.
        time: Session time of the shape, s.
        stamp: The same instant as an OpenIGTLink stamp of the wall clock.
        arclength: Points (N,) along the robot, m.
        state: Estimate at these points.
        newest: Estimate at the robot's arclength nodes, as `FixedLagSmoother.advance` returns it.
        readings: Readings that arrived since the last update.
        smoother: The estimator, for further queries such as `smoother.dropped`.
        ready: Session time at which the estimate was complete, s.
        latency: Seconds from when the update was due, its time plus `delay`, to `ready`.
        computing: Seconds of this latency spent on the estimate.
        skipped: Updates skipped so far because the machine was too slow.
        problems: Reasons why sources or sinks are silent or their time stamps are off, if any.
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
        """Estimated loads at the newest time node; None unless the prior is a `MechanicalPrior`."""
        prior = self.smoother.prior
        if not isinstance(prior, MechanicalPrior):
            return None
        posterior = self.smoother.posterior()
        places, newest = np.union1d(prior.points, self.arclength[-1:]), posterior.grid.time[-1]
        wrench = posterior.load(places, newest, frame="world")
        return Loads(places, posterior.at(places, newest).position, wrench)

    @property
    def std_tip(self) -> float:
        """Square root of the total position variance of the last point, m."""
        return float(self.state.std_position[-1])
