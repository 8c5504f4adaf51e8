"""The state at the nodes: pose, strain and velocity, index order [time, arclength]."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from glissando._kernels import rolls
from glissando._kernels import state as kernels
from glissando._kernels.arrays import items, unflatten
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.short_repr import ShortRepr

DOF = 18
"""Degrees of freedom of a state for sensors and users, in the order pose, strain, velocity."""

POSE, STRAIN, VELOCITY, STRAIN_RATE, INERTIA = (slice(6 * i, 6 * i + 6) for i in range(5))


@dataclass(frozen=True)
class State(ShortRepr):
    """Pose T_wb, strain and velocity at points; any leading shape, (K, N) on a grid.

    `pose` (…, 4, 4); `strain` (…, 6) with dT/ds = T strain^ (1/m on the angular half);
    `velocity` (…, 6) with dT/dt = T velocity^; both in the body frame, [linear, angular].
    `strain_rate` (…, 6) = ∂strain/∂t at the nodes of a prior that needs it, else None; `inertia`
    (…, 6) at those of a prior with inertia, else None: acceleration plus damping, β = p̈ + C ṗ, and
    its rate, both in the world frame, m/s² and m/s³ (equation 32).
    Source: equation (1).
    """

    pose: Array
    strain: Array
    velocity: Array
    strain_rate: Array | None = None
    inertia: Array | None = None

    @property
    def dof(self) -> int:
        """Degrees of freedom of a point: 18, 24 with a strain rate, 30 with inertia."""
        return 6 + 6 * len(self._others())

    @property
    def numbers(self) -> int:
        """Degrees of freedom of all points of one time."""
        return int(self.pose.shape[-3]) * self.dof

    def _others(self) -> list[Array]:
        """All fields but the pose, in the order of the degrees of freedom."""
        own = [self.strain, self.velocity]
        if self.strain_rate is not None:
            own.append(self.strain_rate)
        if self.inertia is not None:
            own.append(self.inertia)
        return own

    def fields(self) -> list[Array]:
        """Pose, then all other fields, in the order of the degrees of freedom."""
        return [self.pose, *self._others()]

    def retract(self, step: Array) -> State:
        """State after a `step` (…, dof): poses perturbed on the right, other fields by addition.

        A roll φ about the body's z, however large, also rotates the fields of the body frame by −φ,
        so that the curve is unchanged; to first order in the step this is plain addition. Source:
        equation (35).
        """
        lead = self.strain.shape[:-1]
        if step.shape[:-1] != lead:
            lead = np.broadcast_shapes(lead, step.shape[:-1])
        steps = items(step, lead, step.shape[-1])
        moved = [kernels.retract(items(self.pose, lead, 4, 4), steps)]
        for i, each in enumerate(self._others(), start=1):
            field = items(each, lead, 6)
            if each is self.inertia:
                moved.append(field + steps[:, 6 * i : 6 * i + 6])
            else:
                moved.append(kernels.carry(field, steps, 6 * i))
        return State(*unflatten(lead, *moved))

    def difference(self, other: State) -> Array:
        """Step (…, dof) from `other` to this state: self = other.retract(step)."""
        lead = np.broadcast_shapes(self.strain.shape[:-1], other.strain.shape[:-1])
        step = kernels.difference(items(other.pose, lead, 4, 4), items(self.pose, lead, 4, 4))
        parts = [
            own - its
            if own is self.inertia
            else kernels.change(items(its, lead, 6), step, items(own, lead, 6)).reshape(*lead, 6)
            for own, its in zip(self._others(), other._others(), strict=True)
        ]
        return np.concatenate([step.reshape(*lead, 6), *parts], axis=-1)

    def rise_from(self, other: State) -> Array:
        """Change (…, dof) from a nearby state: twist between poses, differences of other fields.

        Divided by the step between two states it is their central difference, of second order.
        """
        twist = se3.log(se3.inverse(other.pose) @ self.pose)
        fields = zip(self._others(), other._others(), strict=True)
        return np.concatenate([twist, *(own - its for own, its in fields)], axis=-1)

    def rolls_from(self, other: State) -> Array:
        """Angles (…), rad, about z by which bodies rolled from a state of the same shape."""
        lead = self.pose.shape[:-2]
        poses = (items(each.pose, lead, 4, 4) for each in (other, self))
        rolled: Array = rolls.rolls_between(*poses).reshape(lead)
        return rolled

    def slope_to(self, moved: State) -> Array:
        """Jacobian J (…, dof, dof) of steps from `moved` by steps from this state.

        A roll between the two rotates the body axes, so that a covariance C of steps from this
        state is J C Jᵀ of steps from `moved`; other curvature, of second order, is neglected.

        Args:
            moved: State after a step from this one, of the same shape.
        """
        slopes: Array = rolls.slopes_between(*self._turned(), *moved._turned(), self.dof)
        return slopes.reshape(*self.pose.shape[:-2], self.dof, self.dof)

    def _turned(self) -> tuple[Array, Array]:
        """Poses (M, 4, 4) and the concatenated body-frame fields (M, ·), for kernels."""
        lead = self.pose.shape[:-2]
        fields = [each for each in self._others() if each is not self.inertia]
        beside = np.concatenate(fields, axis=-1)
        return items(self.pose, lead, 4, 4), items(beside, lead, 6 * len(fields))

    def take(self, index: Any) -> State:
        """The state at leading indices, as numpy would index an array of points."""
        return State(self.pose[index], *[f[index] for f in self._others()])

    def reshape(self, *shape: int) -> State:
        """The state with another leading shape; it shares memory as numpy's reshape does."""
        fields = (f.reshape(*shape, 6) for f in self._others())
        return State(self.pose.reshape(*shape, 4, 4), *fields)

    def with_fields_of(self, other: State) -> State:
        """State with the optional fields of `other`; zeros for those that this one lacks."""
        strain_rate, inertia = (
            None if theirs is None else np.zeros_like(self.strain) if own is None else own
            for own, theirs in (
                (self.strain_rate, other.strain_rate),
                (self.inertia, other.inertia),
            )
        )
        return State(self.pose, self.strain, self.velocity, strain_rate, inertia)

    def flatten(self) -> State:
        """The state as one list of points (M,), sharing memory."""
        return self.reshape(-1)


