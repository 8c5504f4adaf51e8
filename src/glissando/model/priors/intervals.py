"""Errors of arclength intervals, states inside them, and their rates in time.

The error of an interval is that of equation (2'), r = [log(exp(h ε₀)⁻¹ T₀⁻¹ T₁); ε₁ − ε₀]; its rate
ṙ follows from velocities and strain rates by differentiating in time (equation 9). Nodes, and
columns of Jacobians, have 24 components: [pose, strain, velocity, strain rate].
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando._kernels import intervals as kernels
from glissando._kernels.arrays import items, unflatten
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.state import State

RATED = 24
"""Degrees of freedom of a node with a strain rate."""


def strain_rate_of(state: State) -> Array:
    """Strain rate (…, 6) of a state, which must have one."""
    assert state.strain_rate is not None
    return state.strain_rate


def place_error(pose: Array, strain: Array, at: State) -> tuple[Array, Array]:
    """Error [r; ṙ] (…, 24) of a cross-section from an expected one, Jacobian (…, 24, 24).

    r = [log(T̄⁻¹ T); ε − ε̄] for an expected `pose` (4, 4) and `strain` (6,) that are constant: the
    error of an interval of zero length.
    """
    expected, still = np.broadcast_to(pose, at.pose.shape), np.zeros(at.strain.shape)
    start = State(expected, still + strain, still, still)
    error, _, jacobian = interval_error(start, at, still[..., 0])
    return error, jacobian


def interval_error(start: State, end: State, step: Array) -> tuple[Array, Array, Array]:
    """Error [r; ṙ] of intervals. Source: equations (2') and (9).

    Args:
        start: State (…) with strain rate where the intervals begin.
        end: State (…) where they end.
        step: Lengths (…), metres.

    Returns:
        Errors (…, 24) and Jacobians (…, 24, 24) by both ends.
    """
    lead = start.pose.shape[:-2]
    (pose0, fields0), (pose1, fields1) = (as_fields(at, lead) for at in (start, end))
    error, j0, j1 = unflatten(
        lead, *kernels.interval_error(pose0, pose1, fields0, fields1, items(step, lead))
    )
    return error, j0, j1


def interval_between(
    start: State, end: State, step: Array, offset: Array, gain: Array, rest: tuple[Array, Array]
) -> tuple[State, Array, Array]:
    """State inside intervals. Source: equations (2') and (10).

    T(u) = T₀ exp(u ε₀) exp(δ) with [δ; δε] = r̄(u) + gain (r − r̄); velocity and strain rate are its
    derivatives in time.

    Args:
        start: State (…) with strain rate where the intervals begin.
        end: State (…) where they end.
        step: Lengths (…), metres.
        offset: Distances (…) of the points from the beginnings of the intervals, metres.
        gain: Gains (…, 12, 12) from the error of the interval to that of the point.
        rest: Constant errors (…, 12) of the robot at rest, r̄ of intervals and r̄(u) of points.

    Returns:
        State (…) with strain rate, Jacobians (…, 24, 24) by both ends.
    """
    lead = start.pose.shape[:-2]
    (pose0, fields0), (pose1, fields1) = (as_fields(at, lead) for at in (start, end))
    places, gains = (items(each, lead) for each in (step, offset)), items(gain, lead, 12, 12)
    errors = (items(each, lead, 12) for each in rest)
    pose, fields, j0, j1 = unflatten(
        lead,
        *kernels.interval_between(pose0, pose1, fields0, fields1, *places, gains, *errors),
    )
    return State(pose, fields[..., :6], fields[..., 6:12], fields[..., 12:]), j0, j1


def as_fields(at: State, lead: tuple[int, ...]) -> tuple[Array, Array]:
    """Poses (M, 4, 4) of nodes, and concatenated strain, velocity, strain rate (M, 18)."""
    return items(at.pose, lead, 4, 4), items(np.concatenate(at.fields()[1:], -1), lead, 18)


def interval_end(start: State, error: Array, step: Array) -> State:
    """State (M,) at the end of intervals with an error [r; ṙ] (M, 24): inverts `interval_error`."""
    rate0 = strain_rate_of(start)
    scaled = step[..., None] * start.strain
    xi, xi_rate = error[..., :6], error[..., 12:18]
    miss = se3.exp(xi)
    ahead = se3.exp(scaled) @ miss
    drawn = se3.rotate(se3.right_jacobian(scaled), step[..., None] * rate0)
    velocity = (
        se3.rotate(se3.right_jacobian(xi), xi_rate)
        + se3.rotate(se3.adjoint(se3.inverse(ahead)), start.velocity)
        + se3.rotate(se3.adjoint(se3.inverse(miss)), drawn)
    )
    strain, rate = start.strain + error[..., 6:12], rate0 + error[..., 18:]
    return State(start.pose @ ahead, strain, velocity, rate)


def kron_pair(small: Array, large: Array) -> Array:
    """Kronecker products (…, 2 r, 2 r) of (…, 2, 2) and (…, r, r)."""
    product = small[..., :, None, :, None] * large[..., None, :, None, :]
    return product.reshape(*product.shape[:-4], *(2 * large.shape[-1],) * 2)


def at_nodes(state: State, k: Index, n: Index) -> tuple[State, Index, Array]:
    """State, indices (M, 1) and Jacobian (M, 24, 1, dof) of nodes at times k, arclengths n."""
    nodes = (k * state.strain.shape[1] + n)[:, None]
    eye = np.eye(RATED, state.dof)[:, None, :]
    at = replace(state.flatten().take(nodes[:, 0]), inertia=None)
    return at, nodes, np.broadcast_to(eye, (k.size, *eye.shape))
