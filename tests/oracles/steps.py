"""One step between two nodes: the errors the prior penalises, and the point between them.

A step runs along arclength (the pose moves by its strain, the velocity rides rigidly) or along time
(the pose moves by its velocity, the strain stays). `Direction` says which components of a node
play which part, so both directions share every line.
"""

from __future__ import annotations

import numpy as np

from glissando.model.priors.steps import Direction
from glissando.model.state import DOF, POSE, STRAIN, State
from oracles import se3
from oracles.se3 import Array
from oracles.transitions import Bridge, full_bridge


def pair_error(
    direction: Direction, start: State, end: State, step: Array
) -> tuple[Array, Array, Array]:
    """Error (M, 12) of [pose, rate] over a step and its Jacobians (M, 12, 18) at both ends.

    e = [log(exp(h rate₀)⁻¹ T₀⁻¹ T₁); rate₁ − rate₀]. Source: equation (2').
    """
    rate0, rate1 = direction.rate_of(start), direction.rate_of(end)
    between = se3.inverse(start.pose) @ end.pose
    scaled = step[..., None] * rate0
    miss = se3.exp(-scaled) @ between
    xi = se3.log(miss)
    error = np.concatenate([xi, rate1 - rate0], axis=-1)
    j0 = np.zeros((*xi.shape[:-1], 12, DOF))
    j1 = np.zeros_like(j0)
    spread = se3.right_jacobian_inverse(xi)
    j0[..., :6, POSE] = -spread @ se3.adjoint(se3.inverse(between))
    j0[..., :6, direction.rate] = -step[..., None, None] * (
        spread @ se3.adjoint(se3.inverse(miss)) @ se3.right_jacobian(scaled)
    )
    j0[..., 6:, direction.rate] = -np.eye(6)
    j1[..., :6, POSE] = spread
    j1[..., 6:, direction.rate] = np.eye(6)
    return error, j0, j1


def carried_error(direction: Direction, start: State, end: State) -> tuple[Array, Array, Array]:
    """Error (M, 6) of the carried field over a step and its Jacobians (M, 6, 18) at both ends.

    Along arclength e = ϖ₁ − Ad(T₁⁻¹ T₀) ϖ₀ (equation 3'), along time e = ε₁ − ε₀ (equation 4).
    """
    field0, field1 = direction.carried_of(start), direction.carried_of(end)
    j0 = np.zeros((*field0.shape[:-1], 6, DOF))
    j1 = np.zeros_like(j0)
    j1[..., direction.carried] = np.eye(6)
    if not direction.rigid:
        j0[..., direction.carried] = -np.eye(6)
        return field1 - field0, j0, j1
    ride = se3.adjoint(se3.inverse(end.pose) @ start.pose)
    ridden = np.einsum("...ij,...j->...i", ride, field0)
    j0[..., POSE] = ride @ se3.ad(field0)
    j0[..., direction.carried] = -ride
    j1[..., POSE] = -se3.ad(ridden)
    return field1 - ridden, j0, j1


def built(direction: Direction, pose: Array, rate: Array, carried: Array) -> State:
    """A state from its pose, the field that moves it along a direction, and the other."""
    return State(pose, rate, carried) if direction.rate == STRAIN else State(pose, carried, rate)


