"""Sums of factors: small dense blocks of neighbouring nodes first, wide slabs after."""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.grid import Grid, Index
from glissando.solver.block_tridiagonal import BlockTridiagonal
from glissando.twins import twin

_AHEAD = ((0, 0), (0, 1), (1, -1), (1, 0), (1, 1))  # in (time, arclength), of neighbours


def slab_shape(grid: Grid, dof: int, extras: int = 0) -> tuple[int, ...]:
    """Shape of the memory a system needs: diagonal slabs, then those below the diagonal.

    A slab holds the nodes of one time, `dof` numbers each, then `extras` that belong to no node.
    """
    k_count, n_count = grid.shape
    size = n_count * dof + extras
    return 2 * k_count - 1, size, size


class NormalEquationsBuilder:
    """Jᵀ J summed by pairs of neighbouring nodes, and −Jᵀ r by nodes.

    Factors touch a node and its neighbours only, so a block is kept for each node and, by how far
    the row's node is ahead of the column's in (time, arclength), for each pair of neighbours; the
    other half follows by symmetry. These sums are small and dense where the slabs are wide and
    mostly zero. Extras have blocks of their own, by how far they are ahead of the node in time.
    """

    def __init__(self, grid: Grid, dof: int, extras: int = 0) -> None:
        k, n = grid.shape
        self._grid, self._dof, self._extras = grid, dof, extras
        self._blocks = {ahead: np.zeros((k - ahead[0], n, dof, dof)) for ahead in _AHEAD}
        self._nodes_right = np.zeros((k * n, dof))
        self._crossed = {ahead: np.zeros((k, n, extras, dof)) for ahead in (-1, 0, 1)}
        self._extra_blocks = {ahead: np.zeros((k - ahead, extras, extras)) for ahead in (0, 1)}
        self._extras_right = np.zeros((k, extras))

    def add(self, batch: Factors) -> None:
        """Add a batch of factors."""
        if batch.extras is None:
            blocks = tuple(self._blocks.values())
            add_to_neighbours(batch, self._grid.arclength.size, blocks, self._nodes_right)
            return
        nodes, hessian, pull = by_nodes(batch)
        wide = nodes.shape[1] * batch.jacobian.shape[-1]
        slab, inner = np.divmod(nodes, self._grid.arclength.size)
        blocks = tuple(self._blocks.values())
        _add_blocks(slab, inner, batch.dofs, hessian[:, :wide, :wide], blocks)
        _add_pulls(nodes, batch.dofs, pull[:, :wide], self._nodes_right)
        self._add_extras(batch, slab, inner, hessian[:, wide:], pull[:, wide:])

    def _add_extras(
        self, batch: Factors, slab: Index, inner: Index, hessian: Array, pull: Array
    ) -> None:
        """Add what couples extras, now and one time node later, to nodes and to each other."""
        count, d, e = slab.shape[1], batch.jacobian.shape[-1], self._extras
        k_count = self._grid.time.size
        lower = np.minimum(slab[:, 0], max(k_count - 2, 0))
        for later in range(min(2, k_count)):
            rows, k = slice(later * e, later * e + e), lower + later
            np.add.at(self._extras_right, k, -pull[:, rows])
            for b in range(count):
                block = hessian[:, rows, b * d : b * d + d]
                for ahead, crossed in self._crossed.items():
                    at = np.flatnonzero(k - slab[:, b] == ahead)
                    node = (slab[at, b], inner[at, b], slice(None), batch.dofs)
                    crossed[node] += block[at]
            for earlier in range(later + 1):
                columns = slice(count * d + earlier * e, count * d + earlier * e + e)
                block = hessian[:, rows, columns]
                np.add.at(self._extra_blocks[later - earlier], lower + earlier, block)

    def add_chain(self, decay: Array, spread: Array, residual: Array) -> None:
        """Add extras that fade by `decay` (K−1, E), with innovations (K, E) of that spread."""
        info = spread**-2.0
        diagonal = self._extra_blocks[0]
        each = np.arange(self._extras)
        diagonal[:, each, each] += info
        diagonal[:-1, each, each] += decay**2 * info[1:]
        self._extra_blocks[1][:, each, each] -= decay * info[1:]
        self._extras_right -= info * residual
        self._extras_right[:-1] += decay * info[1:] * residual[1:]

    @property
    def right(self) -> Array:
        """−Jᵀ r (K, N · dof + E)."""
        k_count = self._grid.time.size
        return np.hstack([self._nodes_right.reshape(k_count, -1), self._extras_right])

    def chains(self) -> tuple[Array, Array, Array]:
        """Blocks (K, N, d, d) and (K, N−1, d, d) along arclength, and −Jᵀ r (K, N, d).

        All there is where no factor couples times and no extras are.
        """
        right = self._nodes_right.reshape(*self._grid.shape, self._dof)
        return self._blocks[0, 0], self._blocks[0, 1][:, :-1], right

    def slabs(self, room: Array) -> BlockTridiagonal:
        """The sums spread out as a block-tridiagonal matrix in `room`."""
        (k_count, n_count), d = self._grid.shape, self._dof
        room.fill(0.0)
        diagonal, lower = room[:k_count], room[k_count:]
        where = [slice(n * d, n * d + d) for n in range(n_count)]
        for (later, further), blocks in self._blocks.items():
            slabs = lower if later else diagonal
            for n in range(max(0, -further), n_count - max(0, further)):
                slabs[:, where[n + further], where[n]] = blocks[:, n]
                if (later, further) == (0, 1):
                    slabs[:, where[n], where[n + 1]] = np.swapaxes(blocks[:, n], -1, -2)
        if self._extras:
            extras = slice(n_count * d, None)
            diagonal[:, extras, extras] = self._extra_blocks[0]
            lower[:, extras, extras] = self._extra_blocks[1]
            for n, at in enumerate(where):
                diagonal[:, extras, at] = self._crossed[0][:, n]
                diagonal[:, at, extras] = np.swapaxes(self._crossed[0][:, n], -1, -2)
                lower[:, extras, at] = self._crossed[1][: k_count - 1, n]
                lower[:, at, extras] = np.swapaxes(self._crossed[-1][1:, n], -1, -2)
        return BlockTridiagonal(diagonal, lower)


