"""Slope of half the log-determinant of the information by the force along a rod. Source: (37)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.grid import Grid, Index
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.state import STRAIN, State
from glissando.solver.block_tridiagonal import Marginals
from glissando.solver.located_readings import time_blocks

_ALONG = STRAIN.start + 2  # strain along the rod, by whose force it bends more or less readily
_NUDGE = 0.1  # standard deviations of the prior: step of the finite differences
_LEAST = 1e-12  # strain: least step, where readings add nothing


def log_det_slope(prior: MechanicalPrior, grid: Grid, state: State, added: Marginals) -> Array:
    """Slopes (K, N, dof) of ½ log det A − ½ log det A₀ by the strain along the rod at each node.

    A is the information of all readings and the prior, A₀ that of the prior alone. The slopes are
    traces of (A⁻¹ − A₀⁻¹) Jᵀ ∂J over the whitened Jacobians J of the prior, by finite differences;
    those by all other unknowns are negligible. Every second node is moved at a time, so that of
    the nodes of a factor one moves at each of its times.

    Args:
        prior: The prior.
        grid: Its nodes.
        state: Nodes (K, N) at which A and A₀ are linearised.
        added: Blocks of A⁻¹ − A₀⁻¹ for the unknowns of the nodes.
    """
    (k_count, n_count), dof = grid.shape, state.dof
    weights = [
        _whitened(batch) @ _between(added, batch.nodes, n_count, dof)
        for batch in _factors(prior, grid, state)
    ]
    scale = _NUDGE * np.sqrt(np.max(np.abs(np.einsum("kii->ki", added.cov)), axis=0))
    scale = np.maximum(scale.reshape(n_count, dof)[:, _ALONG], _LEAST)
    sums = np.zeros(k_count * n_count)
    for parity in (0, 1):
        for sign in (1.0, -1.0):
            step = np.zeros((k_count, n_count, dof))
            step[:, parity::2, _ALONG] = sign * scale[parity::2]
            moved = _factors(prior, grid, state.retract(step))
            for batch, weight in zip(moved, weights, strict=True):
                m, c = batch.nodes.shape
                traces = np.einsum("mrx,mrx->mx", _whitened(batch), weight)
                _add_by_time(sums, batch.nodes, n_count, sign * traces.reshape(m, c, -1), parity)
    slopes = np.zeros((k_count, n_count, dof))
    slopes[..., _ALONG] = sums.reshape(k_count, n_count) / (2.0 * scale)
    return slopes


def _between(blocks: Marginals, nodes: Index, n_count: int, dof: int) -> Array:
    """Blocks (M, c · dof, c · dof) between the nodes (M, c) of factors, of one or two times."""
    slab, node = np.divmod(nodes, n_count)
    column = (node[..., None] * dof + np.arange(dof)).reshape(len(nodes), -1)
    time = np.repeat(slab[0] - slab[0, 0], dof)
    first, out = slab[:, 0, None, None], np.empty((len(nodes), column.shape[1], column.shape[1]))
    early, late = np.flatnonzero(time == 0), np.flatnonzero(time == 1)
    for rows, columns in ((early, early), (late, late), (early, late)):
        if not (rows.size and columns.size):
            continue
        at = column[:, rows, None], column[:, None, columns]
        if rows is not columns:
            block = blocks.cross[first, *at]
            out[:, columns[:, None], rows] = block.mT
        else:
            block = blocks.cov[first + time[rows[0]], *at]
        out[:, rows[:, None], columns] = block
    return out


def _add_by_time(sums: Array, nodes: Index, n_count: int, values: Array, parity: int) -> None:
    """Add values (M, c, dof) to that node of a factor which moved at the same time.

    Args:
        sums: Sums (K · N,) over the factors.
        nodes: Nodes (M, c) of the factors.
        n_count: Number N of arclength nodes.
        values: Parts of the traces from each node's columns.
        parity: Parity of the nodes that moved.
    """
    slab, node = np.divmod(nodes, n_count)
    for j in range(nodes.shape[1]):
        hit = node[:, j] % 2 == parity
        same = slab[hit] == slab[hit, j, None]
        np.add.at(sums, nodes[hit, j], np.sum(values[hit].sum(axis=2) * same, axis=1))


def _factors(prior: MechanicalPrior, grid: Grid, state: State) -> Iterator[Factors]:
    """Factors of the prior, weighted as at the state, by runs of time nodes."""
    for times in time_blocks(grid):
        yield from prior.factors(grid, state, state, times)


def _whitened(batch: Factors) -> Array:
    """Whitened Jacobians (M, r, c · dof) of factors."""
    return batch.whitened()[1]
