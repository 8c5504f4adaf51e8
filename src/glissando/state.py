"""The state at the nodes: pose, strain and velocity, index order [time, arclength]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from glissando import se3
from glissando.grid import Grid
from glissando.se3 import Array

DOF = 18
"""Degrees of freedom of a node, in the order pose, strain, velocity."""

POSE, STRAIN, VELOCITY = slice(0, 6), slice(6, 12), slice(12, 18)


@dataclass(frozen=True)
class State:
    """Pose T_wb, strain and velocity at points; any leading shape, (K, N) on a grid.

    `pose` (…, 4, 4); `strain` (…, 6) with dT/ds = T strain^ (1/m on the angular half);
    `velocity` (…, 6) with dT/dt = T velocity^; both in the body frame, [linear, angular].
    Source: equation (1).
    """

    pose: Array
    strain: Array
    velocity: Array

    def retract(self, step: Array) -> State:
        """The state moved by `step` (…, 18): poses on the right, the rest by addition."""
        return State(
            self.pose @ se3.exp(step[..., POSE]),
            self.strain + step[..., STRAIN],
            self.velocity + step[..., VELOCITY],
        )

    def difference(self, other: State) -> Array:
        """The step (…, 18) that takes `other` to this state: self = other.retract(step)."""
        return np.concatenate(
            [
                se3.log(se3.inverse(other.pose) @ self.pose),
                self.strain - other.strain,
                self.velocity - other.velocity,
            ],
            axis=-1,
        )

    def take(self, index: Any) -> State:
        """The state at leading indices, as numpy would index an array of points."""
        return State(self.pose[index], self.strain[index], self.velocity[index])

    def reshape(self, *shape: int) -> State:
        """The state with another leading shape; it shares memory as numpy's reshape does."""
        return State(
            self.pose.reshape(*shape, 4, 4),
            self.strain.reshape(*shape, 6),
            self.velocity.reshape(*shape, 6),
        )

    def integrated(self, arclength: Array) -> State:
        """The state (K, N) with poses that follow from the base pose and the strains."""
        pose = self.pose.copy()
        for n, step in enumerate(np.diff(arclength)):
            rate = 0.5 * (self.strain[:, n] + self.strain[:, n + 1])
            pose[:, n + 1] = pose[:, n] @ se3.exp(step * rate)
        return State(pose, self.strain, self.velocity)

    def flatten(self) -> State:
        """The state as one list of points (M,), sharing memory."""
        return self.reshape(-1)


def rest_state(grid: Grid, base_pose: Array, rest_strain: Array) -> State:
    """The robot at rest on every node: constant strain from the base, no velocity.

    `base_pose` (4, 4), `rest_strain` (6,). This is where an estimate starts unless told otherwise.
    """
    k, n = grid.shape
    pose = base_pose @ se3.exp(grid.arclength[:, None] * rest_strain)
    return State(
        np.broadcast_to(pose, (k, n, 4, 4)).copy(),
        np.broadcast_to(rest_strain, (k, n, 6)).copy(),
        np.zeros((k, n, 6)),
    )
