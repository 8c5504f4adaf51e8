"""What is known after an estimate: mean and covariance at any arclength and time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError
from glissando.estimation.carried import carried
from glissando.estimation.loads import (
    WrenchEstimate,
    internal_wrench,
    point_loads,
    require_mechanics,
)
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.brief import Brief
from glissando.model.grid import Grid, Index, points_of
from glissando.model.interpolation import sort_points
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameter_process import HELD, EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.state import DOF, POSE, State
from glissando.solver.block_tridiagonal import BlockTridiagonal, Marginals, factor
from glissando.solver.outcome import Outcome

_CHUNK = 500  # queries at a time: more ask for new memory faster than it is given


@dataclass(frozen=True)
class SolveReport:
    """How an estimate was reached.

    Attributes:
        outcome: How the solver ended.
        iterations: How many linearisations it took.
        last_step: Length of the last step, posterior standard deviations.
        unknowns: How many numbers were estimated.
        cost: Half the sum of squared whitened residuals, or of their losses.
        log_evidence: Laplace log marginal likelihood up to a constant (equation 22).
        suspects: How many readings a robust loss gave less than half their weight.
        seconds: Processor time by phase; empty of a posterior that was loaded.
        refused: Rows of each stream that were not used, as all other readings refute them.
        worst: Of an estimate that did not converge, the readings that fit least where it ended.
        doubt: Why confidence is too small, if many readings contradict the estimate.
    """

    outcome: Outcome
    iterations: int
    last_step: float
    unknowns: int
    cost: float
    log_evidence: float
    suspects: int
    seconds: dict[str, float] = field(compare=False)
    refused: dict[str, list[int]] = field(default_factory=dict)
    worst: str = ""
    doubt: str = ""

    @property
    def converged(self) -> bool:
        """Whether the result can be trusted: the solver reached what it was to reach."""
        return self.outcome.sound

    @property
    def status(self) -> str:
        """The outcome as a sentence."""
        if self.converged:
            return self.outcome.sentence
        if self.outcome is Outcome.NO_DESCENT:  # the last step was damped to nothing
            return f"{self.outcome.sentence} after {self.iterations} iterations"
        return (
            f"{self.outcome.sentence}: {self.iterations} iterations, the last step still "
            f"{self.last_step:.2g} standard deviations long"
        )

    def to_table(self) -> dict[str, Any]:
        """The report as JSON holds it, without the times, which differ from run to run."""
        table = {**vars(self), "outcome": self.outcome.name}
        del table["seconds"]
        return table

    @staticmethod
    def from_table(table: dict[str, Any]) -> SolveReport:
        """The report that `to_table` wrote, or one of an earlier version, which had a status."""
        if "status" in table:
            status = table.pop("status")
            named = {"converged": "CONVERGED", "online": "UPDATED"}
            table |= {"outcome": named.get(status, "ITERATION_LIMIT"), "last_step": np.nan}
        return SolveReport(**{"seconds": {}, **table, "outcome": Outcome[table["outcome"]]})


_UNMOVED = np.eye(4)


@dataclass(frozen=True)
class StateEstimate(Brief):
    """State and covariance at queried points, with the leading shape of the query.

    `pose` (…, 4, 4), `strain` (…, 6), `velocity` (…, 6) and `cov` (…, 18, 18) of
    [pose, strain, velocity], each [linear, angular], in the body frame (pose on the right).
    """

    pose: Array
    strain: Array
    velocity: Array
    cov: Array

    def take(self, index: Any) -> StateEstimate:
        """The estimate at leading indices, as numpy would index an array of points."""
        return type(self)(*(field[index] for field in vars(self).values()))

    @property
    def position(self) -> Array:
        """Position (…, 3) in the world, metres."""
        return self.pose[..., :3, 3]

    @property
    def quaternion(self) -> Array:
        """Orientation (…, 4) as [w, x, y, z], body to world."""
        return se3.quaternion(self.pose[..., :3, :3])

    @property
    def cov_position_world(self) -> Array:
        """Covariance (…, 3, 3) of the position in the world frame."""
        rotation = self.pose[..., :3, :3]
        return rotation @ self.position_covariance() @ np.swapaxes(rotation, -1, -2)

    def position_covariance(self, mount: Array = _UNMOVED) -> Array:
        """Covariance (…, 3, 3) of a mounted frame's position, in its axes. Source: (34).

        Args:
            mount: Pose (4, 4) of the frame on the body, or one each (…, 4, 4).
        """
        lever = se3.adjoint(se3.inverse(mount))
        return se3.position_covariance(lever @ self.cov[..., :6, :6] @ np.swapaxes(lever, -1, -2))

    @property
    def std_position(self) -> Array:
        """Root of the total position variance (…), metres."""
        return np.sqrt(np.einsum("...ii->...", self.position_covariance()))


@dataclass(frozen=True)
class Posterior(Brief):
    """Gaussian posterior over the whole motion, continuous in arclength and time.

    `state` is the mean at the nodes, `system` the information matrix of the nodes in time order,
    `marginals` the blocks of its inverse that any query needs, in the axes of `state`, `solve` how
    it was reached, `sensor_parameters` of the sensors with their estimated values (K, size) at the
    time nodes, `linearized` the states at which `system` was linearised and weighted, which a file
    has for a mechanical prior, and where the last step rolled the body.
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
        """The marginals as if delays were known, which an estimate spreads motions by.

        Readings say nothing of a delay that motion dates, so what they explain is without it.
        """
        process = EstimatedParameters(
            self.grid, [parameter for parameter, _ in self.sensor_parameters]
        )
        columns = [self.state.numbers + column for column in process.delay_columns]
        if not columns:
            return self.marginals
        held = np.zeros(self.system.diagonal.shape[:2])
        held[:, columns] = HELD
        with one_thread():
            marginals = factor(self.system.add_to_diagonal(held)).marginals(consume=True)
            return carried(self.linearization_point, self.state, marginals)

    @property
    def linearization_point(self) -> State:
        """The nodes (K, N) from which `system` knows steps; the mean where that is not known."""
        return self.state if self.linearized is None else self.linearized[0]

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """State with its 18×18 covariance at points; arclength and time broadcast together.

        Raises OutsideGridError for a point off the grid. Source: equations (10) to (12).
        """
        return state_at(self.prior, self.grid, self.state, self.marginals, arclength, time)

    def wrench(
        self, arclength: ArrayLike, time: ArrayLike, *, frame: str = "body"
    ) -> WrenchEstimate:
        """Internal wrench at points: what the part beyond exerts on the part before it.

        Args:
            arclength: Metres; broadcast with `time`.
            time: Seconds.
            frame: Axes of the cross-section, "body", or of the "world".

        Raises:
            GlissandoError: The robot's prior knows no loads.
            OutsideGridError: A point is off the grid.
        """
        require_mechanics(self.prior, frame)
        at = self.at(arclength, time)
        s = np.broadcast_arrays(np.asarray(arclength, dtype=float), time)[0]
        return internal_wrench(self.prior, s, at.pose, at.strain, at.cov, frame)

    def load(self, arclength: ArrayLike, time: ArrayLike, *, frame: str = "body") -> WrenchEstimate:
        """The unknown wrench that acts at the tip or at one of the prior's `points`.

        Args:
            arclength: The places, metres; broadcast with `time`.
            time: Seconds; the answer is that of the nearest time node.
            frame: Axes of the cross-section, "body", or of the "world".

        Raises:
            GlissandoError: The robot's prior knows no loads.
            OutsideGridError: A point is off the grid, or no load is expected there.
        """
        s, t = np.broadcast_arrays(
            np.asarray(arclength, dtype=float), np.asarray(time, dtype=float)
        )
        self.grid.require(s.ravel(), t.ravel(), "Query")
        k = np.abs(t.ravel()[:, None] - self.grid.time).argmin(axis=1)
        prior, grid, state = self.prior, self.grid, self.state
        spread = partial(_spread, grid, self.marginals)
        load = point_loads(prior, grid, state, spread, s.ravel(), k, frame)
        wrench, cov = load.wrench.reshape(*s.shape, 6), load.cov.reshape(*s.shape, 6, 6)
        return WrenchEstimate(wrench, cov, frame)

    def states_on(self, grid: Grid) -> State:
        """Its mean at the nodes (K, N) of another grid, a start for another estimate.

        Beyond its ends the nearest time stands. A strain rate counts as zero between its nodes.

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

        Args:
            rng: A generator, such as `numpy.random.default_rng(0)`.
            size: How many.
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
        """An estimated sensor parameter.

        Args:
            name: Its name.

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


