"""Normal equations: whitened factors summed into one block-tridiagonal system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glissando._kernels import normal_equations as kernels
from glissando._kernels.arrays import whole
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.solver.block_tridiagonal import BlockTridiagonal


@dataclass(frozen=True)
class Layout:
    """Layout of the unknowns of a slab: `nodes` · `dof`, then those of sensor parameters.

    Attributes:
        nodes: Nodes of a slab: arclength nodes of a time, or 1 in a batch of static shapes.
        dof: Degrees of freedom of a node.
        parameters: Number of unknowns of the estimated sensor parameters.
    """

    nodes: int
    dof: int
    parameters: int = 0

    @property
    def size(self) -> int:
        """Number of unknowns of a slab."""
        return self.nodes * self.dof + self.parameters


def system_shape(count: int, size: int) -> tuple[int, int, int]:
    """Shape of a workspace for `count` slabs of `size` unknowns: diagonal blocks, then lower."""
    return 2 * count - 1, size, size


class NormalEquationsBuilder:
    """JᵀJ and −Jᵀr of factors, summed by the interval between slabs in which they lie.

    The sums at the beginning and at the end of intervals may be stored separately, so that some
    intervals can be summed again while others are kept.

    Attributes:
        layout: Layout of the unknowns of a slab.
        begin: Blocks (K, D, D) of the slabs where intervals begin.
        end: Blocks of the slabs where they end, (K, D, D) or the same memory as `begin`.
        across: Blocks (K−1, D, D) that couple an interval's end (rows) with its beginning.
        rhs_begin: −Jᵀr (K, D) where intervals begin.
        rhs_end: −Jᵀr where they end.
    """

    def __init__(
        self, layout: Layout, begin: Array, end: Array, across: Array, rhs_begin: Array,
        rhs_end: Array,
    ) -> None:  # fmt: skip
        self.layout, self.begin, self.end, self.across = layout, begin, end, across
        self.rhs_begin, self.rhs_end = rhs_begin, rhs_end
        for memory in (begin, end, across, rhs_begin, rhs_end):
            memory.fill(0.0)

    @staticmethod
    def joined(
        layout: Layout, count: int, workspace: Array | None = None
    ) -> NormalEquationsBuilder:
        """Builder of `count` slabs that adds both ends into one memory of `system_shape`."""
        if workspace is None:
            workspace = np.empty(system_shape(count, layout.size))
        begin, rhs = workspace[:count], np.empty((count, layout.size))
        return NormalEquationsBuilder(layout, begin, begin[1:], workspace[count:], rhs, rhs[1:])

    @staticmethod
    def apart(layout: Layout, count: int) -> NormalEquationsBuilder:
        """Builder of `count` slabs that stores the sums at both ends of intervals separately."""
        begin, end, across = np.empty((3, count, layout.size, layout.size))
        return NormalEquationsBuilder(
            layout, begin, end, across[1:], *np.empty((2, count, layout.size))
        )

    @property
    def sums(self) -> tuple[Array, ...]:
        """All sums, in the order of the kernels' arguments."""
        return self.begin, self.end, self.across, self.rhs_begin, self.rhs_end

    def accumulate(self, batch: Factors, weights: Array | None = None) -> None:
        """Whiten a batch of factors and add it; `weights` (M,) replace those of its loss.

        Source: equation (19).
        """
        weights = batch.terms.robust_weights() if weights is None else weights
        kernels.accumulate(
            *kernel_arguments(batch),
            weights,
            self.layout.nodes,
            self.layout.dof,
            *self.sums,
        )

    def accumulate_drift(self, decay: Array, std: Array, residual: Array) -> None:
        """Add the drift factors of sensor parameters between slabs. Source: equation (18).

        Args:
            decay: Factors (K−1, E) by which parameters decay to the next slab.
            std: Standard deviations (K, E) of the innovations, infinite where there is no factor.
            residual: Innovations (K, E).
        """
        info = std**-2.0
        at = np.arange(self.layout.size - self.layout.parameters, self.layout.size)
        self.begin[0, at, at] += info[0]
        self.rhs_begin[0, at] -= info[0] * residual[0]
        for k, fade in enumerate(decay):
            later, miss = info[k + 1], residual[k + 1]
            self.begin[k, at, at] += fade**2 * later
            self.end[k, at, at] += later
            self.across[k, at, at] -= fade * later
            self.rhs_begin[k, at] += fade * later * miss
            self.rhs_end[k, at] -= later * miss

    def system(self) -> BlockTridiagonal:
        """The sums as a block-tridiagonal matrix; only of a builder made by `joined`."""
        return BlockTridiagonal(self.begin, self.across)


class Gradient:
    """−Jᵀr (K, D) of factors, without the system: `rhs`, in the layout of slabs."""

    def __init__(self, layout: Layout, count: int) -> None:
        self.layout, self.rhs = layout, np.zeros((count, layout.size))

    def accumulate(self, batch: Factors, weights: Array | None = None) -> None:
        """Subtract Jᵀr of a batch of factors; `weights` (M,) replace those of its loss.

        Source: equation (19).
        """
        terms, layout, (m, r, c, d) = batch.terms, self.layout, batch.jacobian.shape
        weights = terms.robust_weights() if weights is None else weights
        pull = weights[:, None] * terms.whiten(terms.residual)
        pull = pull[:, None] @ terms.sqrt_info
        slab, node = np.divmod(batch.nodes, layout.nodes)
        first = slab * layout.size + node * layout.dof + batch.dofs.start
        self._take(first[..., None] + np.arange(d), pull @ batch.jacobian.reshape(m, r, c * d))
        if batch.extras is not None:
            begin = np.minimum(slab[:, 0], max(len(self.rhs) - 2, 0)) * layout.size
            ends = layout.size * np.arange(min(2, len(self.rhs)))
            own = np.arange(layout.size - layout.parameters, layout.size)
            columns = (ends[:, None] + own).ravel()
            self._take(begin[:, None] + columns, pull @ batch.extras[..., : columns.size])

    def _take(self, at: NDArray[np.intp], values: Array) -> None:
        """Subtract values from the sums at flat indices, which may repeat."""
        flat = self.rhs.reshape(-1)
        flat -= np.bincount(at.ravel(), values.ravel(), flat.size)

    def accumulate_drift(self, decay: Array, std: Array, residual: Array) -> None:
        """Subtract Jᵀr of the drift factors of sensor parameters. Source: equation (18).

        Args:
            decay: Factors (K−1, E) by which parameters decay to the next slab.
            std: Standard deviations (K, E) of the innovations.
            residual: Innovations (K, E).
        """
        pull = std**-2.0 * residual
        of_parameters = self.rhs[:, self.layout.size - self.layout.parameters :]
        of_parameters -= pull
        of_parameters[:-1] += decay * pull[1:]


def kernel_arguments(batch: Factors) -> tuple[Array | int, ...]:
    """Arguments by which a batch of factors is passed to kernels."""
    m, r = batch.terms.residual.shape
    extras = np.zeros((m, r, 0)) if batch.extras is None else whole(batch.extras)
    fields = batch.jacobian, batch.terms.residual, batch.terms.sqrt_info
    return whole(batch.nodes), batch.dofs.start, *map(whole, fields), extras
