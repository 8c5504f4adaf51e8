"""Acceleration at points between the nodes, together with the state there.

Where nodes have no acceleration it is the time derivative of the interpolated velocity, plus white
noise, whose mean over a span of time has the covariance density / span. A prior whose nodes have
acceleration computes it itself. Source: equation (33).
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

_NEAR = 1e-3  # of a time step: half the width of difference quotients of velocity
_UNKNOWN = 1e12  # factor on the density where no time node follows
_V, _W = slice(VELOCITY.start, VELOCITY.start + 3), slice(VELOCITY.start + 3, VELOCITY.stop)


@runtime_checkable
class AccelerationPrior(Protocol):
    """A prior whose nodes may have an acceleration."""

    def acceleration(
        self, grid: Grid, state: State, at: Interpolation, arclength: Array, time: Array
    ) -> Interpolation | None:
        """Result of `accelerated`, from the state `at` the points; None if nodes have none."""


def accelerated(
    prior: Prior,
    grid: Grid,
    state: State,
    noise_state: State,
    arclength: Array,
    time: Array,
    span: float,
) -> Interpolation:
    """States with acceleration (M, 24) at points that all depend on equally many nodes.

    Args:
        prior: Prior that interpolates between the nodes.
        grid: Grid of the nodes.
        state: States (K, N) of the nodes.
        noise_state: States (K, N) at whose rates the noise is evaluated.
        arclength: Arclengths (M,) of the points, m.
        time: Times (M,) of the points, s.
        span: Time over which acceleration is averaged, s.
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
    width = ends[1] - ends[0]  # as rounded
    early, at, late = (
        _interpolated(prior, grid, state, noise_state, arclength, when)
        for when in (ends[0], inside, ends[1])
    )
    rate = (late.state.velocity - early.state.velocity) / width[:, None]
    slope = late.jacobian[:, VELOCITY] - early.jacobian[:, VELOCITY]
    slope = slope / width[:, None, None, None]
    place = grid.arclength[grid.locate(arclength, time)[0].nearest]
    after = grid.time[k] + edge
    after_node = _interpolated(prior, grid, state, noise_state, place, after).cov
    on_node = _interpolated(prior, grid, state, noise_state, arclength, grid.time[k]).cov
    share = 1.0 / ((after - grid.time[k]) * np.minimum(span, step)), 2.0 / step**2
    cov_white, cov_bridge = (
        part[:, None, None] * cov[:, VELOCITY, VELOCITY]
        for part, cov in zip(share, (after_node, on_node), strict=True)
    )
    cov_white = cov_white + cov_bridge
    cov_white[time >= grid.time[-1]] *= _UNKNOWN  # until another node follows
    return _joined(at, *_body_acceleration(at, rate, slope), cov_white)


def _interpolated(
    prior: Prior, grid: Grid, state: State, noise_state: State, arclength: Array, time: Array
) -> Interpolation:
    (points,) = sort_points(grid, arclength, time)
    return prior.interpolate(grid, state, noise_state, points)


def _body_acceleration(at: Interpolation, rate: Array, slope: Array) -> tuple[Array, Array]:
    """Acceleration [v̇ + ω × v, ω̇] and its Jacobian, from the derivative of the velocity."""
    linear, spin = at.state.velocity[:, :3], at.state.velocity[:, 3:]
    slope[:, :3] += np.einsum("mij,mjcd->micd", se3.hat3(spin), at.jacobian[:, _V])
    slope[:, :3] -= np.einsum("mij,mjcd->micd", se3.hat3(linear), at.jacobian[:, _W])
    return np.concatenate([rate[:, :3] + np.cross(spin, linear), rate[:, 3:]], axis=1), slope


def _joined(
    at: Interpolation, acceleration: Array, slope: Array, noise: Array | None
) -> Interpolation:
    """Add acceleration (M, 6), its Jacobian (M, 6, c, dof) and covariance `noise` to points."""
    cov = np.zeros((len(slope), DOF + 6, DOF + 6))
    cov[:, :DOF, :DOF] = at.cov
    if noise is not None:
        cov[:, DOF:, DOF:] = noise
    state = at.state
    moving = AcceleratedState(state.pose, state.strain, state.velocity, acceleration=acceleration)
    return Interpolation(moving, at.nodes, np.concatenate([at.jacobian, slope], axis=1), cov)


def accelerated_in_world(
    at: Interpolation,
    nodes: Index,
    world: tuple[Array, Array, Array],
    slopes: tuple[Array, Array],
) -> Interpolation:
    """Add an acceleration in the world frame, which depends on all `nodes`, to points.

    Args:
        at: Interpolation at the points (M,), whose nodes are among `nodes`.
        nodes: Indices (M, c) of nodes.
        world: Acceleration p̈ (M, 3), its derivative by arclength (M, 3), covariance (M, 3, 3).
        slopes: Jacobians (M, 3, c, dof) of the first two by the nodes.
    """
    rotation = at.state.pose[:, :3, :3]
    to_body, tangent = np.swapaxes(rotation, -1, -2), np.array([0.0, 0.0, 1.0])
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
        own = np.einsum("mij,mj->mi", to_body, vector)
        change = np.einsum("mij,mjcd->micd", to_body, slope)
        change += np.einsum("mij,mjcd->micd", se3.hat3(own), turn)
        parts.append(own @ after.T)
        moved.append(np.einsum("ij,mjcd->micd", after, change))
    cov = np.zeros((len(nodes), 6, 6))
    cov[:, :3, :3] = to_body @ world[2] @ rotation
    full = Interpolation(at.state, nodes, jacobian, at.cov)
    return _joined(full, np.concatenate(parts, axis=1), np.concatenate(moved, axis=1), cov)
