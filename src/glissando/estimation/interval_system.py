"""Factors by the interval between time nodes they lie in: summed, spread out and judged.

A time node has D numbers, those of its N nodes and then E of unknowns; an interval has those of
both its ends, 2 D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.grid import Index
from glissando.solver.normal_equations import by_nodes
from glissando.twins import twin


@dataclass(frozen=True)
class Layout:
    """How the D numbers of a time node are laid out: `nodes` · `dof`, then `extras`."""

    nodes: int
    dof: int
    extras: int

    @property
    def size(self) -> int:
        """How many numbers a time node has."""
        return self.nodes * self.dof + self.extras

    def places(self, batch: Factors, touched: Index, count: int) -> tuple[Index, Index]:
        """Interval (G,) of factors on nodes (G, c), and columns (G, q) of its numbers.

        The last of `count` time nodes begins an interval that has no end.
        """
        slab, inner = np.divmod(touched, self.nodes)
        k = slab[:, 0]
        if batch.extras is not None:
            k = np.minimum(k, max(count - 2, 0))
        dofs = np.arange(batch.dofs.start, batch.dofs.stop)
        first = (slab - k[:, None]) * self.size + inner * self.dof
        columns = (first[:, :, None] + dofs).reshape(len(touched), -1)
        if batch.extras is not None:
            own = self.nodes * self.dof + np.arange(self.extras)
            both = np.append(own, own + self.size)
            columns = np.hstack([columns, np.broadcast_to(both, (len(touched), both.size))])
        return k, columns


@twin
def add_factors(batch: Factors, layout: Layout, blocks: Array, pulls: Array) -> None:
    """Add Jᵀ J of a batch to `blocks` (K, 2 D, 2 D) of intervals, and −Jᵀ r to `pulls` (K, 2 D)."""
    touched, hessian, pull = by_nodes(batch)
    k, columns = layout.places(batch, touched, len(blocks))
    rows = k[:, None] * pulls.shape[1] + columns  # flat indices are several times faster
    cells = rows[:, :, None] * pulls.shape[1] + columns[:, None, :]
    np.add.at(blocks.reshape(-1), cells.ravel(), hessian.ravel())
    np.subtract.at(pulls.reshape(-1), rows.ravel(), pull.ravel())


@twin
def spread_out(batch: Factors, layout: Layout, count: int) -> tuple[Array, Array]:
    """Whitened residuals (M, r) and Jacobians (M, r, count · D) with respect to `count` time nodes.

    Not robustly weighted.
    """
    k, columns = layout.places(batch, batch.nodes, count)
    residual, jacobian = batch.whitened(robust=False)
    m, r = residual.shape
    out = np.zeros((m, r, (count + 1) * layout.size))  # one for unknowns after the last: no weight
    at = (k[:, None] * layout.size + columns)[:, None]
    np.put_along_axis(out, np.broadcast_to(at, jacobian.shape), jacobian, axis=2)
    return residual, out[..., : count * layout.size]


@twin
def squared_innovations(residual: Array, known: Array) -> Array:
    """Squared innovations (M,) of residuals at a solution, each against all other factors.

    `residual` (M, r) is white with its own factor left out; of its unit covariance the solution
    explains J P Jᵀ = Y Yᵀ, `known` being Y (M, r, …). A residual e that keeps a share S = 1 − Y Yᵀ
    stands for the innovation S⁻¹ e, whose square in units of its covariance is eᵀ S⁻¹ e.
    """
    share = (1.0 + 1e-9) * np.eye(residual.shape[1]) - known @ np.swapaxes(known, 1, 2)
    return np.einsum("mr,mr->m", residual, np.linalg.solve(share, residual[..., None])[..., 0])


def substituted(jacobian: Array, inverses: Sequence[Array], aheads: Sequence[Array]) -> Array:
    """Y (R, K · D) with J P Jᵀ = Y Yᵀ, by substitution through a factor of the information.

    `inverses` (D, D) of its diagonal blocks, and `aheads` (D, D) what couples each with the next.
    """
    rows = jacobian.reshape(len(jacobian), len(inverses), -1)
    out = np.empty_like(rows)
    for k, inverse in enumerate(inverses):
        row = rows[:, k] - out[:, k - 1] @ aheads[k - 1] if k else rows[:, k]
        out[:, k] = row @ inverse.T
    return out.reshape(jacobian.shape)