def state_at(
    prior: Prior,
    grid: Grid,
    state: State,
    marginals: Marginals,
    arclength: ArrayLike,
    time: ArrayLike,
) -> StateEstimate:
    """State with its 18×18 covariance at points of a grid, given its nodes.

    Args:
        prior: The prior of the motion.
        grid: The grid.
        state: Mean (K, N) at the nodes.
        marginals: Covariance of the nodes' numbers, a slab for each time.
        arclength: Metres; broadcast with `time`.
        time: Seconds.

    Raises:
        OutsideGridError: A point is off the grid.

    Source: equations (10) to (12).
    """
    s, t = points_of(arclength, time)
    shape, s, t = s.shape, s.ravel(), t.ravel()
    grid.require(s, t, "Query")
    out = StateEstimate(
        np.empty((s.size, 4, 4)),
        np.empty((s.size, 6)),
        np.empty((s.size, 6)),
        np.empty((s.size, DOF, DOF)),
    )
    for first in range(0, s.size, _CHUNK):
        here = slice(first, first + _CHUNK)
        for points in sort_points(grid, s[here], t[here]):
            interpolation = prior.interpolate(grid, state, state, points)
            rows = first + points.rows
            out.pose[rows] = interpolation.state.pose
            out.strain[rows] = interpolation.state.strain
            out.velocity[rows] = interpolation.state.velocity
            out.cov[rows] = _spread(
                grid, marginals, interpolation.nodes, interpolation.jacobian, interpolation.cov
            )
    return StateEstimate(*(a.reshape(*shape, *a.shape[1:]) for a in vars(out).values()))


def _spread(grid: Grid, marginals: Marginals, nodes: Index, slopes: Array, left: Array) -> Array:
    """Covariance (M, r, r) by slopes (M, r, c, dof) of nodes (M, c), and what they leave open."""
    slab, inner = np.divmod(nodes, grid.arclength.size)
    return marginals.spread(slab, inner * slopes.shape[-1], slopes, left)
