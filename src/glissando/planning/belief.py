"""What is known as the time ahead begins: the newest state, small enough to hand over.

All that planning needs of a running smoother is the newest node: its shape, its covariance and the
unknowns' part in it. It can be carried on to a later time along a path that is already settled, so
that what is planned may begin when planning is done.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.priors.transitions import symmetrize
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import EstimatedParameters, SensorParameter
from glissando.model.state import State
from glissando.planning.prediction import look_ahead, prior_information
from glissando.planning.sliding_sensor import SlidingSensor
from glissando.twins import estimating

ExpectedMotion = Callable[[Array], State]
"""The motion that is expected: a State (K, N) at times (K,) and the prior's arclength nodes."""


@dataclass(frozen=True)
class Belief:
    """The newest node of an estimate at `time`: its `shape` (N,) and covariance `cov` (D, D).

    Both are None where only the `prior` is known. `node_step` is that of the estimate, `before` the
    time of the node that precedes the newest.
    """

    prior: Prior
    arclength: Array
    time: float
    node_step: float
    sensor_parameters: Sequence[SensorParameter]
    shape: State | None = None
    cov: Array | None = None
    before: float | None = None

    def held(self, grid: Grid) -> State:
        """The shape at all times of a grid, at rest."""
        rest = self.prior.rest_state(grid)
        if self.shape is None:
            return rest
        pose, strain = self.shape.pose, self.shape.strain
        return replace(
            rest,
            pose=np.broadcast_to(pose, rest.pose.shape),
            strain=np.broadcast_to(strain, rest.strain.shape),
        )

    def belief(self) -> Array | None:
        """Information (D, D) that the newest node adds to the prior, if any.

        It is without what the prior says of that node by itself, which depends on the time it
        stands for: from the node `before` it to the one that follows.
        """
        if self.cov is None or self.shape is None:
            return None
        grid = Grid(self.arclength, [self.time], self.before)
        state = State(*(field[None] for field in self.shape.fields()))
        own = prior_information(
            self.prior, grid, state, EstimatedParameters(grid, self.sensor_parameters)
        )
        return symmetrize(np.asarray(np.linalg.inv(self.cov))) - own.diagonal[0]

    def later(
        self, time: float, sensor: SlidingSensor, path: Callable[[Array], Array],
        course: ExpectedMotion | None = None,
    ) -> Belief:  # fmt: skip
        """What will be known at a later time, the sensor on a path of arclengths till then.

        The robot holds its shape unless `course` says how it moves.
        """
        lasts = time - self.time
        grid = Grid(self.arclength, [self.time, time], self.before)
        mean = self.held(grid) if course is None else course(grid.time)
        count = max(1, round(lasts * sensor.rate))
        taken = np.asarray(self.time + (np.arange(count) + 0.5) * (lasts / count))
        with estimating():
            ahead = look_ahead(
                self.prior,
                grid,
                mean,
                EstimatedParameters(grid, self.sensor_parameters),
                self.belief(),
            )
            cov = ahead.after(sensor, path(taken), taken).marginals.cov[-1]
        return replace(self, time=time, shape=mean.take(-1), cov=cov, before=self.time)


def belief_of(known: Robot | Posterior | FixedLagSmoother | Belief, start: float = 0.0) -> Belief:
    """The newest of what is known: of a robot its prior alone, at time `start`.

    Of a running smoother it is taken in less than a millisecond.
    """
    if isinstance(known, Belief):
        return known
    if isinstance(known, Robot):
        nodes, step = known.arclength_nodes, 1.0 / known.time_rate
        return Belief(known.prior, nodes, start, step, known.sensor_parameters)
    if isinstance(known, FixedLagSmoother):
        prior, sensor_parameters = known.prior, known.sensor_parameters
        shape, cov, grid = known.newest_node()  # a posterior of it would take ten times as long
    else:
        prior, grid, cov = known.prior, known.grid, known.marginals.cov[-1]
        shape, sensor_parameters = (
            known.state.take(-1),
            tuple(u for u, _ in known.sensor_parameters),
        )
    time = float(grid.time[-1])
    before = float(grid.time[-2]) if grid.time.size > 1 else grid.before
    step = 0.0 if before is None else time - before
    return Belief(prior, grid.arclength, time, step, sensor_parameters, shape, cov, before)
