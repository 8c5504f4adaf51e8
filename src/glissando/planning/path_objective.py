"""Value and gradient of a path: one factorisation, one forward and one backward pass.

With P the covariance after a path and M the gradient of the objective, dJ = tr(M dP) = −tr(X dΛ)
for X = P M P, of which a reading needs only the block of its own time cell. P is the inverse of a
block-tridiagonal matrix, so the contributions of distant cells are passed on by the gains between
neighbouring times. Source: equations (21), (23), (24).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from glissando.estimation.given import require_kind
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.priors.transitions import symmetrize
from glissando.planning.objectives import Objective, require_objective
from glissando.planning.planning_problem import PlanningProblem
from glissando.planning.zones import Zone, zone_points
from glissando.solver.block_tridiagonal import BlockTridiagonal, Cholesky, Marginals, factor


@dataclass(frozen=True)
class PathObjective:
    """Objective as a function of a path; a call returns value and gradient.

    Attributes:
        problem: The planning problem.
        objective: Objective over the points of the zones.
        cell: Indices (Z,) of the points' time cells, in increasing order.
        rows: Jacobians (Z, p, 2 d) of the points' poses by the modes of their cell.
        prior_cov: Covariances (Z, p, p) of the points before any reading.
        weight: Weights (Z,) of the points.
    """

    problem: PlanningProblem
    objective: Objective
    cell: Index
    rows: Array
    prior_cov: Array
    weight: Array

    def __call__(self, arclength: Array) -> tuple[float, Array]:
        """Value of a path (T,), and its gradient (T,) with respect to the arclengths."""
        rows, slopes = self.readings(arclength)
        chol, marginals = self._posterior(rows)
        cross, cov = self._point_cov(marginals)
        value, gradient = self.objective(cov, self.weight)
        cells, slope_cells = (by_cell(part, self.problem.steps_per_cell) for part in (rows, slopes))
        by_row = self._gradient(chol, marginals, cross, gradient, cells, slope_cells).ravel()
        by_step = by_row[: rows[..., 0].size].reshape(len(rows), -1)
        return value, -2.0 * by_step.sum(axis=1)

    def value(self, arclength: Array) -> float:
        """Value of a path (T,)."""
        return self.objective(self.cov(arclength), self.weight)[0]

    def cov(self, arclength: Array) -> Array:
        """Covariances (Z, p, p) of the zones' points after a path (T,)."""
        return self._point_cov(self._posterior(self.readings(arclength)[0])[1])[1]

    def readings(self, arclength: Array) -> tuple[Array, Array]:
        """Whitened rows (T, C r, 2 d) of all readings on a path (T,), and their slopes by place.

        Rows are interpolated by a cubic through four places of the lattice, with a continuous slope
        (Catmull and Rom).

        Raises:
            GlissandoError: The path has another number of steps, or leaves the reach.
        """
        arclength = self.problem.require_path(arclength)
        lattice, table = self.problem.lattice, self._table
        step = lattice[1] - lattice[0]
        place = (arclength[:, None] - self.problem.sensor.behind - lattice[0]) / step
        lower = np.clip(np.floor(place).astype(np.intp), 0, lattice.size - 2)
        weights = cubic_weights(place - lower)
        weights[..., 1, :] /= step
        at = np.arange(arclength.size)[:, None, None], lower[..., None] + np.arange(4)
        rows = weights @ table[at].reshape(*lower.shape, 4, -1)
        shape = arclength.size, -1, table.shape[-1]
        return rows[..., 0, :].reshape(shape), rows[..., 1, :].reshape(shape)

    @cached_property
    def _table(self) -> Array:
        """Rows (T, L + 2, r, 2 d) on the lattice, with one extrapolated place beyond each end."""
        rows = self.problem.rows
        low, high = rows[:, :3], rows[:, :-4:-1]
        beyond = [3.0 * end[:, :1] - 3.0 * end[:, 1:2] + end[:, 2:] for end in (low, high)]
        return np.concatenate([beyond[0], rows, beyond[1]], axis=1)

    def _posterior(self, rows: Array) -> tuple[Cholesky, Marginals]:
        """Cholesky factor and marginals of the modes after readings with rows (T, q, 2 d)."""
        prior = self.problem.modes.system
        size = prior.diagonal.shape[1]
        cells = by_cell(rows, self.problem.steps_per_cell)
        added = cells.mT @ cells
        diagonal, lower = prior.diagonal.copy(), prior.lower + added[:, size:, :size]
        diagonal[:-1] += added[:, :size, :size]
        diagonal[1:] += added[:, size:, size:]
        chol = factor(BlockTridiagonal(diagonal, lower))
        return chol, chol.marginals()

    @cached_property
    def _index_in_cell(self) -> Index:
        """Index (Z,) of each point among the points of its time cell."""
        return np.arange(self.cell.size) - np.searchsorted(self.cell, self.cell)

    @cached_property
    def _points(self) -> Array:
        """Jacobians (K−1, m, p, 2 d) of each time cell's points, padded with zeros."""
        most = int(self._index_in_cell.max()) + 1
        out = np.zeros((len(self.problem.modes.pair), most, *self.rows.shape[1:]))
        out[self.cell, self._index_in_cell] = self.rows
        return out

    @cached_property
    def _cov_given_modes(self) -> Array:
        """Covariances (Z, p, p) of the points given the modes."""
        modelled = self.rows @ self.problem.modes.pair[self.cell] @ self.rows.mT
        return symmetrize(self.prior_cov - modelled)

    def _point_cov(self, marginals: Marginals) -> tuple[Array, Array]:
        """Covariances (K−1, 2 d, m p) of the modes with each cell's points, (Z, p, p) of points."""
        cells, count, p, wide = self._points.shape
        rows, size = self._points.reshape(cells, count * p, wide), wide // 2
        early, late = rows[..., :size].mT, rows[..., size:].mT
        cross = np.empty((cells, wide, count * p))
        cross[:, :size] = marginals.cov[:-1] @ early + marginals.cross @ late
        cross[:, size:] = marginals.cross.mT @ early + marginals.cov[1:] @ late
        by_point = cross.reshape(cells, wide, count, p).transpose(0, 2, 1, 3)
        own = (self._points @ by_point)[self.cell, self._index_in_cell]
        return cross, self._cov_given_modes + symmetrize(own)

    def _gradient(
        self,
        chol: Cholesky,
        marginals: Marginals,
        cross: Array,
        gradient: Array,
        rows: Array,
        slopes: Array,
    ) -> Array:
        """Diagonals (K−1, q) of rows X slopesᵀ for X = P M P; rows and slopes are (K−1, q, 2 d).

        M is given by its blocks (Z, p, p) at the points. The chain is Markov: with the gain
        G_j = −S_j⁻¹ U_j, P(j, k) = G_j P(j+1, k) for all k > j, hence also
        P(j, k) = G_j … G_k−1 P(k, k).
        """
        cells, count, p, wide = self._points.shape
        first, last = slice(0, wide // 2), slice(wide // 2, wide)
        by_point = np.zeros((cells, count, p, p))
        by_point[self.cell, self._index_in_cell] = gradient
        own = cross.reshape(cells, wide, count, p).transpose(0, 2, 1, 3)
        weighted = (own @ by_point).transpose(0, 2, 1, 3).reshape(cross.shape)
        gain = -(chol.inverse[:-1].mT @ chol.coupling)
        ends = self._points[..., first] @ gain[:, None] + self._points[..., last]
        weighted_ends, ends = (x.reshape(cells, count * p, -1) for x in (by_point @ ends, ends))
        after = weighted[:, first] @ cross[:, first].mT
        before = ends.mT @ weighted_ends
        later = np.zeros_like(gain)  # P M P at k + 1, contribution of the cells after k
        for k in reversed(range(cells - 1)):
            later[k] = after[k + 1] + gain[k + 1] @ later[k + 1] @ gain[k + 1].T
        earlier = np.zeros_like(gain)  # P M P at k, of cells before k, without P(k, k) at both ends
        for k in range(1, cells):
            earlier[k] = before[k - 1] + gain[k - 1].T @ earlier[k - 1] @ gain[k - 1]
        cov, lagged = marginals.cov[:-1], marginals.cross.mT
        to_later = [x[..., first] @ gain + x[..., last] for x in (rows, slopes)]
        to_earlier = [x[..., first] @ cov + x[..., last] @ lagged for x in (rows, slopes)]
        return (
            np.vecdot(rows @ weighted, slopes @ cross)
            + np.vecdot(to_later[0] @ later, to_later[1])
            + np.vecdot(to_earlier[0] @ earlier, to_earlier[1])
        )


def path_objective_of(
    problem: PlanningProblem, zones: Sequence[Zone], objective: Objective
) -> PathObjective:
    """Objective of a path over zones, evaluated at the middles of the time cells.

    Raises:
        GlissandoError: There is no zone, a zone leaves the body or the horizon, or `objective` is
            not an objective.
    """
    advice = "give predict_information(…)"
    require_kind(problem, PlanningProblem, "planning problem", advice)
    span, length = (problem.start, problem.end), float(problem.ahead.grid.arclength[-1])
    require_objective(objective, length)
    place, time, weight = zone_points(zones, problem.zone_times, span, length)
    order = np.argsort(time, kind="stable")
    cell, rows, cov = problem.points(place[order], time[order])
    p = objective.rows
    return PathObjective(problem, objective, cell, rows[:, :p], cov[:, :p, :p], weight[order])


def by_cell(rows: Array, steps_per_cell: int) -> Array:
    """Rows (T, q, 2 d) of steps, grouped by time cell (K−1, m, 2 d) and zero-padded."""
    cells = -(-len(rows) // steps_per_cell)
    out = np.zeros((cells * steps_per_cell, *rows.shape[1:]))
    out[: len(rows)] = rows
    return out.reshape(cells, -1, rows.shape[-1])


def cubic_weights(x: Array) -> Array:
    """Catmull–Rom weights of four neighbours for x in [0, 1] between the middle two, and slopes.

    The result (…, 2, 4) holds the weights, then their derivatives by x.
    """
    basis = 0.5 * np.array([[0, -1, 2, -1], [2, 0, -5, 3], [0, 1, 4, -3], [0, 0, -1, 1]])
    order = np.arange(4)
    powers = np.stack([x[..., None] ** order, order * x[..., None] ** np.maximum(order - 1, 0)], -2)
    return np.asarray(powers @ basis.T)
