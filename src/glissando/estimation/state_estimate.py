"""State and covariance at any arclength and time, given those of the nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index, points_of
from glissando.model.interpolation import sort_points
from glissando.model.priors.prior import Prior
from glissando.model.short_repr import ShortRepr
from glissando.model.state import DOF, State
from glissando.solver.block_tridiagonal import Marginals

_CHUNK = 500  # queries at a time: with more, allocating memory takes longer than computing
_UNMOVED = np.eye(4)

Spread = Callable[[Index, Array, Array], Array]
"""Covariances (M, r, r) from nodes (M, c), Jacobians (M, r, c, dof), and covariances given them."""


@dataclass(frozen=True)
class StateEstimate(ShortRepr):
    """State and covariance at queried points, with the leading shape of the query.

    `pose` (…, 4, 4), `strain` (…, 6), `velocity` (…, 6) and `cov` (…, 18, 18) of
    [pose, strain, velocity], each [linear, angular], in the body frame (pose on the right).
    """

    pose: Array
    strain: Array
    velocity: Array
    cov: Array

    def take(self, index: Any) -> StateEstimate:
        """The estimate at leading indices, as numpy would index an array of points."""
        return type(self)(*(field[index] for field in vars(self).values()))

    @property
    def position(self) -> Array:
        """Position (…, 3) in the world, metres."""
        return self.pose[..., :3, 3]

    @property
    def quaternion(self) -> Array:
        """Orientation (…, 4) as [w, x, y, z], body to world."""
        return se3.quaternion(self.pose[..., :3, :3])

    @property
    def cov_position_world(self) -> Array:
        """Covariance (…, 3, 3) of the position in the world frame."""
        rotation = self.pose[..., :3, :3]
        return rotation @ self.position_covariance() @ np.swapaxes(rotation, -1, -2)

    def position_covariance(self, mount: Array = _UNMOVED) -> Array:
        """Covariance (…, 3, 3) of a mounted frame's position, in its axes. Source: (34).

        Args:
            mount: Pose (4, 4) of the frame on the body, or one each (…, 4, 4).
        """
        lever = se3.adjoint(se3.inverse(mount))
        return se3.position_covariance(lever @ self.cov[..., :6, :6] @ np.swapaxes(lever, -1, -2))

    @property
    def std_position(self) -> Array:
        """Root of the total position variance (…), metres."""
        return np.sqrt(np.einsum("...ii->...", self.position_covariance()))

    @property
    def std_rotation(self) -> Array:
        """Root of the total rotation variance (…), radians."""
        return np.sqrt(np.einsum("...ii->...", self.cov[..., 3:6, 3:6]))

    @property
    def std_strain(self) -> Array:
        """Standard deviations (…, 6) of the strain, [linear (1), angular (rad/m)]."""
        return self._std[..., 6:12]

    @property
    def std_velocity(self) -> Array:
        """Standard deviations (…, 6) of the velocity, [linear (m/s), angular (rad/s)]."""
        return self._std[..., 12:18]

    @property
    def _std(self) -> Array:
        return np.sqrt(np.diagonal(self.cov, axis1=-2, axis2=-1))


def state_at(
    prior: Prior,
    grid: Grid,
    state: State,
    covariance: Spread,
    arclength: ArrayLike,
    time: ArrayLike,
) -> StateEstimate:
    """State with its 18×18 covariance at points of a grid, given its nodes.

    Args:
        prior: The prior of the motion.
        grid: The grid.
        state: Mean (K, N) at the nodes.
        covariance: Computes the covariance at points from that of their nodes.
        arclength: Metres; broadcast with `time`.
        time: Seconds.

    Raises:
        OutsideGridError: A point is off the grid.

    Source: equations (10) to (12).
    """
    s, t = points_of(arclength, time)
    shape, s, t = s.shape, s.ravel(), t.ravel()
    grid.require(s, t, "Query")
    out = StateEstimate(
        np.empty((s.size, 4, 4)),
        np.empty((s.size, 6)),
        np.empty((s.size, 6)),
        np.empty((s.size, DOF, DOF)),
    )
    for first in range(0, s.size, _CHUNK):
        here = slice(first, first + _CHUNK)
        for points in sort_points(grid, s[here], t[here]):
            at, rows = prior.interpolate(grid, state, state, points), first + points.rows
            out.pose[rows], out.strain[rows] = at.state.pose, at.state.strain
            out.velocity[rows] = at.state.velocity
            out.cov[rows] = covariance(at.nodes, at.jacobian, at.cov)
    return StateEstimate(*(a.reshape(*shape, *a.shape[1:]) for a in vars(out).values()))


def spread(grid: Grid, marginals: Marginals, nodes: Index, slopes: Array, left: Array) -> Array:
    """Covariance (M, r, r) of quantities that depend on nodes.

    Args:
        grid: The grid.
        marginals: Covariance of the nodes' unknowns, a slab for each time.
        nodes: Nodes (M, c), k · N + n.
        slopes: Jacobians (M, r, c, dof) by these nodes.
        left: Covariance (M, r, r) of the quantities given the nodes.
    """
    slab, inner = np.divmod(nodes, grid.arclength.size)
    return marginals.spread(slab, inner * slopes.shape[-1], slopes, left)
