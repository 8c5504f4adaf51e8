"""Whitening, factors of the white-noise prior, readings and their sums, in numpy.

Each function is the plain definition of a kernel, on any leading shape.
"""

from __future__ import annotations

import numpy as np

from glissando.model.grid import Index
from glissando.model.priors.prior import interval_strain
from glissando.model.priors.steps import ARCLENGTH, Direction
from glissando.model.state import DOF, POSE, STRAIN, State
from oracles import se3
from oracles.se3 import Array
from oracles.steps import carried_error, pair_error
from oracles.transitions import process_covariances


def sqrt_information(cov: Array) -> Array:
    """W (…, r, r) with Wᵀ W = cov⁻¹, so that W @ residual is white."""
    whitener: Array = np.linalg.inv(np.linalg.cholesky(cov))
    return whitener


def pair_sqrt_information(cov: Array) -> Array:
    """W (…, 12, 12) with Wᵀ W = cov⁻¹ for a covariance whose last 6×6 block is diagonal.

    Eliminating the diagonal half first leaves a 6×6 Cholesky factor, a quarter of the work.
    """
    spread = 1.0 / np.einsum("...ii->...i", cov[..., 6:, 6:])
    slope = cov[..., :6, 6:] * spread[..., None, :]
    corner = sqrt_information(cov[..., :6, :6] - slope @ cov[..., 6:, :6])
    out = np.zeros_like(cov)
    out[..., :6, :6] = corner
    out[..., :6, 6:] = -corner @ slope
    np.einsum("...ii->...i", out[..., 6:, 6:])[...] = np.sqrt(spread)
    return out


