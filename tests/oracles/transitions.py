"""Exact transitions of a pose pair along one direction: means, noise and bridges.

Along arclength a pose T moves by its strain, along time by its velocity; call either `rate`, and
let white noise drive it. About a constant rate the error δ of the pose and δr of the rate obey

    δ' = −ad(rate) δ + δr,   δr' = w,        so   Φ(h) = [Ad(exp(−h rate)), h J_r(h rate); 0, I].

The third field of a node is carried along: the velocity rides rigidly along arclength, the strain
stays as it is along time. Everything here is a batch over intervals with a leading axis M.
Source: equations (2'), (3') and (12).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import adjoint
from glissando.model.priors.transitions import symmetrize
from oracles import se3
from oracles.se3 import Array

NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)
NODES, WEIGHTS = 0.5 * (NODES + 1.0), 0.5 * WEIGHTS


def _moments(rate: Array, step: Array, rigid: bool) -> tuple[Array, Array, Array, Array]:
    """Integrals over u in [0, step] of what u J_r(u rate) and Ad(exp(−u rate)) are made of.

    Both are polynomials Σ f_i(u) ad(rate)^i, i ≤ 4, whose coefficients depend on the angle alone,
    so integrating them needs quadrature of scalars only. Returns ∫ a_i (M, 5), ∫ a_i a_k (M, 5, 5)
    for the first, ∫ b_i b_k (M, 5, 5) for the second, which is left zero unless `rigid`, and the
    powers of ad (M, 5, 6, 6).
    """
    q = np.sum(rate[..., 3:] ** 2, axis=-1)[..., None]
    u = step[..., None] * NODES
    weight = (step[..., None] * WEIGHTS)[..., None]
    lever = se3.right_jacobian_coefficients(q * u**2) * u[..., None] ** np.arange(1, 6)
    first = np.sum(weight * lever, axis=-2)
    second = np.swapaxes(weight * lever, -1, -2) @ lever
    ridden = np.zeros_like(second)
    if rigid:
        ride = np.zeros_like(lever)  # exp(−u ad) = 1 − ad · (u J_r), reduced by (ad² + q)² ad = 0
        ride[..., 0] = 1.0
        ride[..., 1:] = -lever[..., :4]
        ride[..., 1] += q**2 * lever[..., 4]
        ride[..., 3] += 2.0 * q * lever[..., 4]
        ridden = np.swapaxes(weight * ride, -1, -2) @ ride
    return first, second, ridden, se3.ad_powers(rate)


def _sandwich(moments: Array, powers: Array, psd: Array) -> Array:
    """Σ_ik moments_ik ad^i diag(psd) (ad^k)ᵀ (M, 6, 6)."""
    shape = powers.shape[:-3]
    left = (moments @ powers.reshape(*shape, 5, 36)).reshape(powers.shape) * psd[..., None, None, :]
    left, right = (np.swapaxes(m, -3, -2).reshape(*shape, 6, 30) for m in (left, powers))
    return left @ np.swapaxes(right, -1, -2)


def transition(rate: Array, step: Array) -> Array:
    """Φ(step) of the pair [pose error, rate error] about a constant rate.

    Args:
        rate: Strain or velocity (…, 6).
        step: Length (…) of the step, metres or seconds.

    Returns:
        Transition matrices (…, 12, 12).
    """
    phi = np.zeros((*rate.shape[:-1], 12, 12))
    scaled = step[..., None] * rate
    phi[..., :6, :6] = adjoint(se3.exp(-scaled))
    phi[..., :6, 6:] = step[..., None, None] * se3.right_jacobian(scaled)
    phi[..., 6:, 6:] = np.eye(6)
    return phi


def process_covariances(
    rate: Array,
    step: Array,
    psd: Array,
    carried_psd: Array,
    *,
    rigid: bool,
    jump: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Noise of an interval on [pose error, rate error] (M, 12, 12) and on the carried field.

    `rate` (M, 6), `step` (M,), densities (6,) or (M, 6). The first is ∫ Φ(u) diag(0, psd) Φ(u)ᵀ du
    (equation 2'), plus the variance of a `jump` (M, 6) of the rate at the end. The second (M, 6, 6)
    is ∫ Ad(exp(−u rate)) diag(carried_psd) Ad(…)ᵀ du when the field rides with the body (`rigid`),
    else step · diag(carried_psd). Quadrature errs by about 1e-10 of it for a step that turns the
    body by one radian.
    """
    first, second, ridden, powers = _moments(rate, step, rigid)
    q = np.zeros((*rate.shape[:-1], 12, 12))
    q[..., :6, :6] = _sandwich(second, powers, psd)
    mean = (first[..., None, :] @ powers.reshape(*powers.shape[:-2], 36)).reshape(*rate.shape, 6)
    q[..., :6, 6:] = mean * psd[..., None, :]
    q[..., 6:, :6] = np.swapaxes(q[..., :6, 6:], -1, -2)
    q[..., 6:, 6:] = (step[..., None] * psd + jump)[..., None] * np.eye(6)
    if rigid:
        return q, _sandwich(ridden, powers, carried_psd)
    return q, (step[..., None] * carried_psd)[..., None] * np.eye(6)


@dataclass(frozen=True)
class Bridge:
    """What an interval knows at a point inside it, given both its ends.

    `gain` (M, 12, 12) and `carried_gain` (M, 6, 6) spread the interval's error to the point;
    `cov` (M, 12, 12) and `carried_cov` (M, 6, 6) are what stays uncertain there.
    """

    gain: Array
    cov: Array
    carried_gain: Array
    carried_cov: Array


def full_bridge(
    rate: Array,
    step: Array,
    offset: Array,
    psd: Array,
    carried_psd: Array,
    jump: Array | float = 0.0,
    *,
    rigid: bool,
) -> Bridge:
    """Bridge at `offset` (M,) into intervals of length `step` (M,) about `rate` (M, 6).

    `jump` (M, 6) is the variance of a jump of the rate at the interval's end.

    gain = Q(u) Φ(h−u)ᵀ Q(h)⁻¹ and cov = Q(u) − gain Φ(h−u) Q(u), which equals equation (12).
    Gains do not depend on the scale of the densities, covariances are proportional to it.
    """
    phi = transition(rate, step - offset)
    near, near_carried = process_covariances(rate, offset, psd, carried_psd, rigid=rigid)
    whole, whole_carried = process_covariances(rate, step, psd, carried_psd, rigid=rigid, jump=jump)
    ride = phi[..., :6, :6] if rigid else np.broadcast_to(np.eye(6), near_carried.shape)
    return Bridge(*_condition(near, phi, whole), *_condition(near_carried, ride, whole_carried))


def _condition(near: Array, onward: Array, whole: Array) -> tuple[Array, Array]:
    cross = onward @ near
    gain = np.swapaxes(np.linalg.solve(whole, cross), -1, -2)
    return gain, symmetrize(near - gain @ cross)


def bridge(rate, step, offset, psd, jump=0.0):
    """Gain and covariance of the pair where nothing is carried rigidly."""
    found = full_bridge(rate, step, offset, psd, psd, jump, rigid=False)
    return found.gain, found.cov
