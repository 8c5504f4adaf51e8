"""Normal equations of a sliding window, stored by interval, and their factor."""

from __future__ import annotations

from copy import copy

import numpy as np

from glissando._kernels import window as kernels
from glissando._kernels.window import (
    ACROSS,
    AHEAD,
    BEGIN,
    BEHIND,
    COUPLING,
    INVERSE,
    KNOWN,
    SCALE,
    SOLVED,
)
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.solver.block_tridiagonal import BlockTridiagonal, Cholesky, eliminate
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder

_FIRST_SLABS = 8  # slabs for which memory is allocated at first


class WindowSystem:
    """Slabs of a window, appended at its end and marginalised at its front.

    The sums of each interval are stored separately, so that those which did not change need not be
    computed again. A new slab reuses the memory of one that left.

    Attributes:
        layout: Layout of the unknowns of a slab.
        intact: Number of slabs, from the oldest on, whose sums and factor are up to date.
    """

    def __init__(self, layout: Layout, info: Array, rhs: Array) -> None:
        """Begin with one slab, on which the prior is `info` (D, D) and `rhs` (D,)."""
        self.layout, self.intact = layout, 0
        self._allocate(_FIRST_SLABS)
        self._slot = np.zeros(1, dtype=np.intp)
        self.info[:], self.rhs = info, rhs
        self._vectors[SCALE, 0] = np.diagonal(info)

    def _allocate(self, room: int) -> None:
        size = self.layout.size
        self._blocks = np.zeros((COUPLING + 1, room, size, size))
        self._vectors = np.empty((SCALE + 1, room, size))
        self._aside = np.zeros((2, room, size))
        self._sums = np.empty((ACROSS + 1, room, size, size)), np.empty((2, room, size))

    def __len__(self) -> int:
        return len(self._slot)

    @property
    def info(self) -> Array:
        """Information (D, D) of the prior on the oldest slab."""
        return self._blocks[KNOWN, self._slot[0]]

    @property
    def rhs(self) -> Array:
        """Right-hand side (D,) of the prior on the oldest slab."""
        return self._vectors[BEHIND, self._slot[0]].copy()

    @rhs.setter
    def rhs(self, values: Array) -> None:
        """Set the right-hand side (D,) of the prior."""
        self._vectors[BEHIND, self._slot[0]] = values

    def copied(self) -> WindowSystem:
        """A copy with its own memory."""
        out = copy(self)
        out._reallocate(self._slot, self._blocks.shape[1])
        return out

    def _reallocate(self, slot: Index, room: int) -> None:
        """Copy slabs to the front of newly allocated memory."""
        blocks, vectors, aside, count = self._blocks, self._vectors, self._aside, len(slot)
        self._allocate(room)
        self._blocks[:, :count], self._vectors[:, :count] = blocks[:, slot], vectors[:, slot]
        self._aside[:, :count] = aside[:, slot]
        self._slot = np.arange(count)

    def append(self) -> None:
        """Append a slab without information."""
        room, slots = self._blocks.shape[1], self._slot.tolist()
        if len(slots) == room:
            self._reallocate(self._slot, 2 * room)
            slots = self._slot.tolist()
        self._slot = np.array([*slots, min(set(range(len(slots) + 1)).difference(slots))])

    def drop(self) -> None:
        """Marginalise the oldest slab into the prior on the next. Source: equation (20)."""
        self._slot, self.intact = self._slot[1:], self.intact - 1

    def builder(self, first: int) -> NormalEquationsBuilder:
        """Builder of new sums for the intervals from slab `first` on."""
        self.intact, count = min(self.intact, first), len(self) - first
        blocks, vectors = self._sums
        begin, end, across = blocks[:, :count]
        rhs_begin, rhs_end = vectors[:, :count]
        return NormalEquationsBuilder(
            self.layout, begin, end[:-1], across[:-1], rhs_begin, rhs_end[:-1]
        )

    def solve(self, first: int, sums: NormalEquationsBuilder) -> Array:
        """Eliminate from slab `first` on with new sums; the solution (K, D) of all slabs.

        Raises:
            UnobservableError: Some direction of the state has no information.
        """
        solution = np.empty((len(self), self.layout.size))
        memory = self._blocks, self._vectors, self._slot
        eliminate(kernels.solve, *memory, first, *sums.sums, solution)
        self.intact = len(self)
        return solution

    def solve_with(self, sums: NormalEquationsBuilder, at: Index, info: Array, rhs: Array) -> Array:
        """Solve with more information on unknowns of the newest slab.

        Args:
            sums: Sums of all slabs, as they were eliminated.
            at: Indices (d,) of the unknowns.
            info: Information (d, d) to add on these.
            rhs: Right-hand side (d,) to add.
        """
        solution, last = np.empty((len(self), self.layout.size)), len(self) - 1
        begin, end, across, rhs_begin, rhs_end = (each[last:] for each in sums.sums)
        begin, rhs_begin = begin.copy(), rhs_begin.copy()
        begin[0][np.ix_(at, at)] += info
        rhs_begin[0, at] += rhs
        memory = self._blocks, self._vectors, self._slot
        eliminate(kernels.solve, *memory, last, begin, end, across, rhs_begin, rhs_end, solution)
        return solution

    def add(self, at: Index, info: Array, rhs: Array) -> None:
        """Add information (d, d) and right-hand side (d,) on unknowns `at` of the oldest slab."""
        self.info[np.ix_(at, at)] += info
        self._vectors[BEHIND, self._slot[0], at] += rhs

    def respond(self, first: int, sums: NormalEquationsBuilder) -> Array:
        """Solution (K, D) for the right-hand side of other sums from slab `first` on.

        Their blocks are ignored; slabs before `first` contribute by the sums of earlier calls.
        """
        solution, rhs = np.empty((len(self), self.layout.size)), (sums.rhs_begin, sums.rhs_end)
        kernels.respond(self._blocks, self._aside, self._slot, first, *rhs, solution)
        return solution

    def system(self) -> tuple[BlockTridiagonal, Array]:
        """Matrix and right-hand side (K, D) of the normal equations."""
        blocks, vectors = self._blocks[:, self._slot], self._vectors[:, self._slot]
        half, coupling = np.tril(blocks[BEGIN] + blocks[KNOWN]), blocks[COUPLING, :-1]
        turned = coupling.swapaxes(1, 2)
        diagonal = half + np.tril(half, -1).swapaxes(1, 2)
        diagonal[1:] += turned @ coupling
        rhs = vectors[AHEAD] + vectors[BEHIND]
        rhs[1:] += (turned @ vectors[SOLVED, :-1, :, None])[..., 0]
        return BlockTridiagonal(diagonal, blocks[ACROSS, :-1]), rhs

    @property
    def factor(self) -> tuple[Array, Array, Index]:
        """Inverses and couplings of the factor as kernels take them, and the slots of slabs."""
        return self._blocks[INVERSE], self._blocks[COUPLING], self._slot

    @property
    def cholesky(self) -> Cholesky:
        """Cholesky factor of the matrix, with slabs in order."""
        inverse, coupling, slot = self.factor
        return Cholesky(inverse[slot], coupling[slot[:-1]])

    @property
    def root(self) -> Array:
        """Inverse R (D, D) of the newest slab's factor, whose covariance is Rᵀ R."""
        return self._blocks[INVERSE, self._slot[-1]]