def weighted_steps(
    direction: Direction,
    flat: State,
    about: State,
    nodes: Index,
    step: Array,
    weight: Array,
    densities: tuple[Array, Array, Array],
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    """Errors of steps between `nodes` (M, 2) of a list of states, of the pair and of the carried.

    Each with Jacobian (M, r, 2, 18) and whitener (M, r, r), times `weight` (M,), which come from
    the rates of `about` and the `densities` of the moving field, the carried and a jump (M, 6).
    """
    start, end = flat.take(nodes[:, 0]), flat.take(nodes[:, 1])
    rates, (psd, carried_psd, jump) = direction.rate_of(about), densities
    middle = interval_strain(rates[nodes[:, 0]], rates[nodes[:, 1]], step, (psd, jump))
    cov, carried_cov = process_covariances(
        middle, step, psd, carried_psd, rigid=direction.rigid, jump=jump
    )
    pair, carried = pair_error(direction, start, end, step), carried_error(direction, start, end)
    whiteners = pair_sqrt_information(cov), sqrt_information(carried_cov)
    alike = np.all([d[:, ::3] == d[:, 1::3] for d in densities], axis=(0, 2))
    angle = np.where(alike, rolls_between(about.pose, flat.pose)[nodes[:, 0]], 0.0)
    first, second = (
        (*turned_back(error, np.stack(jacobians, axis=2), alike, angle), white)
        for (error, *jacobians), whitener in zip((pair, carried), whiteners, strict=True)
        for white in [weight[:, None, None] * whitener]
    )
    return first, second


def rolls_between(before: Array, after: Array) -> Array:
    """Angles (M,) about z by which poses turned, besides a turn about an axis across it."""
    apart = se3.inverse(before) @ after
    return np.arctan2(apart[:, 1, 0] - apart[:, 0, 1], apart[:, 0, 0] + apart[:, 1, 1])


def turned_back(error: Array, jacobian: Array, alike: Array, angle: Array) -> tuple[Array, Array]:
    """Errors (M, r) turned about z by angles (M,), slopes (M, r, c, dof) of such errors."""
    across = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    thirds = np.eye(error.shape[1] // 3)
    turn = np.kron(thirds, across)
    out = jacobian.copy()
    out[..., 0, 5] += alike[:, None] * (error @ turn.T)
    roll = np.zeros((len(angle), 6))
    roll[:, 5] = angle
    whole = np.kron(thirds, se3.exp(roll)[:, :3, :3])
    return (whole @ error[..., None])[..., 0], np.einsum("mij,mjcd->micd", whole, out)


def static_steps(
    flat: State, nodes: Index, step: Array, psd: Array, jump: Array
) -> tuple[Array, Array, Array]:
    """Errors (M, 12) of steps between `nodes` (M, 2) of a list of states that hold still.

    With Jacobian (M, 12, 2, 12) and whitener (M, 12, 12). Source: equation (2').
    """
    start, end = flat.take(nodes[:, 0]), flat.take(nodes[:, 1])
    error, j0, j1 = pair_error(ARCLENGTH, start, end, step)
    rate = interval_strain(start.strain, end.strain, step, (psd, jump))
    cov, _ = process_covariances(rate, step, psd, psd, rigid=False, jump=jump)
    jacobian = np.stack([j0[..., slice(0, 12)], j1[..., slice(0, 12)]], axis=2)
    return error, jacobian, pair_sqrt_information(cov)


def rolled_to(values: Array, pose: Array, mount: Array) -> Array:
    """The mount (M, 4, 4) of a coil turned about its z until its roll is the measured one.

    The turn about z is all of q_z against q_w of the quaternion, here from the matrix.
    """
    apart = se3.inverse(values) @ (pose @ mount)
    turn = np.zeros((*apart.shape[:-2], 6))
    turn[..., 5] = -np.arctan2(
        apart[..., 1, 0] - apart[..., 0, 1], apart[..., 0, 0] + apart[..., 1, 1]
    )
    turned: Array = mount @ se3.exp(turn)
    return turned


def pose_error(values: Array, pose: Array, mount: Array) -> Array:
    """log(T_meas⁻¹ T T_bc) (M, 6)."""
    return se3.log(se3.inverse(values) @ (pose @ mount))


def pose_error_jacobian(miss: Array, mount: Array, *, rolls: bool = False) -> Array:
    """Slope of `pose_error` by the pose, (M, 6, 6); if it `rolls`, (M, 5, 6) less what follows."""
    spread = se3.right_jacobian_inverse(miss)
    full = spread @ se3.adjoint(se3.inverse(mount))
    if not rolls:
        return full
    follow = spread[..., :5, 5, None] / spread[..., 5, 5, None, None]
    return full[..., :5, :] - follow * full[..., 5:, :]


def sense(kind: str, values: Array, mount: Array, at: State) -> tuple[Array, Array]:
    """Residuals (M, r) of readings and their slopes (M, r, 18) by the states `at` (M,)."""
    m, back = len(values), se3.adjoint(se3.inverse(mount))
    there, turned = at.pose @ mount, np.swapaxes(mount[:3, :3], -1, -2)
    if kind in ("pose", "coil"):
        rolls = kind == "coil"
        mount = rolled_to(values, at.pose, mount) if rolls else mount
        residual = pose_error(values, at.pose, mount)
        block, where = pose_error_jacobian(residual, mount, rolls=rolls), POSE
        residual = residual[:, : block.shape[1]]
    elif kind == "position":
        residual = there[:, :3, 3] - values
        block, where = there[:, :3, :3] @ back[:3], POSE
    elif kind == "orientation":
        apart = np.tile(np.eye(4), (m, 1, 1))
        apart[:, :3, :3] = np.swapaxes(values, -1, -2) @ there[:, :3, :3]
        turn = se3.log(apart)
        residual = turn[:, 3:]
        block, where = se3.right_jacobian_inverse(turn)[:, 3:, 3:] @ back[3:], POSE
    elif kind == "gyro":
        residual = at.velocity[:, 3:] @ mount[:3, :3] - values
        block, where = np.broadcast_to(turned, (m, 3, 3)), slice(15, 18)
    else:
        residual = at.strain - values
        block, where = np.broadcast_to(np.eye(6), (m, 6, 6)), STRAIN
    slope = np.zeros((*residual.shape, DOF))
    slope[..., where] = block
    return residual, slope


def at_nodes(by_state: Array, jacobian: Array, left: Array, cov: Array) -> tuple[Array, Array]:
    """Slopes (M, r, c, d) of residuals by nodes, and what whitens them (M, r, r).

    `by_state` (M, r, 18) is their slope by the state between the nodes, which has slopes `jacobian`
    (M, 18, c, d) and what nodes `left` uncertain (M, 18, 18), added to `cov`, (r, r) or (M, r, r).
    """
    (m, dof, c, d), r = jacobian.shape, by_state.shape[1]
    whitener = sqrt_information(cov + by_state @ left @ np.swapaxes(by_state, -1, -2))
    return (by_state @ jacobian.reshape(m, dof, c * d)).reshape(m, r, c, d), whitener


def squared_innovations(
    residual: Array, jacobian: Array, cov: Array, step: Array, weight: Array
) -> Array:
    """Squared innovations (M,) of white factors, each against the solution without it.

    The solution `step` has covariance `cov` and contains each factor with a weight (M,), a white
    residual (M, r) and slopes (M, r, …).
    """
    out = []
    for e, slope, w in zip(residual, jacobian, weight, strict=True):
        information = np.linalg.inv(cov)
        without = np.linalg.inv(information - w * slope.T @ slope)
        innovation = e + slope @ without @ (information @ step + w * slope.T @ e)
        spread = np.eye(len(e)) + slope @ without @ slope.T
        out.append(innovation @ np.linalg.solve(spread, innovation))
    return np.array(out)
