"""Many static shapes of one robot, estimated together: each by itself, all in the same arrays.

A shape that holds still is pose and strain along the body, half the numbers of a moment in a
recording, and its factors couple neighbours along arclength only. So shapes are chains, and a
hundred of them cost little more than one. Source: equations (2'), (20), (21).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glissando.errors import OutsideGridError, UnobservableError
from glissando.estimation.batch import SolverOptions, estimate
from glissando.estimation.posterior import StateEstimate
from glissando.estimation.static_factors import (
    STILL,
    StaticEquations,
    StaticPrior,
    chosen,
    linearize_static,
)
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import sort_points
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, State
from glissando.solver.block_tridiagonal_batch import BatchCholesky, factor_batch
from glissando.solver.measurement_factors import MeasurementFactors
from glissando.twins import estimating

_DOFS = slice(0, STILL)
_WORTHWHILE, _ROUNDING = 1e-3, 1e-11  # as for a recording
_ROUGH = 10.0  # standard deviations a number that a start may be off by
_ROUGH_ITERATIONS = 15


@dataclass(frozen=True)
class StaticPosterior:
    """Posterior of S static shapes: mean and covariance of pose and strain at any arclength.

    `state` (S, N) is the mean at the nodes of `grid`, whose times are the shapes' numbers; `cov`
    (S, N, 12, 12) of nodes and `cross` (S, N−1, 12, 12) of neighbours; `converged` (S,).
    """

    prior: StaticPrior
    grid: Grid
    state: State
    cov: Array
    cross: Array
    converged: NDArray[np.bool_]

    def at(self, arclength: ArrayLike, shape: ArrayLike) -> StateEstimate:
        """State with covariance at arclengths (m) of shapes by number, which broadcast together.

        Velocity is zero, and sure: shapes hold still. Raises OutsideGridError off the grid.
        """
        s, k = np.broadcast_arrays(
            np.asarray(arclength, dtype=float), np.asarray(shape, dtype=float)
        )
        whole, s, k = s.shape, s.ravel(), k.ravel()
        self.grid.require(s, k, "Query")
        _require_whole(k, "Query")
        pose, strain = np.empty((s.size, 4, 4)), np.empty((s.size, 6))
        cov = np.zeros((s.size, DOF, DOF))
        for points in sort_points(self.grid, s, k):
            with estimating():
                found = self.prior.interpolate(self.grid, self.state, self.state, points)
            jacobian = found.jacobian[:, :STILL, :, :STILL].reshape(len(found.nodes), STILL, -1)
            pose[points.rows], strain[points.rows] = found.state.pose, found.state.strain
            spread = jacobian @ self._joint(found.nodes) @ np.swapaxes(jacobian, -1, -2)
            spread += found.cov[:, _DOFS, _DOFS]
            cov[points.rows, _DOFS, _DOFS] = 0.5 * (spread + np.swapaxes(spread, -1, -2))
        arrays = (pose, strain, np.zeros_like(strain), cov)
        return StateEstimate(*(a.reshape(*whole, *a.shape[1:]) for a in arrays))

    def _joint(self, nodes: Index) -> Array:
        """Joint covariance (M, c·12, c·12) of a node, or of it and the next (M, c)."""
        k, n = np.divmod(nodes[:, 0], self.grid.arclength.size)
        if nodes.shape[1] == 1:
            return self.cov[k, n]
        cross = self.cross[k, n]
        return np.block([[self.cov[k, n], cross], [np.swapaxes(cross, -1, -2), self.cov[k, n + 1]]])


def estimate_static(
    prior: StaticPrior,
    arclength: ArrayLike,
    readings: Sequence[Readings],
    *,
    count: int | None = None,
    options: SolverOptions | None = None,
) -> StaticPosterior:
    """Posterior of static shapes that know nothing of each other, solved together.

    The `time` of a reading is the number of its shape, 0 to `count` − 1 (the largest there is
    unless given); `arclength` (N,) m are the nodes of all. The answer of each is that of `estimate`
    at a single moment, which also takes over shapes that this way does not lead to. Raises
    SensorError for a sensor of velocity, UnobservableError as `estimate` does; warns
    NotConvergedWarning.

    >>> from glissando import CoilReadings, load_robot
    >>> robot = load_robot("tdcr466")
    >>> tips = np.tile(np.eye(4), (2, 1, 1))
    >>> tips[:, :3, 3] = [[0.05, 0.0, 0.46], [0.0, -0.1, 0.45]]  # two shapes, a reading each
    >>> coil = CoilReadings(time=[0, 1], arclength=[0.466, 0.466], values=tips,
    ...                     cov=[1e-6, 1e-6, 1e-6, 1, 1])
    >>> shapes = estimate_static(robot.prior, robot.arclength_nodes, [coil])
    >>> np.round(shapes.at(0.233, [0, 1]).position, 3) + 0.0
    array([[ 0.012,  0.   ,  0.232],
           [ 0.   , -0.025,  0.231]])
    """
    given, options = [r for r in readings if len(r)], options or SolverOptions()
    for r in given:
        _require_whole(r.time, r.label)
    if count is None:
        count = 1 + int(max((r.time.max() for r in given), default=0.0))
    grid = Grid.apart(arclength, count)
    start = prior.rest_state(grid)
    with estimating():
        placed = MeasurementFactors(grid, given)
        soft = prior.softened()
        if soft is not prior:
            size = np.sqrt(grid.arclength.size * STILL)
            start = _settled(soft, placed, start, SolverOptions(_ROUGH_ITERATIONS, _ROUGH * size))[
                0
            ]
        state, (cov, cross), left = _settled(prior, placed, start, options)
    converged = np.ones(count, dtype=bool)
    for k in np.flatnonzero(left):
        alone = [r.select(r.time == k) for r in given]
        alone = [r.changed(time=np.zeros(len(r))) for r in alone]
        one = estimate(prior, Grid(grid.arclength, [0.0]), alone, options=options)
        converged[k] = one.solve.converged
        state.pose[k], state.strain[k] = one.state.pose[0], one.state.strain[0]
        every = np.arange(grid.arclength.size)
        whole = one.marginals.cov[0].reshape(every.size, one.state.dof, every.size, -1)
        whole = whole[:, _DOFS, :, _DOFS]
        cov[k], cross[k] = whole[every, :, every], whole[every[:-1], :, every[1:]]
    return StaticPosterior(prior, grid, state, cov, cross, converged)


def _settled(
    prior: StaticPrior, placed: MeasurementFactors, start: State, options: SolverOptions
) -> tuple[State, tuple[Array, Array], NDArray[np.bool_]]:
    """Gauss-Newton steps of all shapes, straight on or bent: states, marginals, and who is left.

    A shape that neither way brings down is left, at rest, to those who can shorten and damp steps.
    """
    grid = placed.grid
    here = linearize_static(prior, placed, start)
    going, left = np.ones((2, grid.time.size), dtype=bool)
    left[:] = False
    for _ in range(options.max_iterations):
        chains = _factored(here)
        step = np.zeros((*grid.shape, start.dof))
        step[..., _DOFS] = chains.solve(here.right) * going[:, None, None]
        promise = np.sum(step[..., _DOFS] * here.right, axis=(1, 2))
        last = going & (np.sqrt(np.maximum(promise, 0.0)) < options.tolerance)
        going &= ~last
        straight = here.state.retract(step)
        if not np.any(going):
            return straight, chains.marginals(), left
        there = linearize_static(prior, placed, straight)
        refused = going & ~_worthwhile(here, there, promise)
        if np.any(refused):
            bent = prior.bent(grid, here.state, step)
            there = linearize_static(prior, placed, chosen(refused, bent, straight))
            refused &= ~_worthwhile(here, there, promise)
        if np.any(refused):
            left, going = left | refused, going & ~refused
            state = chosen(refused, prior.rest_state(grid), there.state)
            there = linearize_static(prior, placed, state)
        here = there
    return here.state, _factored(here).marginals(), left | going


def _worthwhile(here: StaticEquations, there: StaticEquations, promise: Array) -> NDArray[np.bool_]:
    """Which costs fell by a fair share of half the `promise` (S,), if that is worth anything."""
    cost = here.costs(here)
    gain = cost - here.costs(there)
    nothing = 0.5 * promise < _ROUNDING * (1.0 + cost)
    return nothing | (gain > _WORTHWHILE * 0.5 * promise)


def _factored(here: StaticEquations) -> BatchCholesky:
    try:
        return factor_batch(here.diagonal, here.lower)
    except np.linalg.LinAlgError:
        raise UnobservableError(
            "Prior and readings leave a direction of a shape undetermined. Give the robot a "
            "[base], or every shape a pose, or coils or positions at several places."
        ) from None


def _require_whole(number: Array, what: str) -> None:
    """Raise OutsideGridError unless all numbers of shapes are whole, from 0 up."""
    wrong = np.flatnonzero((number != np.round(number)) | (number < 0.0))
    if wrong.size:
        raise OutsideGridError(
            f"{what}: row {wrong[0]} is of shape {number[wrong[0]]:g}; shapes are numbered 0, 1, "
            f"2, … in place of times."
        )
