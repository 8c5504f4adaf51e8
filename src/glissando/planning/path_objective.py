"""The worth of a path and its gradient: one factorisation, one pass forth and one back.

With P the covariance after a path and M the slope of the objective, dJ = tr(M dP) = −tr(X dΛ) for
X = P M P, of which a reading's cell needs only its own block: P is the inverse of a
block-tridiagonal matrix, so what a far cell says reaches a near one through the gains between
neighbouring times. Source: equations (21), (23), (24).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.priors.transitions import symmetrize
from glissando.planning.objectives import Objective
from glissando.planning.planning_problem import PlanningProblem
from glissando.planning.zones import Zone, zone_points
from glissando.solver.block_tridiagonal import BlockTridiagonal, Cholesky, Marginals, factor


@dataclass(frozen=True)
class PathObjective:
    """Judges paths of an outlook by an objective over zones: call it with arclengths (T,).

    `cell` (Z,), `rows` (Z, p, 2 d), `before` (Z, p, p) and `weight` (Z,) are of the zones' points,
    in order of their time cells.
    """

    outlook: PlanningProblem
    objective: Objective
    cell: Index
    rows: Array
    before: Array
    weight: Array

    def __call__(self, arclength: Array) -> tuple[float, Array]:
        """Value of a path (T,), and its slope (T,) by every place."""
        rows, slopes = self.readings(arclength)
        chol, marginals = self._known(rows)
        reached, cov = self._zones(marginals)
        value, slope = self.objective(cov, self.weight)
        seen, moved = (by_cell(part, self.outlook.inside) for part in (rows, slopes))
        by_row = self._passed(chol, marginals, reached, slope, seen, moved).ravel()
        by_step = by_row[: rows[..., 0].size].reshape(len(rows), -1)
        return value, -2.0 * by_step.sum(axis=1)

    def value(self, arclength: Array) -> float:
        """Value of a path (T,)."""
        return self.objective(self.cov(arclength), self.weight)[0]

    def cov(self, arclength: Array) -> Array:
        """Covariance (Z, p, p) of the zones' points after a path (T,)."""
        return self._zones(self._known(self.readings(arclength)[0])[1])[1]

    def readings(self, arclength: Array) -> tuple[Array, Array]:
        """Rows (T, C r, 2 d) of all coils' readings, and their slopes by the place.

        A cubic through four places of the lattice, with a continuous slope (Catmull and Rom).
        """
        lattice, table = self.outlook.lattice, self._table
        step = lattice[1] - lattice[0]
        place = (arclength[:, None] - self.outlook.sensor.behind - lattice[0]) / step
        lower = np.clip(np.floor(place).astype(np.intp), 0, lattice.size - 2)
        weights = _cubic(place - lower)
        weights[..., 1, :] /= step
        at = np.arange(arclength.size)[:, None, None], lower[..., None] + np.arange(4)
        found = weights @ table[at].reshape(*lower.shape, 4, -1)
        shape = arclength.size, -1, table.shape[-1]
        return found[..., 0, :].reshape(shape), found[..., 1, :].reshape(shape)

    @cached_property
    def _table(self) -> Array:
        """Rows at the places of the lattice and one more at each end, (T, L + 2, r, 2 d).

        A parabola through the three places next to it leads there.
        """
        rows = self.outlook.rows
        low, high = rows[:, :3], rows[:, :-4:-1]
        beyond = [3.0 * end[:, :1] - 3.0 * end[:, 1:2] + end[:, 2:] for end in (low, high)]
        return np.concatenate([beyond[0], rows, beyond[1]], axis=1)

    def _known(self, rows: Array) -> tuple[Cholesky, Marginals]:
        """Factor and covariances of the modes after readings with these rows (T, q, 2 d)."""
        before = self.outlook.modes.system
        size = before.diagonal.shape[1]
        seen = by_cell(rows, self.outlook.inside)
        told = np.swapaxes(seen, -1, -2) @ seen
        diagonal, lower = before.diagonal.copy(), before.lower + told[:, size:, :size]
        diagonal[:-1] += told[:, :size, :size]
        diagonal[1:] += told[:, size:, size:]
        chol = factor(BlockTridiagonal(diagonal, lower))
        return chol, chol.marginals()

    @cached_property
    def _slot(self) -> Index:
        """Where each point (Z,) is among those of its time cell."""
        return np.arange(self.cell.size) - np.searchsorted(self.cell, self.cell)

    @cached_property
    def _points(self) -> Array:
        """Rows (K−1, m, p, 2 d) of each time cell's points, filled up with nothing."""
        most = int(self._slot.max()) + 1
        out = np.zeros((len(self.outlook.modes.pair), most, *self.rows.shape[1:]))
        out[self.cell, self._slot] = self.rows
        return out

    @cached_property
    def _left(self) -> Array:
        """Covariance (Z, p, p) of the points that the modes leave open."""
        told = self.rows @ self.outlook.modes.pair[self.cell] @ _transposed(self.rows)
        return symmetrize(self.before - told)

    def _zones(self, marginals: Marginals) -> tuple[Array, Array]:
        """Covariance (K−1, 2 d, m p) of the modes with each cell's points, and theirs (Z, p, p)."""
        cells, count, p, wide = self._points.shape
        rows, size = self._points.reshape(cells, count * p, wide), wide // 2
        early, late = _transposed(rows[..., :size]), _transposed(rows[..., size:])
        reached = np.empty((cells, wide, count * p))
        reached[:, :size] = marginals.cov[:-1] @ early + marginals.cross @ late
        reached[:, size:] = _transposed(marginals.cross) @ early + marginals.cov[1:] @ late
        own = reached.reshape(cells, wide, count, p).transpose(0, 2, 1, 3)
        told = (self._points @ own)[self.cell, self._slot]
        return reached, self._left + symmetrize(told)

    def _passed(
        self,
        chol: Cholesky,
        marginals: Marginals,
        reached: Array,
        slope: Array,
        seen: Array,
        moved: Array,
    ) -> Array:
        """Diagonals (K−1, q) of seen X movedᵀ, rows (K−1, q, 2 d) of cells, by X = P M P there.

        M is given by its slopes (Z, p, p) at points. What is known at one time depends on what lies
        beyond a neighbouring time only through it: P(j, later) = G_j P(j+1, later) with the gain
        G_j = −S_j⁻¹ U_j, hence also P(earlier j, k) = G_j … G_k−1 P(k, k).
        """
        cells, count, p, wide = self._points.shape
        first, last = slice(0, wide // 2), slice(wide // 2, wide)
        by_point = np.zeros((cells, count, p, p))
        by_point[self.cell, self._slot] = slope
        own = reached.reshape(cells, wide, count, p).transpose(0, 2, 1, 3)
        turned = (own @ by_point).transpose(0, 2, 1, 3).reshape(reached.shape)
        gain = -(_transposed(chol.inverse[:-1]) @ chol.coupling)
        ends = self._points[..., first] @ gain[:, None] + self._points[..., last]
        weighed, ends = (part.reshape(cells, count * p, -1) for part in (by_point @ ends, ends))
        after = turned[:, first] @ _transposed(reached[:, first])
        before = _transposed(ends) @ weighed
        later = np.zeros_like(gain)  # P M P at k + 1, of cells after k
        for k in reversed(range(cells - 1)):
            later[k] = after[k + 1] + gain[k + 1] @ later[k + 1] @ gain[k + 1].T
        earlier = np.zeros_like(gain)  # what P(k, k) makes P M P there, of cells before k
        for k in range(1, cells):
            earlier[k] = before[k - 1] + gain[k - 1].T @ earlier[k - 1] @ gain[k - 1]
        cov, cross = marginals.cov[:-1], _transposed(marginals.cross)
        to_later = [rows[..., first] @ gain + rows[..., last] for rows in (seen, moved)]
        to_earlier = [rows[..., first] @ cov + rows[..., last] @ cross for rows in (seen, moved)]
        return (
            _products(seen @ turned, moved @ reached)
            + _products(to_later[0] @ later, to_later[1])
            + _products(to_earlier[0] @ earlier, to_earlier[1])
        )


def judge_of(
    outlook: PlanningProblem, zones: Sequence[Zone], objective: Objective
) -> PathObjective:
    """The judge of an outlook's paths by an objective over zones.

    Zones count at the middles of the outlook's time cells. Raises GlissandoError for zones off the
    body or the time ahead.
    """
    grid, span = outlook.ahead.grid, (outlook.start, outlook.last)
    place, time, weight = zone_points(zones, outlook.middles, span, float(grid.arclength[-1]))
    order = np.argsort(time, kind="stable")
    cell, rows, cov = outlook.points(place[order], time[order])
    p = objective.rows
    return PathObjective(outlook, objective, cell, rows[:, :p], cov[:, :p, :p], weight[order])


def _products(left: Array, right: Array) -> Array:
    """Products (…, q) of rows with rows."""
    return np.einsum("...i,...i->...", left, right)


def _transposed(matrix: Array) -> Array:
    return np.swapaxes(matrix, -1, -2)


def by_cell(rows: Array, inside: int) -> Array:
    """Rows (K−1, m, 2 d) of time cells of so many steps, of those (T, q, 2 d) of the steps.

    The last cell is filled up with nothing.
    """
    cells = -(-len(rows) // inside)
    if len(rows) < cells * inside:
        rows = np.concatenate([rows, np.zeros((cells * inside - len(rows), *rows.shape[1:]))])
    return rows.reshape(cells, -1, rows.shape[-1])


def _cubic(x: Array) -> Array:
    """Weights (…, 2, 4) of the neighbours of a place x in [0, 1] between the middle two; slopes."""
    basis = 0.5 * np.array([[0, -1, 2, -1], [2, 0, -5, 3], [0, 1, 4, -3], [0, 0, -1, 1]])
    order = np.arange(4)
    powers = np.stack([x[..., None] ** order, order * x[..., None] ** np.maximum(order - 1, 0)], -2)
    return np.asarray(powers @ basis.T)