@dataclass(frozen=True)
class AcceleratedState(State):
    """State at points with acceleration (…, 6), [Rᵀ p̈, angular acceleration in the body frame].

    Steps have 24 numbers, of which those of the acceleration come last.
    """

    acceleration: Array = field(default_factory=lambda: np.zeros(6))

    def retract(self, step: Array) -> AcceleratedState:
        """State after a `step` (…, 24)."""
        at = State(self.pose, self.strain, self.velocity, self.acceleration).retract(step)
        pose, strain, velocity, acceleration = at.fields()  # treated as a strain rate
        return AcceleratedState(pose, strain, velocity, acceleration=acceleration)


def concatenate(*states: State) -> State:
    """Concatenate states along their first axis."""
    fields = zip(*[state.fields() for state in states], strict=True)
    return State(*[np.concatenate(field) for field in fields])


def rest_state(grid: Grid, base_pose: Array, rest_strain: Array) -> State:
    """State of the robot at rest: constant strain from the base, no velocity.

    `base_pose` (4, 4), `rest_strain` (6,). Estimates start from this state by default.
    """
    k, n = grid.shape
    pose = base_pose @ se3.exp(grid.arclength[:, None] * rest_strain)
    return State(
        np.broadcast_to(pose, (k, n, 4, 4)).copy(),
        np.broadcast_to(rest_strain, (k, n, 6)).copy(),
        np.zeros((k, n, 6)),
    )
