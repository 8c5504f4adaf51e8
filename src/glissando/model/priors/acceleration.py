"""The acceleration at points between the nodes, with all else that is known there.

Where nodes know no acceleration it is the slope of the velocity that the prior leads from node to
node, and white noise about it: what that noise leaves of a mean over a span of time is its density
over the span. A prior whose nodes know acceleration says it itself. Source: equation (33).
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import Interpolation, sort_points
from glissando.model.priors.prior import Prior
from glissando.model.state import DOF, POSE, VELOCITY, AcceleratedState, State

_NEAR = 1e-3  # of a time step: how far apart velocities are differenced
_UNKNOWN = 1e12  # by which the density is multiplied where nothing comes after a node
_V, _W = slice(VELOCITY.start, VELOCITY.start + 3), slice(VELOCITY.start + 3, VELOCITY.stop)


@runtime_checkable
class AccelerationPrior(Protocol):
    """A prior whose nodes may know acceleration."""

    def acceleration(
        self, grid: Grid, state: State, at: Interpolation, arclength: Array, time: Array
    ) -> Interpolation | None:
        """What `accelerated` gives, from the state `at` the points; None if nodes know none."""


def accelerated(
    prior: Prior,
    grid: Grid,
    state: State,
    noise_state: State,
    arclength: Array,
    time: Array,
    span: float,
) -> Interpolation:
    """States with acceleration (M, 24) at points that all touch equally many nodes.

    Args:
        prior: What lies between the nodes.
        grid: The nodes.
        state: Nodes (K, N).
        noise_state: Nodes (K, N) whose rates noise comes from.
        arclength: Where the points are (M,), m.
        time: When (M,), s.
        span: Over which acceleration is averaged, s.
    """
    if isinstance(prior, AccelerationPrior):
        at = _interpolated(prior, grid, state, noise_state, arclength, time)
        modal = prior.acceleration(grid, state, at, arclength, time)
        if modal is not None:
            return modal
    if grid.time.size == 1:
        at = _interpolated(prior, grid, state, noise_state, arclength, time)
        return _joined(at, np.zeros((time.size, 6)), np.zeros_like(at.jacobian[:, :6]), None)
    k = np.clip(np.searchsorted(grid.time, time, side="right") - 1, 0, grid.time.size - 2)
    step = np.diff(grid.time)[k]
    edge = _NEAR * step
    inside = np.clip(time, grid.time[k] + 2.0 * edge, grid.time[k + 1] - 2.0 * edge)
    ends = inside - edge, inside + edge
    apart = ends[1] - ends[0]  # as times round
    early, at, late = (
        _interpolated(prior, grid, state, noise_state, arclength, when)
        for when in (ends[0], inside, ends[1])
    )
    rate = (late.state.velocity - early.state.velocity) / apart[:, None]
    slope = late.jacobian[:, VELOCITY] - early.jacobian[:, VELOCITY]
    slope = slope / apart[:, None, None, None]
    place = grid.arclength[grid.locate(arclength, time)[0].nearest]
    after = grid.time[k] + edge
    soon = _interpolated(prior, grid, state, noise_state, place, after).cov
    crossing = _interpolated(prior, grid, state, noise_state, arclength, grid.time[k]).cov
    share = 1.0 / ((after - grid.time[k]) * np.minimum(span, step)), 2.0 / step**2
    left, between = (
        part[:, None, None] * cov[:, VELOCITY, VELOCITY]
        for part, cov in zip(share, (soon, crossing), strict=True)
    )
    left = left + between
    left[time >= grid.time[-1]] *= _UNKNOWN  # until another node comes
    return _joined(at, *_of_body(at, rate, slope), left)


def _interpolated(
    prior: Prior, grid: Grid, state: State, noise_state: State, arclength: Array, time: Array
) -> Interpolation:
    (points,) = sort_points(grid, arclength, time)
    return prior.interpolate(grid, state, noise_state, points)


def _of_body(at: Interpolation, rate: Array, slope: Array) -> tuple[Array, Array]:
    """Acceleration [v̇ + ω × v, ω̇] and its slopes, from the rate of the body's velocity."""
    linear, spin = at.state.velocity[:, :3], at.state.velocity[:, 3:]
    slope[:, :3] += np.einsum("mij,mjcd->micd", se3.hat3(spin), at.jacobian[:, _V])
    slope[:, :3] -= np.einsum("mij,mjcd->micd", se3.hat3(linear), at.jacobian[:, _W])
    return np.concatenate([rate[:, :3] + np.cross(spin, linear), rate[:, 3:]], axis=1), slope


def _joined(
    at: Interpolation, acceleration: Array, slope: Array, left: Array | None
) -> Interpolation:
    """The points with their acceleration (M, 6), its slopes (M, 6, c, dof), what is left of it."""
    cov = np.zeros((len(slope), DOF + 6, DOF + 6))
    cov[:, :DOF, :DOF] = at.cov
    if left is not None:
        cov[:, DOF:, DOF:] = left
    state = at.state
    moving = AcceleratedState(state.pose, state.strain, state.velocity, acceleration=acceleration)
    return Interpolation(moving, at.nodes, np.concatenate([at.jacobian, slope], axis=1), cov)


def accelerated_in_world(
    at: Interpolation,
    nodes: Index,
    world: tuple[Array, Array, Array],
    slopes: tuple[Array, Array],
) -> Interpolation:
    """The points with an acceleration that is known in the world, from all of some `nodes`.

    Args:
        at: The points (M,); nodes that it touches are among `nodes`.
        nodes: Nodes (M, c).
        world: Acceleration p̈ (M, 3), its slope by arclength (M, 3), and variance (M, 3, 3).
        slopes: Slopes (M, 3, c, dof) of the first two by the nodes.
    """
    rotation = at.state.pose[:, :3, :3]
    back, tangent = np.swapaxes(rotation, -1, -2), np.array([0.0, 0.0, 1.0])
    jacobian = np.zeros((*at.jacobian.shape[:2], nodes.shape[1], at.dof))
    rows = np.arange(len(nodes))
    for c in range(at.nodes.shape[1]):
        where = np.argmax(nodes == at.nodes[:, c, None], axis=1)
        jacobian[rows, :, where] = at.jacobian[:, :, c]
    turn = jacobian[:, POSE.start + 3 : POSE.stop]
    parts, moved = [], []
    for vector, slope, after in (
        (world[0], slopes[0], np.eye(3)),
        (world[1], slopes[1], se3.hat3(tangent)),
    ):
        own = np.einsum("mij,mj->mi", back, vector)
        change = np.einsum("mij,mjcd->micd", back, slope)
        change += np.einsum("mij,mjcd->micd", se3.hat3(own), turn)
        parts.append(own @ after.T)
        moved.append(np.einsum("ij,mjcd->micd", after, change))
    cov = np.zeros((len(nodes), 6, 6))
    cov[:, :3, :3] = back @ world[2] @ rotation
    full = Interpolation(at.state, nodes, jacobian, at.cov)
    return _joined(full, np.concatenate(parts, axis=1), np.concatenate(moved, axis=1), cov)
