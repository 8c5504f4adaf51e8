"""The belief that planning starts from: the newest node of an estimate, small enough to send.

Of a running smoother, planning needs only the newest node: its shape, and the covariance of the
shape and the sensor parameters. A belief can be propagated along a path that is already settled, so
that a plan may begin when planning is done.
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
"""The motion that is expected: a State (K, N) at times (K,) and the prior's arclength nodes."""


@dataclass(frozen=True)
class Belief:
    """The belief about the newest node of an estimate.

    Attributes:
        prior: Prior of the estimate.
        arclength: Arclength nodes (N,), m.
        time: Time of the newest node, s.
        node_step: Time between the nodes of the estimate, s.
        sensor_parameters: Parameters of the sensors that are estimated.
        shape: State (N,) of the node; None where only the prior is known.
        cov: Covariance (D, D) of the state and the parameters; None as `shape` is.
        previous_time: Time of the node before the newest, s, if there is one.
        lone: What the newest node stands for where there is none before, s.
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
        """The expected state at all nodes of a grid if the robot holds its shape."""
        rest = self.prior.rest_state(grid)
        if self.shape is None:
            return rest
        pose = np.broadcast_to(self.shape.pose, rest.pose.shape)
        return replace(
            rest, pose=pose, strain=np.broadcast_to(self.shape.strain, rest.strain.shape)
        )

    def information(self) -> Array | None:
        """Information (D, D) that the estimate adds to the newest node's prior, if any.

        The prior of the node by itself is left out, as it depends on the nodes before and after.
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
        """Predict the belief at a later time, after the readings on a path until then.

        Args:
            time: The later time, s.
            sensor: The sliding sensor.
            path: Arclengths (M,) of the first coil at times (M,), m.
            motion: How the robot moves; by default it holds its shape.
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
    """The newest belief of an estimate, or the prior of a robot at time `start`, s.

    Of a running smoother it is taken in less than a millisecond.
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
