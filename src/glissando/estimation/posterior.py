"""Posterior of an estimate: mean and covariance at any arclength and time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError, OutsideGridError
from glissando.estimation.evidence import log_normalizer
from glissando.estimation.joint_estimate import JointEstimate, joint_estimate
from glissando.estimation.loads import (
    WrenchEstimate,
    internal_wrench,
    point_loads,
    require_mechanics,
)
from glissando.estimation.solve_report import SolveReport
from glissando.estimation.state_estimate import Spread, StateEstimate, spread, state_at
from glissando.estimation.transported import transported
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, points_of
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameter_process import HELD, EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.short_repr import ShortRepr
from glissando.model.state import POSE, State
from glissando.solver.block_tridiagonal import BlockTridiagonal, Marginals, factor
from glissando.solver.outcome import Outcome


@dataclass(frozen=True)
class Posterior(ShortRepr):
    """Gaussian posterior over the whole motion, continuous in arclength and time.

    `state` is the mean at the nodes; `system` the information matrix of the nodes in time order;
    `marginals` the blocks of its inverse that queries need, in the axes of `state`; `solve` the
    solver's report; `sensor_parameters` those estimated, with values (K, size) at the time nodes;
    `linearized` the states at which `system` was linearised and weighted, which a file has for a
    mechanical prior and where the last step rolled the body.
    """

    prior: Prior
    grid: Grid
    state: State
    system: BlockTridiagonal
    marginals: Marginals
    solve: SolveReport
    sensor_parameters: Sequence[tuple[SensorParameter, Array]] = ()
    linearized: tuple[State, State] | None = field(default=None, compare=False)

    @cached_property
    def marginals_of_known_delays(self) -> Marginals:
        """The marginals as if delays were known, by which readings that were used are judged.

        Delays follow from the motion of other streams (see `delays`), not from the least residuals.
        """
        process = EstimatedParameters(
            self.grid, [parameter for parameter, _ in self.sensor_parameters]
        )
        columns = [self.state.numbers + column for column in process.delay_columns]
        if not columns:
            return self.marginals
        fixing_info = np.zeros(self.system.diagonal.shape[:2])
        fixing_info[:, columns] = HELD
        with one_thread():
            marginals = factor(self.system.add_to_diagonal(fixing_info)).marginals(consume=True)
            return transported(self.linearization_point, self.state, marginals)

    @cached_property
    def log_evidence(self) -> float:
        """Laplace's log marginal likelihood of the readings, up to a constant of these readings.

        It compares robot files on the same readings and nodes. It is NaN for a window, whose older
        readings are marginalised. Source: equation (22).

        Raises:
            UnobservableError: The prior alone leaves states undetermined.
        """
        if self.solve.outcome is Outcome.UPDATED:
            return float("nan")
        states = self.linearized or (self.state, self.state)
        return self.solve.log_fit + log_normalizer(self.prior, self.grid, *states)

    @property
    def linearization_point(self) -> State:
        """Nodes (K, N) at which `system` was linearised; the mean if they are not stored."""
        return self.state if self.linearized is None else self.linearized[0]

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """State with its 18×18 covariance at points; arclength and time broadcast together.

        Raises OutsideGridError for a point off the grid. Source: equations (10) to (12).
        """
        return state_at(self.prior, self.grid, self.state, self._spread, arclength, time)

    @property
    def _spread(self) -> Spread:
        return partial(spread, self.grid, self.marginals)

    def joint(self, arclength: ArrayLike, time: float) -> JointEstimate:
        """States at several places at one time with joint covariance, as of the tip and the middle.

        Args:
            arclength: Places (M,), m, at most one between any two arclength nodes.
            time: A time node, s.

        Raises:
            OutsideGridError: The time is not a node, two places lie inside one interval, or one
                lies off the grid.
        """
        places, times = points_of(arclength, time)
        if places.ndim != 1 or not places.size or np.size(time) != 1:
            raise OutsideGridError("joint takes a list of places (M,) and one time.")
        return joint_estimate(
            self.prior, self.grid, self.state, self.marginals, places, float(times.flat[0])
        )

    def wrench(
        self, arclength: ArrayLike, time: ArrayLike, *, frame: str = "body"
    ) -> WrenchEstimate:
        """Internal wrench at points, exerted by the part beyond on the part before it.

        Args:
            arclength: Metres; broadcast with `time`.
            time: Seconds.
            frame: Axes of the wrench: "body", those of the cross-section, or "world".

        Raises:
            GlissandoError: The robot's prior has no mechanics.
            OutsideGridError: A point is off the grid.
        """
        prior = require_mechanics(self.prior, frame)
        return internal_wrench(prior, arclength, self.at(arclength, time), frame)

    def load(self, arclength: ArrayLike, time: ArrayLike, *, frame: str = "body") -> WrenchEstimate:
        """External wrench on the robot at the tip or at one of the prior's `points`.

        Args:
            arclength: The places, metres; broadcast with `time`.
            time: Seconds; the nearest time node is used.
            frame: Axes of the wrench: "body", those of the cross-section, or "world".

        Raises:
            GlissandoError: The robot's prior has no mechanics.
            OutsideGridError: A point is off the grid, or no load is expected there.
        """
        s, t = points_of(arclength, time)
        self.grid.require(s.ravel(), t.ravel(), "Query")
        k = np.abs(t[..., None] - self.grid.time).argmin(axis=-1)
        return point_loads(self.prior, self.grid, self.state, self._spread, s, k, frame)

    def states_on(self, grid: Grid) -> State:
        """Mean at the nodes (K, N) of another grid, as a start for another estimate.

        Times beyond the ends take the state at the nearer end. Strain rates are zero unless the
        grids have the same nodes.

        Raises:
            OutsideGridError: The other grid is of a longer robot.
        """
        own = self.grid
        if np.array_equal(grid.time, own.time) and np.array_equal(grid.arclength, own.arclength):
            return self.state
        time = np.clip(grid.time, self.grid.time[0], self.grid.time[-1])
        estimate = self.at(grid.arclength, time[:, None])
        rates = [np.zeros_like(estimate.strain)] * (len(self.state.fields()) - 3)
        return State(estimate.pose, estimate.strain, estimate.velocity, *rates)

    def sample(self, rng: np.random.Generator, size: int = 1) -> State:
        """Joint draws of the whole motion at the nodes, leading shape (size, K, N).

        Draws are Gaussian in the tangent space of each pose. Where rotations are uncertain by some
        tenths of a radian, nodes of a draw may lie farther apart than the body's length allows.

        Args:
            rng: A generator, such as `numpy.random.default_rng(0)`.
            size: Number of draws.
        """
        if not isinstance(rng, np.random.Generator):
            raise GlissandoError(f"sample: rng is {rng!r}; give numpy.random.default_rng(0).")
        chol = factor(self.system)
        of_nodes = self.grid.arclength.size * self.state.dof
        steps = np.array([chol.sample(rng)[:, :of_nodes] for _ in range(size)])
        steps = steps.reshape(size, *self.grid.shape, self.state.dof)
        start = self.linearization_point
        return start.retract(self.state.difference(start) + steps)

    def std_pose(self) -> Array:
        """Standard deviations (K, N, 6) of the pose at the nodes, body frame."""
        k, n = self.grid.shape
        of_nodes = np.einsum("kii->ki", self.marginals.cov)[:, : n * self.state.dof]
        variance = of_nodes.reshape(k, n, -1)
        return np.sqrt(variance[..., POSE])

    def parameter(self, name: str) -> tuple[Array, Array]:
        """Values and covariances of an estimated sensor parameter.

        Args:
            name: Name of the parameter.

        Returns:
            Values (K, size) at the time nodes, and their covariances (K, size, size).

        Raises:
            GlissandoError: No sensor parameter of that name was estimated.
        """
        first = self.grid.arclength.size * self.state.dof
        for parameter, values in self.sensor_parameters:
            at = slice(first, first + parameter.size)
            if parameter.name == name:
                return values, self.marginals.cov[:, at, at]
            first += parameter.size
        known = ", ".join(u.name for u, _ in self.sensor_parameters) or "none"
        raise GlissandoError(
            f"No sensor parameter {name!r} was estimated; those that were: {known}."
        )