def between(
    direction: Direction, start: State, end: State, step: Array, offset: Array, bridge: Bridge
) -> tuple[State, Array, Array, Array]:
    """State at `offset` into a step, its Jacobians (M, 18, 18) at both ends, and bridge covariance.

    T(u) = T₀ exp(u rate₀) exp(δ), with [δ; δ_rate] = gain e. The covariance (M, 18, 18) is what
    stays uncertain when both ends are known, in the body frame. Source: equations (2'), (10), (12).
    """
    pose, rate, j0, j1, turn = bent_pair(direction, start, end, step, offset, bridge.gain)
    error, e0, e1 = carried_error(direction, start, end)
    j0[..., direction.carried, :] = bridge.carried_gain @ e0
    j1[..., direction.carried, :] = bridge.carried_gain @ e1
    carried = np.einsum("...ij,...j->...i", bridge.carried_gain, error)
    cov = _bridge_covariance(direction, bridge, turn)
    field0 = direction.carried_of(start)
    if not direction.rigid:
        j0[..., direction.carried, direction.carried] += np.eye(6)
        return built(direction, pose, rate, field0 + carried), j0, j1, cov
    ride = se3.adjoint(se3.inverse(pose) @ start.pose)
    ridden = np.einsum("...ij,...j->...i", ride, field0)
    j0[..., direction.carried, POSE] -= ride @ se3.ad(field0)
    j0[..., direction.carried, direction.carried] += ride
    lean = np.zeros_like(cov)  # what rides turns with the pose at the point
    lean[...] = np.eye(DOF)
    lean[..., direction.carried, POSE] = se3.ad(ridden)
    cov = lean @ cov @ np.swapaxes(lean, -1, -2)
    return built(direction, pose, rate, ridden + carried), lean @ j0, lean @ j1, cov


def bridged(
    direction: Direction,
    start: State,
    end: State,
    step: Array,
    offset: Array,
    about: Array,
    densities: tuple[Array, Array, Array],
) -> tuple[State, Array, Array, Array]:
    """What `between` gives with the bridge about a rate (M, 6).

    `densities` are those of the moving field, of the carried, and of a jump at the end (M, 6).
    """
    found = full_bridge(about, step, offset, *densities, rigid=direction.rigid)
    return between(direction, start, end, step, offset, found)


def bent_pair(
    direction: Direction, start: State, end: State, step: Array, offset: Array, gain: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Pose and rate at `offset` into a step, Jacobians (M, 18, 18) with those rows, and J_r(δ).

    T(u) = T₀ exp(u rate₀) exp(δ), with [δ; δ_rate] = gain e, `gain` (M, 12, 12).
    """
    error, e0, e1 = pair_error(direction, start, end, step)
    rate0 = direction.rate_of(start)
    delta = np.einsum("...ij,...j->...i", gain, error)
    d0, d1 = gain @ e0, gain @ e1
    scaled = offset[..., None] * rate0
    ahead, bend = se3.exp(scaled), se3.exp(delta[..., :6])
    turn = se3.right_jacobian(delta[..., :6])
    unbend = se3.adjoint(se3.inverse(bend))
    j0 = np.zeros((*scaled.shape[:-1], DOF, DOF))
    j1 = np.zeros_like(j0)
    j0[..., POSE, :] = turn @ d0[..., :6, :]
    j0[..., POSE, POSE] += unbend @ se3.adjoint(se3.inverse(ahead))
    j0[..., POSE, direction.rate] += offset[..., None, None] * (unbend @ se3.right_jacobian(scaled))
    j1[..., POSE, :] = turn @ d1[..., :6, :]
    j0[..., direction.rate, :] = d0[..., 6:, :]
    j0[..., direction.rate, direction.rate] += np.eye(6)
    j1[..., direction.rate, :] = d1[..., 6:, :]
    return start.pose @ ahead @ bend, rate0 + delta[..., 6:], j0, j1, turn


def _bridge_covariance(direction: Direction, bridge: Bridge, turn: Array) -> Array:
    cov = np.zeros((*turn.shape[:-2], DOF, DOF))
    corner = turn @ bridge.cov[..., :6, 6:]
    cov[..., POSE, POSE] = turn @ bridge.cov[..., :6, :6] @ np.swapaxes(turn, -1, -2)
    cov[..., POSE, direction.rate] = corner
    cov[..., direction.rate, POSE] = np.swapaxes(corner, -1, -2)
    cov[..., direction.rate, direction.rate] = bridge.cov[..., 6:, 6:]
    cov[..., direction.carried, direction.carried] = bridge.carried_cov
    return cov
