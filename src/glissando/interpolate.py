"""The state, its Jacobian and its leftover covariance at any arclength and time.

Inside a cell: along arclength at both times, then along time (equation 11). On a grid line only
the two nodes of that line are touched, on a node one. Leftover covariance is the bridge's (12):
what nodes cannot tell about a point between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from glissando.grid import Grid, Index
from glissando.prior import KinematicPrior
from glissando.se3 import Array
from glissando.state import DOF, State
from glissando.steps import ARCLENGTH, TIME, between


@dataclass(frozen=True)
class Interpolation:
    """State at M points, with what it takes to carry covariance there.

    `nodes` (M, c) touched nodes k·N + n (c = 1, 2 or 4), `jacobian` (M, 18, c, 18) of the state at
    the points with respect to those nodes, `cov` (M, 18, 18) the bridge covariance.
    """

    state: State
    nodes: Index
    jacobian: Array
    cov: Array

    def take(self, rows: slice) -> Interpolation:
        """The interpolation at some of its points."""
        return Interpolation(
            self.state.take(rows), self.nodes[rows], self.jacobian[rows], self.cov[rows]
        )


@dataclass(frozen=True)
class Points:
    """Points of a grid that touch equally many nodes; `rows` (M,) says which of the given ones."""

    rows: Index
    arclength: Array
    time: Array
    inside_arclength: bool
    inside_time: bool


def sort_points(grid: Grid, arclength: Array, time: Array) -> Iterator[Points]:
    """Split points (M,) by whether they lie on a node, on a grid line, or inside a cell."""
    s, t = grid.locate(arclength, time)
    off_s = (s.offset > 0.0) & (s.offset < s.step)
    off_t = (t.offset > 0.0) & (t.offset < t.step)
    for inside_s in (False, True):
        for inside_t in (False, True):
            rows = np.flatnonzero((off_s == inside_s) & (off_t == inside_t))
            if rows.size:
                yield Points(rows, arclength[rows], time[rows], inside_s, inside_t)


def interpolate(
    prior: KinematicPrior, grid: Grid, state: State, about: State, points: Points
) -> Interpolation:
    """State at points between the nodes, conditional on the nodes. Source: equations (10) to (12).

    Gains and bridge covariances come from the rates of `about`, a state on the same grid, as the
    weights of the prior do; they are constants to the Jacobian.
    """
    n_count = grid.arclength.size
    s, t = grid.locate(points.arclength, points.time)
    on_node_s = s.lower + (s.offset >= s.step) * (s.step > 0.0)
    on_node_t = t.lower + (t.offset >= t.step) * (t.step > 0.0)
    flat = state.flatten()
    share = (s.offset / np.where(s.step > 0.0, s.step, 1.0))[:, None]
    above = np.minimum(s.lower + 1, n_count - 1)

    def along_arclength(k: Index) -> Interpolation:
        if not points.inside_arclength:
            nodes = (k * n_count + on_node_s)[:, None]
            eye = np.broadcast_to(np.eye(DOF)[:, None, :], (k.size, DOF, 1, DOF))
            return Interpolation(flat.take(nodes[:, 0]), nodes, eye, np.zeros((k.size, DOF, DOF)))
        nodes = (k * n_count + s.lower)[:, None] + np.arange(2)
        start, end = flat.take(nodes[:, 0]), flat.take(nodes[:, 1])
        rate = 0.5 * (about.strain[k, s.lower] + about.strain[k, above])
        found = prior.bridge(ARCLENGTH, rate, (s.step, s.offset, grid.time_spans[k]))
        at, j0, j1, cov = between(ARCLENGTH, start, end, s.step, s.offset, found)
        return Interpolation(at, nodes, np.stack([j0, j1], axis=2), cov)

    if not points.inside_time:
        return along_arclength(on_node_t)
    early, late = along_arclength(t.lower), along_arclength(t.lower + 1)
    mean = 0.5 * (about.velocity[t.lower] + about.velocity[t.lower + 1])
    rows = np.arange(len(share))
    rate = (1.0 - share) * mean[rows, s.lower] + share * mean[rows, above]
    span = np.interp(points.arclength, grid.arclength, grid.arclength_spans)
    found = prior.bridge(TIME, rate, (t.step, t.offset, span))
    at, j0, j1, cov = between(TIME, early.state, late.state, t.step, t.offset, found)
    for jacobian, corner in ((j0, early), (j1, late)):
        if points.inside_arclength:
            cov = cov + jacobian @ corner.cov @ np.swapaxes(jacobian, -1, -2)
    jacobian = np.concatenate([_chain(j0, early.jacobian), _chain(j1, late.jacobian)], axis=2)
    return Interpolation(at, np.concatenate([early.nodes, late.nodes], axis=1), jacobian, cov)


def _chain(outer: Array, inner: Array) -> Array:
    m, r, c, d = inner.shape
    return (outer @ inner.reshape(m, r, c * d)).reshape(m, r, c, d)
