"""Batched SE(3): exponential, logarithm, adjoints and right Jacobians.

**A pose is an array T_wb (…, 4, 4) that takes body coordinates to world; it is perturbed on the
right, T ⊕ x = T exp(x^), and six-vectors are [linear, angular] = [rho, phi].** Metres, radians.
Every function takes any leading shape. All scalar coefficients are power series in the squared
angle near zero and closed forms away from it, so values and derivatives are accurate everywhere;
the logarithm goes through the quaternion and is accurate up to and at π.

Sources: Barfoot, *State Estimation for Robotics* (2nd ed.), chapter 8; the Jacobian polynomials
follow from the minimal polynomial (ad² + θ²)² ad = 0.
"""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import ad as ad
from glissando.geometry.se3 import adjoint as adjoint
from glissando.geometry.se3 import hat3, quaternion
from glissando.geometry.se3 import inverse as inverse
from oracles.series import Array as Array
from oracles.series import abc, bc_and_slopes, bc_curves, d_and_slope

_NEAR = 2.0  # trace of a rotation above which (by less than 60°) its sine says all


_EYE3, _EYE6 = np.eye(3), np.eye(6)


def so3_exp(phi: Array) -> Array:
    """Rotation matrix (…, 3, 3) of a rotation vector (…, 3)."""
    a, b, _ = abc(np.sum(phi**2, axis=-1))
    w = hat3(phi)
    return _EYE3 + a[..., None, None] * w + b[..., None, None] * (w @ w)


def so3_log(rotation: Array) -> Array:
    """Rotation vector (…, 3) of a rotation matrix (…, 3, 3), its norm in [0, π]."""
    r = rotation
    if np.einsum("...ii->...", r).min(initial=3.0) > _NEAR:
        axis = np.empty(r.shape[:-1])  # times sin θ
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            axis[..., i] = r[..., k, j] - r[..., j, k]
        axis *= 0.5
        sine = np.sqrt(np.einsum("...i,...i->...", axis, axis))
        sine = np.maximum(sine, 1e-9)
        return (np.arcsin(sine) / sine)[..., None] * axis
    q = quaternion(rotation)
    sine = np.linalg.norm(q[..., 1:], axis=-1)
    tiny = sine < 1e-8
    scale = np.where(tiny, 2.0, 2.0 * np.arctan2(sine, q[..., 0]) / np.where(tiny, 1.0, sine))
    return scale[..., None] * q[..., 1:]


def exp(x: Array) -> Array:
    """Pose (…, 4, 4) of a six-vector [rho, phi] (…, 6).

    >>> np.round(exp(np.array([0, 0, 0.1, 0, np.pi / 2, 0]))[:3, 3], 4)  # a quarter arc
    array([0.0637, 0.    , 0.0637])
    """
    _, b, c = abc(np.sum(x[..., 3:] ** 2, axis=-1))
    w = hat3(x[..., 3:])
    v = _EYE3 + b[..., None, None] * w + c[..., None, None] * (w @ w)
    out = np.zeros((*x.shape[:-1], 4, 4))
    out[..., :3, :3] = so3_exp(x[..., 3:])
    out[..., :3, 3] = np.einsum("...ij,...j->...i", v, x[..., :3])
    out[..., 3, 3] = 1.0
    return out


def log(pose: Array) -> Array:
    """Six-vector [rho, phi] (…, 6) of a pose (…, 4, 4), the rotation angle in [0, π]."""
    phi = so3_log(pose[..., :3, :3])
    d, _ = d_and_slope(np.sum(phi**2, axis=-1))
    w = hat3(phi)
    v_inverse = _EYE3 - 0.5 * w + d[..., None, None] * (w @ w)
    rho = np.einsum("...ij,...j->...i", v_inverse, pose[..., :3, 3])
    return np.concatenate([rho, phi], axis=-1)


def right_jacobian_coefficients(q: Array) -> Array:
    """Coefficients (…, 5) of J_r(x) = Σ c_i ad(x)^i as functions of the squared angle (…)."""
    b, c, b_slope, c_slope = bc_and_slopes(q)
    one = np.ones_like(q)
    return np.stack([one, q * b_slope - b, c - q * c_slope, b_slope, -c_slope], axis=-1)


def ad_powers(x: Array) -> Array:
    """Powers 0 to 4 of ad(x), stacked (…, 5, 6, 6); higher ones depend on these."""
    m = ad(x)
    m2 = m @ m
    return np.stack([np.broadcast_to(_EYE6, m.shape), m, m2, m2 @ m, m2 @ m2], axis=-3)


def right_jacobian(x: Array) -> Array:
    """J_r(x) (…, 6, 6): exp(x + d) = exp(x) exp(J_r(x) d) to first order in d.

    Also ∫₀¹ Ad(exp(−u x)) du, which is how the prior uses it.
    """
    c = right_jacobian_coefficients(np.sum(x[..., 3:] ** 2, axis=-1))[..., None, None]
    m = ad(x)
    m2 = m @ m
    return (
        _EYE6
        + m @ (c[..., 1, :, :] * _EYE6 + c[..., 3, :, :] * m2)
        + m2 @ (c[..., 2, :, :] * _EYE6 + c[..., 4, :, :] * m2)
    )


def right_jacobian_slope(x: Array, w: Array) -> Array:
    """Derivative (…, 6, 6) of J_r(x) w with respect to x, for six-vectors x and w (…, 6)."""
    q = np.sum(x[..., 3:] ** 2, axis=-1)
    c = right_jacobian_coefficients(q)[..., None, None]
    b2, c2 = bc_curves(q)
    zero = np.zeros_like(q)
    c_slopes = np.stack([zero, q * b2, -q * c2, b2, -c2], axis=-1)
    m = ad(x)
    power, out, along = w, np.zeros_like(m), np.zeros_like(w)
    by_x = np.zeros_like(m)  # of the power at hand
    for i in range(1, 5):
        by_x = m @ by_x - ad(power)
        power = np.einsum("...ij,...j->...i", m, power)
        out += c[..., i, :, :] * by_x
        along += c_slopes[..., i, None] * power
    out[..., 3:] += 2.0 * along[..., None] * x[..., None, 3:]
    return out


def right_jacobian_inverse(x: Array) -> Array:
    """J_r(x)⁻¹ (…, 6, 6): log(exp(x) exp(d)) = x + J_r(x)⁻¹ d to first order in d."""
    q = np.sum(x[..., 3:] ** 2, axis=-1)
    d, slope = d_and_slope(q)
    m = ad(x)
    m2 = m @ m
    even = (d - q * slope)[..., None, None] * _EYE6 - slope[..., None, None] * m2
    return _EYE6 + 0.5 * m + m2 @ even


def left_jacobian_inverse(x: Array) -> Array:
    """J_l(x)⁻¹ (…, 6, 6)."""
    return right_jacobian_inverse(-x)
