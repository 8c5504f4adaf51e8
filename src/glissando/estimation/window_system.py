"""The normal equations of a sliding window, by interval, and their factor."""

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

_ROOM = 8  # slabs that memory is made for at first


class WindowSystem:
    """Slabs of a window: they come at its end and leave at its front as a prior on the next.

    What each interval adds is kept apart, so that what did not change need not be found again, in
    places of which a slab that comes takes one that another left.

    Attributes:
        layout: How the numbers of a slab are laid out.
        intact: How many slabs, from the oldest on, have sums and factor up to date.
    """

    def __init__(self, layout: Layout, info: Array, rhs: Array) -> None:
        """Begin with one slab, of which `info` (D, D) and `rhs` (D,) are known."""
        self.layout, self.intact = layout, 0
        self._make_room(_ROOM)
        self._slot = np.zeros(1, dtype=np.intp)
        self.info[:], self.rhs = info, rhs
        self._vectors[SCALE, 0] = np.diagonal(info)

    def _make_room(self, room: int) -> None:
        size = self.layout.size
        self._blocks = np.zeros((COUPLING + 1, room, size, size))
        self._vectors = np.empty((SCALE + 1, room, size))
        self._aside = np.zeros((2, room, size))
        self._sums = np.empty((ACROSS + 1, room, size, size)), np.empty((2, room, size))

    def __len__(self) -> int:
        return len(self._slot)

    @property
    def info(self) -> Array:
        """What is known (D, D) of the oldest slab from before."""
        return self._blocks[KNOWN, self._slot[0]]

    @property
    def rhs(self) -> Array:
        """The right-hand side (D,) of that."""
        return self._vectors[BEHIND, self._slot[0]].copy()

    @rhs.setter
    def rhs(self, values: Array) -> None:
        """Another right-hand side (D,)."""
        self._vectors[BEHIND, self._slot[0]] = values

    def copied(self) -> WindowSystem:
        """The same in memory of its own."""
        out = copy(self)
        out._keep(self._slot, self._blocks.shape[1])
        return out

    def _keep(self, slot: Index, room: int) -> None:
        """Move slabs to the front of new memory."""
        blocks, vectors, aside, count = self._blocks, self._vectors, self._aside, len(slot)
        self._make_room(room)
        self._blocks[:, :count], self._vectors[:, :count] = blocks[:, slot], vectors[:, slot]
        self._aside[:, :count] = aside[:, slot]
        self._slot = np.arange(count)

    def append(self) -> None:
        """One slab more, of which nothing is known yet."""
        room, slots = self._blocks.shape[1], self._slot.tolist()
        if len(slots) == room:
            self._keep(self._slot, 2 * room)
            slots = self._slot.tolist()
        self._slot = np.array([*slots, min(set(range(len(slots) + 1)).difference(slots))])

    def drop(self) -> None:
        """Leave the oldest slab behind; the next knows what it says. Source: equation (20)."""
        self._slot, self.intact = self._slot[1:], self.intact - 1

    def builder(self, first: int) -> NormalEquationsBuilder:
        """What sums the intervals from slab `first` on anew."""
        self.intact, count = min(self.intact, first), len(self) - first
        blocks, vectors = self._sums
        begin, end, across = blocks[:, :count]
        rhs_begin, rhs_end = vectors[:, :count]
        return NormalEquationsBuilder(
            self.layout, begin, end[:-1], across[:-1], rhs_begin, rhs_end[:-1]
        )

    def solve(self, first: int, sums: NormalEquationsBuilder) -> Array:
        """Eliminate from slab `first` on, of which these are the sums; the solution (K, D).

        Raises:
            UnobservableError: Some direction of the state has no information.
        """
        solution = np.empty((len(self), self.layout.size))
        memory = self._blocks, self._vectors, self._slot
        eliminate(kernels.solve, *memory, first, *sums.sums, solution)
        self.intact = len(self)
        return solution

    def solve_with(self, sums: NormalEquationsBuilder, at: Index, info: Array, rhs: Array) -> Array:
        """The same with information (d, d) and right-hand side (d,) on numbers of the newest slab.

        Args:
            sums: Of all slabs, as they were eliminated.
            at: Which numbers (d,).
            info: Information on them.
            rhs: Their right-hand side.
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
        """Know more of numbers (d,) of the oldest slab: information (d, d), right-hand sides."""
        self.info[np.ix_(at, at)] += info
        self._vectors[BEHIND, self._slot[0], at] += rhs

    def respond(self, first: int, sums: NormalEquationsBuilder) -> Array:
        """The solution (K, D) for the right-hand side of other sums from slab `first` on.

        Their blocks do not count; of what older slabs say of it only what such sums said is known.
        """
        solution, rhs = np.empty((len(self), self.layout.size)), (sums.rhs_begin, sums.rhs_end)
        kernels.respond(self._blocks, self._aside, self._slot, first, *rhs, solution)
        return solution

    def system(self) -> tuple[BlockTridiagonal, Array]:
        """The normal equations."""
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
        """Inverses and couplings of the factor as kernels take them: in places, and which."""
        return self._blocks[INVERSE], self._blocks[COUPLING], self._slot

    @property
    def cholesky(self) -> Cholesky:
        """The factor."""
        inverse, coupling, slot = self.factor
        return Cholesky(inverse[slot], coupling[slot[:-1]])

    @property
    def root(self) -> Array:
        """The inverse (D, D) of the newest slab's factor."""
        return self._blocks[INVERSE, self._slot[-1]]
