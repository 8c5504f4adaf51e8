"""The worth of a path and its gradient: one factorisation, one pass forth and one back.

With P the covariance after a path and M the slope of the objective, dJ = tr(M dP) = −tr(X dΛ) for
X = P M P, of which a reading's cell needs only its own block: P is the inverse of a
block-tridiagonal matrix, so what a far cell says reaches a near one through the gains between
neighbouring times. Source: equations (21), (23), (24).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.grid import Index
from glissando.plan.objectives import Objective
from glissando.plan.outlook import Outlook
from glissando.plan.zones import Zone, zone_points
from glissando.se3 import Array
from glissando.slabs import BlockTridiagonal, Cholesky, Marginals, factor
from glissando.transitions import symmetrize


@dataclass(frozen=True)
class Judge:
    """Judges paths of an outlook by an objective over zones: call it with arclengths (T,).

    `cell` (Z,), `rows` (Z, p, 2 d), `before` (Z, p, p) and `weight` (Z,) are of the zones' points,
    in order of their time cells.
    """

    outlook: Outlook
    objective: Objective
    cell: Index
    rows: Array
    before: Array
    weight: Array

    def __call__(self, arclength: Array) -> tuple[float, Array]:
        """Value of a path (T,), and its slope (T,) by every place."""
        rows, slopes = self.readings(arclength)
        chol, marginals = self._known(rows)
        value, slope = self.objective(self._cov(marginals), self.weight)
        turned = self._passed(chol, marginals, self._spread(slope))
        seen, moved = (by_cell(part, self.outlook.inside) for part in (rows, slopes))
        by_row = np.einsum("kij,kij->ki", seen @ turned, moved).ravel()
        by_step = by_row[: rows[..., 0].size].reshape(len(rows), -1)
        return value, -2.0 * by_step.sum(axis=1)

    def value(self, arclength: Array) -> float:
        """Value of a path (T,)."""
        marginals = self._known(self.readings(arclength)[0])[1]
        return self.objective(self._cov(marginals), self.weight)[0]

    def cov(self, arclength: Array) -> Array:
        """Covariance (Z, p, p) of the zones' points after a path (T,)."""
        return self._cov(self._known(self.readings(arclength)[0])[1])

    def readings(self, arclength: Array) -> tuple[Array, Array]:
        """Rows (T, C r, 2 d) of all coils' readings, and their slopes by the place.

        A cubic through four places of the lattice, with a continuous slope (Catmull and Rom).
        """
        lattice, table = self.outlook.lattice, self.outlook.rows
        step = lattice[1] - lattice[0]
        place = (arclength[:, None] - self.outlook.sensor.behind - lattice[0]) / step
        lower = np.clip(np.floor(place).astype(np.intp), 0, lattice.size - 2)
        weights, slopes = _cubic(place - lower)
        near, edges = lower[..., None] + np.arange(-1, 3), (0, lattice.size - 1)
        weights, slopes = (_at_edges(w, near, edges) for w in (weights, slopes))
        picked = table[np.arange(arclength.size)[:, None, None], np.clip(near, *edges)]
        shape = arclength.size, -1, table.shape[-1]
        rows = np.einsum("tcw,tcwij->tcij", weights, picked).reshape(shape)
        return rows, np.einsum("tcw,tcwij->tcij", slopes / step, picked).reshape(shape)

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

    def _cov(self, marginals: Marginals) -> Array:
        gained = (self.outlook.modes.pair - _pairs(marginals))[self.cell]
        return symmetrize(self.before - self.rows @ gained @ np.swapaxes(self.rows, -1, -2))

    def _spread(self, slope: Array) -> Array:
        """M (K−1, 2 d, 2 d) of each time cell, from the slopes (Z, p, p) of points in it."""
        out = np.zeros_like(self.outlook.modes.pair)
        each = np.swapaxes(self.rows, -1, -2) @ (slope @ self.rows)
        starts = np.flatnonzero(np.diff(self.cell, prepend=-1))
        out[self.cell[starts]] = np.add.reduceat(each, starts)
        return out

    @staticmethod
    def _passed(chol: Cholesky, marginals: Marginals, slope: Array) -> Array:
        """Blocks (K−1, 2 d, 2 d) of P M P, M being given by its part in each time cell.

        What is known at one time depends on what lies beyond a neighbouring time only through it:
        P(k, later) = G_k P(k+1, later), G_k = −S_k⁻¹ U_k, and P(k+1, earlier) = F_k P(k, earlier).
        """
        cov, cross = marginals.cov, marginals.cross
        size = cov.shape[1]
        back = -np.swapaxes(chol.inverse[:-1], -1, -2) @ chol.coupling
        forth = np.linalg.solve(cov[:-1], cross).swapaxes(-1, -2)
        pairs = _pairs(marginals)
        out = pairs @ slope @ pairs
        later = np.zeros_like(cov)  # at k, from cells at and after k
        for k in reversed(range(len(back))):
            later[k] = out[k, :size, :size] + back[k] @ later[k + 1] @ back[k].T
        earlier = np.zeros_like(cov)  # at k, from cells before k
        for k, gain in enumerate(forth):
            earlier[k + 1] = out[k, size:, size:] + gain @ earlier[k] @ gain.T
        eye = np.broadcast_to(np.eye(size), cross.shape)
        for lift, part in (
            (np.concatenate([back, eye], axis=1), later[1:]),
            (np.concatenate([eye, forth], axis=1), earlier[:-1]),
        ):
            out += lift @ part @ np.swapaxes(lift, -1, -2)
        return out


