"""Batches of factors, summed, spread out and judged: twins of sweep.py, sums.py and chains.py."""

from __future__ import annotations

import numpy as np

from glissando._kernels import chains as chained
from glissando._kernels import sweep as swept
from glissando._kernels.arrays import whole
from glissando.estimation.interval_system import Layout
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.solver.block_tridiagonal_batch import BatchCholesky


def _factors(batch: Factors) -> tuple[Array | int, ...]:
    m, r = batch.terms.residual.shape
    extras = np.zeros((m, r, 0)) if batch.extras is None else whole(batch.extras)
    fields = batch.jacobian, batch.terms.residual, batch.terms.sqrt_info
    return whole(batch.nodes), batch.dofs.start, *map(whole, fields), extras


def add_factors(batch: Factors, layout: Layout, blocks: Array, pulls: Array) -> None:
    """Twin of that in sweep."""
    *given, extras = _factors(batch)
    weights = batch.terms.robust_weights()
    shape = layout.nodes, layout.dof, layout.size
    swept.add_factors(*given, weights, extras, *shape, blocks, pulls)


def spread_out(batch: Factors, layout: Layout, count: int) -> tuple[Array, Array]:
    """Twin of that in sweep."""
    shape = layout.nodes, layout.dof, layout.size
    return swept.spread_out(*_factors(batch), *shape, count)


def squared_innovations(residual: Array, known: Array) -> Array:
    """Twin of that in sweep."""
    return swept.squared_innovations(whole(residual), whole(known))


def add_to_neighbours(
    batch: Factors, n_count: int, blocks: tuple[Array, ...], right: Array
) -> None:
    """Twin of that in sums."""
    *given, _ = _factors(batch)
    swept.add_to_neighbours(*given, batch.terms.robust_weights(), n_count, blocks, right)


def factor_batch(diagonal: Array, lower: Array) -> BatchCholesky:
    """Twin of that in chains."""
    return BatchCholesky(*chained.factor_batch(whole(diagonal), whole(lower)))
