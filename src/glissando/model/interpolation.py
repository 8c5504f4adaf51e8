"""States at points between the nodes, conditional on the nodes.

A point on a grid line depends on the two nodes of that line, a point on a node on that node alone.
The bridge covariance is that of a point whose nodes are known (equation 12).
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
    """State at M points, with its Jacobian by the nodes and its bridge covariance.

    `nodes` (M, c) are indices k·N + n of the nodes on which points depend (c = 1, 2 or 4),
    `jacobian` (M, 18, c, dof) is that of the state at the points by those nodes, and `bridge` the
    bridge covariance (M, 18, 18), or a function that computes it when it is needed.
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
        """Interpolation at the points of a slice."""
        own = self.state.take(rows), self.nodes[rows], self.jacobian[rows]
        return Interpolation(*own, lambda: self.cov[rows])


@dataclass(frozen=True)
class Points:
    """Points that depend on equally many nodes; `rows` (M,) are their indices among all points.

    `along` and `through` are their cells along arclength and along time.
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
