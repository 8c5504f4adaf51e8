"""Linearised rods of a prior, of which the last is kept for those who ask for the same nodes."""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.priors.mechanical.ends import RodEnds
from glissando.model.priors.mechanical.rod import LoadedRod
from glissando.model.priors.mechanical.section import LinearizedRod
from glissando.model.state import State


class LinearizedRods:
    """Linearises a rod with its ends."""

    def __init__(self, rod: LoadedRod, ends: RodEnds) -> None:
        self._rod, self._ends = rod, ends
        self._last: LinearizedRod | None = None

    def at(self, grid: Grid, state: State) -> LinearizedRod:
        """The rod at nodes (K, N), which is kept."""
        self._last = self._known(grid, state) or self._linearized(grid, state)
        return self._last

    def covariances(
        self, grid: Grid, state: State, k: Index, n: Index, offset: Array | None
    ) -> Array:
        """Prior covariance (M, 12, 12) of pose and strain at time nodes k, on n or beyond it."""
        rod = self._known(grid, state)
        times, which = np.unique(k, return_inverse=True)
        if rod is None and 2 * times.size < len(state.strain):  # few of many moments
            rod, k = self._linearized(grid, state.take(times)), which
        return (rod or self.at(grid, state)).covariances(k, n, offset)

    def _linearized(self, grid: Grid, state: State) -> LinearizedRod:
        every = self._rod.tiled(grid, len(state.strain))
        return LinearizedRod(grid.arclength, state, every, self._ends.information(grid, state))

    def _known(self, grid: Grid, state: State) -> LinearizedRod | None:
        last = self._last
        same = last and last.state is state and np.array_equal(last.arclength, grid.arclength)
        return last if same else None