def judge_of(outlook: Outlook, zones: Sequence[Zone], objective: Objective) -> Judge:
    """The judge of an outlook's paths by an objective over zones.

    Zones count at the middles of the outlook's time cells. Raises GlissandoError for zones off the
    body or the time ahead.
    """
    grid, span = outlook.ahead.grid, (outlook.start, outlook.last)
    place, time, weight = zone_points(zones, outlook.middles, span, float(grid.arclength[-1]))
    order = np.argsort(time, kind="stable")
    cell, rows, cov = outlook.points(place[order], time[order])
    p = objective.rows
    return Judge(outlook, objective, cell, rows[:, :p], cov[:, :p, :p], weight[order])


def _pairs(marginals: Marginals) -> Array:
    """Joint covariance (K−1, 2 d, 2 d) of neighbouring times."""
    cov, cross = marginals.cov, marginals.cross
    size = cov.shape[1]
    out = np.empty((len(cross), 2 * size, 2 * size))
    out[:, :size, :size], out[:, size:, size:] = cov[:-1], cov[1:]
    out[:, :size, size:], out[:, size:, :size] = cross, np.swapaxes(cross, -1, -2)
    return out


def by_cell(rows: Array, inside: int) -> Array:
    """Rows (K−1, m, 2 d) of time cells of so many steps, of those (T, q, 2 d) of the steps.

    The last cell is filled up with nothing.
    """
    cells = -(-len(rows) // inside)
    if len(rows) < cells * inside:
        rows = np.concatenate([rows, np.zeros((cells * inside - len(rows), *rows.shape[1:]))])
    return rows.reshape(cells, -1, rows.shape[-1])


def _cubic(x: Array) -> tuple[Array, Array]:
    """Weights (…, 4) of the neighbours of a place x in [0, 1] between the middle two; slopes."""
    basis = 0.5 * np.array([[0, -1, 2, -1], [2, 0, -5, 3], [0, 1, 4, -3], [0, 0, -1, 1]])
    powers = x[..., None] ** np.arange(4)
    slopes = np.arange(4) * x[..., None] ** np.maximum(np.arange(4) - 1, 0)
    return powers @ basis.T, slopes @ basis.T


def _at_edges(weights: Array, near: Index, edges: tuple[int, int]) -> Array:
    """Weights (…, 4) with those beyond the ends of the lattice given to a parabola inside it."""
    out = weights.copy()
    for beyond, own, share in ((0, 1, 3.0), (0, 2, -3.0), (0, 3, 1.0)):
        out[..., own] += share * np.where(near[..., beyond] < edges[0], weights[..., beyond], 0.0)
    for beyond, own, share in ((3, 2, 3.0), (3, 1, -3.0), (3, 0, 1.0)):
        out[..., own] += share * np.where(near[..., beyond] > edges[1], weights[..., beyond], 0.0)
    out[..., 0] = np.where(near[..., 0] < edges[0], 0.0, out[..., 0])
    out[..., 3] = np.where(near[..., 3] > edges[1], 0.0, out[..., 3])
    return out
