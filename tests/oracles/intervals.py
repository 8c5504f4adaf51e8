"""An arclength interval and how it changes: its error, its point in between, and their rates.

The error of an interval is that of equation (2'), r = [log(exp(h ε₀)⁻¹ T₀⁻¹ T₁); ε₁ − ε₀]; its rate
ṙ follows from velocities and strain rates by differentiating in time (equation 9). Both kinds of
node, (M, 24) each, are [pose, strain, velocity, strain rate], and so are the columns of Jacobians.
"""

from __future__ import annotations

import numpy as np

from glissando.model.priors.intervals import strain_rate_of
from glissando.model.state import POSE, STRAIN, STRAIN_RATE, VELOCITY, State
from oracles import se3
from oracles.se3 import Array

RATED = 24
"""Degrees of freedom of a node that knows its strain rate."""

_LINEAR, _ANGULAR, _LINEAR_RATE, _ANGULAR_RATE = (slice(i, i + 6) for i in range(0, RATED, 6))


def _apply(matrix: Array, vector: Array) -> Array:
    return np.einsum("...ij,...j->...i", matrix, vector)


def interval_error(start: State, end: State, step: Array) -> tuple[Array, Array, Array]:
    """Error [r; ṙ] (M, 24) of intervals of length `step` (M,), Jacobians (M, 24, 24) at both ends.

    Source: equations (2') and (9).
    """
    rate0, rate1 = strain_rate_of(start), strain_rate_of(end)
    h = step[..., None, None]
    ahead = se3.inverse(start.pose) @ end.pose
    scaled = step[..., None] * start.strain
    miss = se3.exp(-scaled) @ ahead
    xi = se3.log(miss)
    spread = se3.right_jacobian_inverse(xi)
    stretch = h * se3.right_jacobian(scaled)
    back, unmiss = se3.adjoint(se3.inverse(ahead)), se3.adjoint(se3.inverse(miss))
    carried = _apply(back, start.velocity)
    drawn = _apply(unmiss, _apply(stretch, rate0))
    omega = end.velocity - carried - drawn
    xi_rate = _apply(spread, omega)
    error = np.concatenate([xi, end.strain - start.strain, xi_rate, rate1 - rate0], axis=-1)

    j0, j1 = (np.zeros((*step.shape, RATED, RATED)) for _ in range(2))
    pull = unmiss @ stretch
    j0[..., :6, POSE], j0[..., :6, STRAIN], j1[..., :6, POSE] = (
        -spread @ back,
        -spread @ pull,
        spread,
    )
    bend = -spread @ se3.right_jacobian_slope(xi, xi_rate) @ spread  # of J_r⁻¹(ξ) ω, by the miss
    by_miss = bend - spread @ se3.ad(drawn)
    by_ahead = by_miss - spread @ se3.ad(carried)
    twist = h**2 * se3.right_jacobian_slope(scaled, rate0)
    j0[..., 12:18, POSE], j1[..., 12:18, POSE] = -by_ahead @ back, by_ahead
    j0[..., 12:18, STRAIN] = -by_miss @ pull - spread @ unmiss @ twist
    j0[..., 12:18, VELOCITY], j1[..., 12:18, VELOCITY] = -spread @ back, spread
    j0[..., 12:18, STRAIN_RATE] = -spread @ pull
    for rows, columns in ((slice(6, 12), STRAIN), (slice(18, 24), STRAIN_RATE)):
        j0[..., rows, columns], j1[..., rows, columns] = -np.eye(6), np.eye(6)
    return error, j0, j1


def interval_between(
    start: State, end: State, step: Array, offset: Array, gain: Array, rest: tuple[Array, Array]
) -> tuple[State, Array, Array]:
    """State at `offset` into intervals and its Jacobians (M, 24, 24) at both ends.

    T(u) = T₀ exp(u ε₀) exp(δ) with [δ; δε] = r̄(u) + gain (r − r̄), `gain` (M, 12, 12) and `rest`,
    the errors r̄ and r̄(u) (M, 12) at rest, constant; velocity and strain rate are its derivatives
    in time. Source: equations (2') and (10).
    """
    rate0 = strain_rate_of(start)
    error, e0, e1 = interval_error(start, end, step)
    shape = error.shape[:-1]
    still, moving = _apply(gain, error[..., :12] - rest[0]) + rest[1], _apply(gain, error[..., 12:])
    delta, delta_rate = still[..., :6], moving[..., :6]
    d0, d1 = (
        (gain[..., None, :, :] @ e.reshape(*shape, 2, 12, RATED)).reshape(e.shape) for e in (e0, e1)
    )
    u = offset[..., None, None]
    scaled = offset[..., None] * start.strain
    ahead, bend = se3.exp(scaled), se3.exp(delta)
    stretch, turn = u * se3.right_jacobian(scaled), se3.right_jacobian(delta)
    back, unbend = se3.adjoint(se3.inverse(ahead)), se3.adjoint(se3.inverse(bend))
    carried = _apply(back, start.velocity)
    before = carried + _apply(stretch, rate0)
    after = _apply(unbend, before)
    at = State(
        start.pose @ ahead @ bend,
        start.strain + still[..., 6:],
        after + _apply(turn, delta_rate),
        rate0 + moving[..., 6:],
    )

    curl = se3.ad(after) @ turn + se3.right_jacobian_slope(delta, delta_rate)
    jacobians = []
    for d in (d0, d1):
        j = np.empty((*shape, RATED, RATED))
        j[..., POSE, :] = turn @ d[..., _LINEAR, :]
        j[..., STRAIN, :] = d[..., _ANGULAR, :]
        j[..., VELOCITY, :] = curl @ d[..., _LINEAR, :] + turn @ d[..., _LINEAR_RATE, :]
        j[..., STRAIN_RATE, :] = d[..., _ANGULAR_RATE, :]
        jacobians.append(j)
    j0 = jacobians[0]
    twist = u**2 * se3.right_jacobian_slope(scaled, rate0)
    j0[..., POSE, POSE] += unbend @ back
    j0[..., POSE, STRAIN] += unbend @ stretch
    j0[..., VELOCITY, STRAIN] += unbend @ (se3.ad(carried) @ stretch + twist)
    j0[..., VELOCITY, VELOCITY] += unbend @ back
    j0[..., VELOCITY, STRAIN_RATE] += unbend @ stretch
    j0[..., STRAIN, STRAIN] += np.eye(6)
    j0[..., STRAIN_RATE, STRAIN_RATE] += np.eye(6)
    return at, j0, jacobians[1]
