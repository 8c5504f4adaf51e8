"""The belief that planning starts from: mean and covariance of an estimate's newest time node.

Of a running smoother, planning needs only the newest time node: its state, and the covariance of
the state and the sensor parameters, which are quickly sent to another process. A belief can be
propagated along a path that is already fixed, so that a plan may begin at a later time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.given import require_kind
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.priors.transitions import symmetrize
from glissando.model.robot import Robot
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.state import State
from glissando.planning.prediction import look_ahead, prior_information
from glissando.planning.sliding_sensor import SlidingSensor

ExpectedMotion = Callable[[Array], State]
"""Expected motion: maps times (K,), s, to the State (K, N) at the prior's arclength nodes."""


@dataclass(frozen=True)
class Belief:
    """Mean and covariance of the newest time node of an estimate.

    Attributes:
        prior: Prior of the estimate.
        arclength: Arclength nodes (N,), m.
        time: Time of the newest node, s.
        node_step: Time between the time nodes of the estimate, s.
        sensor_parameters: Sensor parameters of the estimate.
        shape: State (N,) of the newest node; None if only the prior is known.
        cov: Covariance (D, D) of the state and the parameters; None if `shape` is None.
        previous_time: Time of the node before the newest, s; None if there is none.
        lone: Time span that the newest node represents if no node precedes it, s.
    """

    prior: Prior
    arclength: Array
    time: float
    node_step: float
    sensor_parameters: Sequence[SensorParameter]
    shape: State | None = None
    cov: Array | None = None
    previous_time: float | None = None
    lone: float = 1.0

    def hold_shape(self, grid: Grid) -> State:
        """Expected states at all nodes of a grid if the robot holds its shape."""
        rest = self.prior.rest_state(grid)
        if self.shape is None:
            return rest
        pose = np.broadcast_to(self.shape.pose, rest.pose.shape)
        return replace(
            rest, pose=pose, strain=np.broadcast_to(self.shape.strain, rest.strain.shape)
        )

    def information(self) -> Array | None:
        """Information (D, D) of the newest node beyond its prior; None if only the prior is known.

        The prior of the node is subtracted, since a grid that continues from the node adds it.
        """
        if self.cov is None or self.shape is None:
            return None
        now = np.array([self.time])
        grid = Grid(self.arclength, now).at_times(now, self.previous_time, self.lone)
        state = State(*(field[None] for field in self.shape.fields()))
        parameters = EstimatedParameters(grid, self.sensor_parameters)
        prior = prior_information(self.prior, grid, state, parameters)
        return symmetrize(np.asarray(np.linalg.inv(self.cov))) - prior.diagonal[0]

    def propagate(
        self, time: float, sensor: SlidingSensor, path: Callable[[Array], Array],
        motion: ExpectedMotion | None = None,
    ) -> Belief:  # fmt: skip
        """Predict the belief at a later time, given the readings taken on a path until then.

        Args:
            time: Time of the predicted belief, s.
            sensor: The sliding sensor.
            path: Maps times (M,), s, to arclengths (M,) of the first coil, m.
            motion: Expected motion of the robot; by default it holds its shape.
        """
        grid = Grid(self.arclength, [self.time, time], self.previous_time)
        mean = self.hold_shape(grid) if motion is None else motion(grid.time)
        parameters = EstimatedParameters(grid, self.sensor_parameters)
        times = sensor.reading_times(self.time, time - self.time)
        with one_thread():
            ahead = look_ahead(self.prior, grid, mean, parameters, self.information())
            cov = ahead.after(sensor, path(times), times).marginals.cov[-1]
        return replace(self, time=time, shape=mean.take(-1), cov=cov, previous_time=self.time)


BeliefSource = Robot | Posterior | FixedLagSmoother | Belief


def belief_of(source: BeliefSource, start: float = 0.0) -> Belief:
    """Belief about the newest node of an estimate, or prior of a robot at time `start`, s.

    For a running smoother this takes less than a millisecond.
    """
    if isinstance(source, Belief):
        return source
    if isinstance(source, Robot):
        nodes, step = source.arclength_nodes, 1.0 / source.time_rate
        return Belief(source.prior, nodes, start, step, source.sensor_parameters)
    parameters: Sequence[SensorParameter]
    if isinstance(source, FixedLagSmoother):
        parameters = source.sensor_parameters
        shape, cov, grid = source.newest_node()  # its posterior would take ten times as long
    else:
        require_kind(source, Posterior, "belief's source", "give an estimate or a Robot")
        parameters = tuple(parameter for parameter, _ in source.sensor_parameters)
        shape, cov, grid = source.state.take(-1), source.marginals.cov[-1], source.grid
    time = float(grid.time[-1])
    previous = float(grid.time[-2]) if grid.time.size > 1 else grid.before
    step = 0.0 if previous is None else time - previous
    lone, known = float(grid.time_spans[-1]), (parameters, shape, cov, previous)
    return Belief(source.prior, grid.arclength, time, step, *known, lone)