@twin
def add_to_neighbours(
    batch: Factors, n_count: int, blocks: tuple[Array, ...], right: Array
) -> None:
    """Add Jᵀ J to `blocks` by how far rows are _AHEAD of columns, and −Jᵀ r to `right` (K N, d).

    A block (K, N, d, d) is that of the column's node. The batch has no extras.
    """
    nodes, hessian, pull = by_nodes(batch)
    slab, inner = np.divmod(nodes, n_count)
    _add_blocks(slab, inner, batch.dofs, hessian, blocks)
    _add_pulls(nodes, batch.dofs, pull, right)


def _add_blocks(
    slab: Index, inner: Index, dofs: slice, hessian: Array, blocks: tuple[Array, ...]
) -> None:
    count, d = slab.shape[1], dofs.stop - dofs.start
    for a, b in np.ndindex(count, count):
        ahead = (int(slab[0, a] - slab[0, b]), int(inner[0, a] - inner[0, b]))
        if ahead in _AHEAD:
            at = (slab[:, b], inner[:, b], dofs, dofs)
            rows, columns = slice(a * d, a * d + d), slice(b * d, b * d + d)
            blocks[_AHEAD.index(ahead)][at] += hessian[:, rows, columns]


def _add_pulls(nodes: Index, dofs: slice, pull: Array, right: Array) -> None:
    d = dofs.stop - dofs.start
    for a in range(nodes.shape[1]):
        right[nodes[:, a], dofs] -= pull[:, a * d : a * d + d]


def by_nodes(batch: Factors) -> tuple[Index, Array, Array]:
    """Nodes (G, c), Jᵀ J (G, q, q) and Jᵀ r (G, q), summed over factors that share nodes.

    The q columns are d for each of the c nodes, then the extras'. All factors of a batch touch
    nodes in the same pattern, so the first one tells them apart.
    """
    residual, jacobian = batch.whitened()
    hessian = np.swapaxes(jacobian, -1, -2) @ jacobian
    pull = np.matmul(residual[:, None, :], jacobian)[:, 0]
    nodes, first = batch.nodes, batch.nodes[:, 0]
    if not np.all(np.diff(first) > 0):
        if not np.all(np.diff(first) >= 0):
            order = np.argsort(first, kind="stable")
            nodes, hessian, pull = nodes[order], hessian[order], pull[order]
        starts = np.flatnonzero(np.append(True, np.diff(nodes[:, 0]) > 0))
        hessian, pull = np.add.reduceat(hessian, starts), np.add.reduceat(pull, starts)
        nodes = nodes[starts]
    return nodes, hessian, pull
