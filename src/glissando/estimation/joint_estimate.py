"""Joint estimate of several places of the body: relative poses and distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.errors import OutsideGridError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import SAME, Grid
from glissando.model.priors.prior import Prior
from glissando.model.short_repr import ShortRepr
from glissando.model.state import DOF, State
from glissando.solver.block_tridiagonal import Marginals
from glissando.solver.spanning_factors import interpolated


@dataclass(frozen=True)
class JointEstimate(ShortRepr):
    """States of M places at one time with their joint covariance.

    Attributes:
        pose: Poses (M, 4, 4) in the world.
        strain: Strains (M, 6).
        velocity: Velocities (M, 6).
        cov: Covariance (M, 18, M, 18) of [pose, strain, velocity] of every place with every other,
            each [linear, angular] in the body frame of its own place (pose on the right).
    """

    pose: Array
    strain: Array
    velocity: Array
    cov: Array

    def relative_pose(self, first: int, second: int) -> tuple[Array, Array]:
        """Pose (4, 4) of one place in the frame of another, and its covariance (6, 6).

        Args:
            first: Index of the place in whose frame the pose is.
            second: Index of the other place, in whose frame the covariance is.

        Raises:
            OutsideGridError: An index is not that of a place.
        """
        for number in (first, second):
            if not isinstance(number, int | np.integer) or not 0 <= number < len(self.pose):
                raise OutsideGridError(
                    f"Place {number!r} is none of the {len(self.pose)} that were asked for; give "
                    f"their numbers, from 0 on, in place of arclengths."
                )
        pose = se3.inverse(self.pose[first]) @ self.pose[second]
        slope = np.concatenate([-se3.adjoint(se3.inverse(pose)), np.eye(6)], axis=1)
        pair = [first, second]
        cov = self.cov[np.ix_(pair, range(6), pair, range(6))].reshape(12, 12)
        return pose, slope @ cov @ slope.T

    def distance(self, first: int, second: int) -> tuple[float, float]:
        """Distance of two places and its standard deviation, to first order, m.

        Args:
            first: Index of a place.
            second: Index of another place.
        """
        pose, cov = self.relative_pose(first, second)
        distance = float(np.linalg.norm(pose[:3, 3]))
        along = pose[:3, 3] @ pose[:3, :3] / max(distance, np.finfo(float).tiny)
        return distance, float(np.sqrt(along @ cov[:3, :3] @ along))


def joint_estimate(
    prior: Prior, grid: Grid, state: State, marginals: Marginals, places: Array, time: float
) -> JointEstimate:
    """States of places (M,) at a time node with their joint covariance.

    Given the nodes, states inside different intervals are independent. Source: (10) to (12).

    Args:
        prior: The prior of the motion.
        grid: The grid.
        state: Mean (K, N) at the nodes.
        marginals: Covariance of the nodes' unknowns, a slab for each time.
        places: Arclengths (M,), m.
        time: A time node, s.

    Raises:
        OutsideGridError: The time is not a node, two places lie inside one interval, or one lies
            off the grid.
    """
    k = int(np.abs(grid.time - time).argmin())
    grid.require(places, np.full(places.shape, time), "Query")
    if abs(grid.time[k] - time) > SAME:
        raise OutsideGridError(
            f"Several places are known together at time nodes, and {time:g} s is none; the nearest "
            f"is {grid.time[k]:.9g} s."
        )
    _require_apart(grid, places)
    count, dof = grid.arclength.size, state.dof
    slope = np.zeros((places.size, DOF, count * dof))
    cov = np.zeros((places.size, DOF, places.size, DOF))
    now = np.full(places.shape, grid.time[k])
    mean, parts = interpolated(prior, grid, state, state, places, now)
    for rows, at in parts:
        cov[rows, :, rows] = at.cov
        for m, nodes, slopes in zip(rows, at.nodes, at.jacobian, strict=True):
            for c, node in enumerate(nodes % count):
                slope[m, :, node * dof : (node + 1) * dof] += slopes[:, c]
    known = marginals.cov[k][: count * dof, : count * dof]
    cov += np.einsum("mia,ab,njb->minj", slope, known, slope, optimize=True)
    return JointEstimate(mean.pose, mean.strain, mean.velocity, cov)


def _require_apart(grid: Grid, places: Array) -> None:
    """Raise OutsideGridError where two places lie inside one interval between nodes."""
    near = np.abs(places[:, None] - grid.arclength).min(axis=1) <= SAME
    inside = np.searchsorted(grid.arclength, places[~near])
    if np.unique(inside).size < inside.size:
        raise OutsideGridError(
            "Two of the places lie between the same arclength nodes, where the posterior knows "
            "each alone; ask at nodes, or estimate with more of them."
        )
