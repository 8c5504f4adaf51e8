"""Points between the nodes, and what is known there given the nodes.

On a grid line only the two nodes of that line are touched, on a node one. Leftover covariance is
what nodes cannot tell about a point between them (equation 12).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Cells, Grid, Index
from glissando.model.state import State


@dataclass(frozen=True)
class Interpolation:
    """State at M points, with what it takes to carry covariance there.

    `nodes` (M, c) touched nodes k·N + n (c = 1, 2 or 4), `jacobian` (M, 18, c, dof) of the state at
    the points with respect to those nodes, `bridge` the bridge covariance (M, 18, 18), or what
    computes it, as many ask for the state alone.
    """

    state: State
    nodes: Index
    jacobian: Array
    bridge: Array | Callable[[], Array]

    @cached_property
    def cov(self) -> Array:
        """The bridge covariance (M, 18, 18)."""
        return self.bridge() if callable(self.bridge) else self.bridge

    @property
    def dof(self) -> int:
        """Degrees of freedom of a node."""
        return int(self.jacobian.shape[-1])

    def take(self, rows: slice) -> Interpolation:
        """The interpolation at some of its points."""
        own = self.state.take(rows), self.nodes[rows], self.jacobian[rows]
        return Interpolation(*own, lambda: self.cov[rows])


@dataclass(frozen=True)
class Points:
    """Points of a grid that touch equally many nodes; `rows` (M,) says which of the given ones.

    `along` and `through` are the cells they lie in, along arclength and through time.
    """

    rows: Index
    arclength: Array
    time: Array
    along: Cells
    through: Cells
    inside_arclength: bool
    inside_time: bool


def sort_points(grid: Grid, arclength: Array, time: Array) -> Iterator[Points]:
    """Split points (M,) by whether they lie on a node, on a grid line, or inside a cell."""
    s, t = grid.locate(arclength, time)
    off_s = (s.offset > 0.0) & (s.offset < s.step)
    off_t = (t.offset > 0.0) & (t.offset < t.step)
    part = 2 * off_s + off_t
    for kind in np.flatnonzero(np.bincount(part, minlength=1)):
        rows = np.flatnonzero(part == kind)
        cells = s.take(rows), t.take(rows)
        yield Points(rows, arclength[rows], time[rows], *cells, bool(kind & 2), bool(kind & 1))
