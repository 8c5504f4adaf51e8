"""The normal equations of a sliding window, by interval, and their factor."""

from __future__ import annotations

from copy import copy

import numpy as np

from glissando._kernels import window as kernels
from glissando._kernels.window import ACROSS, BEGIN, COUPLING, END, INVERSE
from glissando.geometry.se3 import Array
from glissando.solver.block_tridiagonal import BlockTridiagonal, Cholesky, eliminate
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder

_ROOM = 8  # slabs that memory is made for at first


class WindowSystem:
    """Slabs of a window: they come at its end and leave at its front as a prior on the next.

    Each interval's sums are kept apart, so that those which did not change need not be found again,
    in memory that is larger than the window, so that they seldom move.

    Attributes:
        layout: How the numbers of a slab are laid out.
        info: What is known (D, D) of the oldest slab from before.
        rhs: The right-hand side (D,) of that.
        intact: How many slabs, from the oldest on, have sums and factor up to date.
    """

    def __init__(self, layout: Layout, info: Array, rhs: Array) -> None:
        self.layout, self.info, self.rhs = layout, info, rhs
        self._blocks = np.empty((COUPLING + 1, _ROOM, layout.size, layout.size))
        self._vectors = np.empty((3, _ROOM, layout.size))
        self._first = self._stop = self.intact = 0

    def __len__(self) -> int:
        return self._stop - self._first

    def copied(self) -> WindowSystem:
        """The same in memory of its own."""
        out, used = copy(self), slice(self._first, self._stop)
        out._blocks, out._vectors = self._blocks[:, used].copy(), self._vectors[:, used].copy()
        out.info, out.rhs = self.info.copy(), self.rhs.copy()
        out._first, out._stop = 0, len(self)
        return out

    def append(self) -> None:
        """One slab more, of which nothing is known yet."""
        if self._stop == self._blocks.shape[1]:
            used, count = slice(self._first, self._stop), len(self)
            room = max(self._stop, 4 * count)
            self._blocks = _moved(self._blocks, used, room)
            self._vectors = _moved(self._vectors, used, room)
            self._first, self._stop = 0, count
        self._stop += 1

    def _used(self, which: int) -> Array:
        """Blocks of one kind; those that couple slabs are one fewer."""
        return self._blocks[which, self._first : self._stop - (which in (ACROSS, COUPLING))]

    def builder(self, first: int) -> NormalEquationsBuilder:
        """What sums the intervals from slab `first` on anew."""
        self.intact = min(self.intact, first)
        rhs_begin, rhs_end = self._vectors[:2, self._first + first : self._stop]
        begin, end, across = (self._used(i)[first:] for i in (BEGIN, END, ACROSS))
        return NormalEquationsBuilder(self.layout, begin, end, across, rhs_begin, rhs_end)

    def system(self) -> tuple[BlockTridiagonal, Array]:
        """The normal equations."""
        vectors, diagonal = self._vectors.copy(), np.empty_like(self._used(BEGIN))
        known = self._blocks, vectors, self.info, self.rhs, self._first
        for k in range(len(self)):
            kernels.sum_slab(*known, self._first + k, k, diagonal)
        rhs = vectors[2, self._first : self._stop]
        return BlockTridiagonal(diagonal, self._used(ACROSS).copy()), rhs

    @property
    def cholesky(self) -> Cholesky:
        """The factor."""
        return Cholesky(self._used(INVERSE), self._used(COUPLING))

    def solve(self, first: int) -> Array:
        """Eliminate from slab `first` on, where sums are new; the solution (K, D).

        Raises:
            UnobservableError: Some direction of the state has no information.
        """
        solution = np.empty((len(self), self.layout.size))
        known = self._blocks, self._vectors, self.info, self.rhs, self._first, self._stop
        eliminate(kernels.solve, *known, first, solution)
        self.intact = len(self)
        return solution

    def drop(self) -> None:
        """Leave the oldest slab behind, as a prior on the next. Source: equation (20)."""
        kernels.drop(self._blocks, self._vectors, self.info, self.rhs, self._first)
        self._first, self.intact = self._first + 1, self.intact - 1


def _moved(memory: Array, used: slice, room: int) -> Array:
    """Memory for `room` slabs that begins with those which are used: the same, if it is enough."""
    count = used.stop - used.start
    out = memory if room == memory.shape[1] else np.empty((len(memory), room, *memory.shape[2:]))
    out[:, :count] = memory[:, used]
    return out
