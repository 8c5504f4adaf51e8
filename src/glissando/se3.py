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

from collections.abc import Callable
from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.special import zeta

Array = NDArray[np.float64]

_SERIES_BELOW = 1.0  # squared angle under which the power series are used
_TERMS = 12
_NEAR = 2.0  # trace of a rotation above which (by less than 60°) its sine says all


def _factorial_series(offset: int) -> list[float]:
    """Coefficients of Σ (−q)^m / (2m + offset)!, lowest first."""
    return [(-1.0) ** m / factorial(2 * m + offset) for m in range(_TERMS)]


_A, _B, _C = (_factorial_series(k) for k in (1, 2, 3))
_D = [2.0 * float(zeta(2 * m + 2)) / (2.0 * np.pi) ** (2 * m + 2) for m in range(_TERMS + 4)]


def _derivative(coefficients: list[float]) -> list[float]:
    return [m * c for m, c in enumerate(coefficients)][1:]


def _together(*series: list[float]) -> Array:
    """Coefficients of F series as a table (terms, F, 1), as long as the shortest of them."""
    return np.array(list(zip(*series, strict=False)))[..., None]


_B1, _C1 = _derivative(_B), _derivative(_C)
_ABC = _together(_A, _B, _C)
_DD1 = _together(_D, _derivative(_D))
_BC_SLOPES = _together(_B, _C, _B1, _C1)
_BC_CURVES = _together(_derivative(_B1), _derivative(_C1))


def _series(table: Array, q: Array, largest: float) -> Array:
    """Σ c_m q^m (F, …) for q < 1, with no more terms than the largest q asks for."""
    terms = 5 if largest < 1e-3 else 7 if largest < 0.05 else len(table)
    flat = q.ravel()
    value = flat * table[terms - 1]
    for c in table[terms - 2 : 0 : -1]:
        value += c
        value *= flat
    value += table[0]
    return value.reshape(table.shape[1], *q.shape)


def _piecewise(q: Array, table: Array, closed: Callable[[Array], tuple[Array, ...]]) -> Array:
    """Functions (F, …) of q = θ²: power series near zero, closed forms (given q) away from it."""
    largest = float(q.max(initial=0.0))
    if largest < _SERIES_BELOW:
        return _series(table, q, largest)
    far = q >= _SERIES_BELOW
    values = _series(table, np.where(far, 0.0, q), _SERIES_BELOW)
    values[:, far] = closed(q[far])
    return values


def _abc_closed(q: Array) -> tuple[Array, ...]:
    theta = np.sqrt(q)
    a = np.sin(theta) / theta
    return a, (1.0 - np.cos(theta)) / q, (1.0 - a) / q


def _abc(q: Array) -> Array:
    """A = sin θ/θ, B = (1−cos θ)/θ², C = (θ−sin θ)/θ³ as functions (3, …) of q = θ²."""
    return _piecewise(q, _ABC, _abc_closed)


def _d_closed(q: Array) -> tuple[Array, ...]:
    half = 0.5 * np.sqrt(q)
    g = half / np.tan(half)
    g_slope = (g - half**2 / np.sin(half) ** 2) / (2.0 * q)
    d = (1.0 - g) / q
    return d, (-g_slope - d) / q


def _d_and_slope(q: Array) -> Array:
    """D = (1 − (θ/2) cot(θ/2))/θ² and dD/dq (2, …)."""
    return _piecewise(q, _DD1, _d_closed)


def _bc_closed(q: Array) -> tuple[Array, ...]:
    a, b, c = _abc_closed(q)
    a_slope = (np.cos(np.sqrt(q)) - a) / (2.0 * q)
    return b, c, (0.5 * a - b) / q, (-a_slope - c) / q


def _bc_curves_closed(q: Array) -> tuple[Array, ...]:
    a, _, _ = _abc_closed(q)
    _, _, b_slope, c_slope = _bc_closed(q)
    a_slope = (np.cos(np.sqrt(q)) - a) / (2.0 * q)
    a_curve = -(0.5 * a + 3.0 * a_slope) / (2.0 * q)
    return (0.5 * a_slope - 2.0 * b_slope) / q, -(a_curve + 2.0 * c_slope) / q


def _skews() -> tuple[Array, Array]:
    """What makes a skew matrix of a three-vector and an adjoint's derivative of a six-vector."""
    skew, wide = np.zeros((3, 3, 3)), np.zeros((6, 6, 6))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        skew[i, k, j], skew[i, j, k] = 1.0, -1.0
    wide[3:, :3, :3] = wide[3:, 3:, 3:] = wide[:3, :3, 3:] = skew
    return skew.reshape(3, 9), wide.reshape(6, 36)


_EYE3, _EYE6 = np.eye(3), np.eye(6)
_SKEW, _AD = _skews()


def hat3(v: Array) -> Array:
    """Skew matrix (…, 3, 3) of a three-vector (…, 3); its product is the cross product."""
    return (v @ _SKEW).reshape(*v.shape[:-1], 3, 3)


def hat(x: Array) -> Array:
    """Matrix x^ (…, 4, 4) of a six-vector [rho, phi]; dT/ds is T times that of the strain."""
    out = np.zeros((*x.shape[:-1], 4, 4))
    out[..., :3, :3] = hat3(x[..., 3:])
    out[..., :3, 3] = x[..., :3]
    return out


def so3_exp(phi: Array) -> Array:
    """Rotation matrix (…, 3, 3) of a rotation vector (…, 3)."""
    a, b, _ = _abc(np.sum(phi**2, axis=-1))
    w = hat3(phi)
    return _EYE3 + a[..., None, None] * w + b[..., None, None] * (w @ w)


def quaternion(rotation: Array) -> Array:
    """Unit quaternion [w, x, y, z] (…, 4), w ≥ 0, of a rotation matrix (…, 3, 3).

    The largest of the four components is found first and the others divided by it, so the
    result is accurate for every angle (Shepperd 1978).
    """
    r = rotation
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    q = np.empty((*r.shape[:-2], 4, 4))  # row i is the quaternion times 4 * its component i
    q[..., 0, 0], q[..., 1, 1] = 1 + xx + yy + zz, 1 + xx - yy - zz
    q[..., 2, 2], q[..., 3, 3] = 1 - xx + yy - zz, 1 - xx - yy + zz
    for i, j, k in ((1, 2, 3), (2, 3, 1), (3, 1, 2)):
        q[..., 0, i] = q[..., i, 0] = r[..., k - 1, j - 1] - r[..., j - 1, k - 1]
        q[..., i, j] = q[..., j, i] = r[..., i - 1, j - 1] + r[..., j - 1, i - 1]
    largest = np.argmax(np.einsum("...ii->...i", q), axis=-1)
    best = np.take_along_axis(q, largest[..., None, None], axis=-2)[..., 0, :]
    best = best / np.linalg.norm(best, axis=-1, keepdims=True)
    return np.where(best[..., :1] < 0.0, -best, best)


def rotation_from_quaternion(q: Array) -> Array:
    """Rotation matrix (…, 3, 3) of a quaternion [w, x, y, z] (…, 4), normalised here."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w = hat3(q[..., 1:])
    return _EYE3 + 2.0 * q[..., :1, None] * w + 2.0 * (w @ w)


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
    _, b, c = _abc(np.sum(x[..., 3:] ** 2, axis=-1))
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
    d, _ = _d_and_slope(np.sum(phi**2, axis=-1))
    w = hat3(phi)
    v_inverse = _EYE3 - 0.5 * w + d[..., None, None] * (w @ w)
    rho = np.einsum("...ij,...j->...i", v_inverse, pose[..., :3, 3])
    return np.concatenate([rho, phi], axis=-1)


def inverse(pose: Array) -> Array:
    """Inverse (…, 4, 4) of a pose: takes world coordinates to body."""
    out = np.zeros_like(pose)
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    out[..., :3, :3] = rotation
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation, pose[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def adjoint(pose: Array) -> Array:
    """Ad(T) (…, 6, 6): T exp(x^) T⁻¹ = exp((Ad(T) x)^)."""
    rotation = pose[..., :3, :3]
    out = np.zeros((*pose.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = rotation
    out[..., :3, 3:] = hat3(pose[..., :3, 3]) @ rotation
    return out


def ad(x: Array) -> Array:
    """Derivative of the adjoint (…, 6, 6): its product with y is the bracket of x^ and y^."""
    return (x @ _AD).reshape(*x.shape[:-1], 6, 6)


def right_jacobian_coefficients(q: Array) -> Array:
    """Coefficients (…, 5) of J_r(x) = Σ c_i ad(x)^i as functions of the squared angle (…)."""
    b, c, b_slope, c_slope = _piecewise(q, _BC_SLOPES, _bc_closed)
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
    b2, c2 = _piecewise(q, _BC_CURVES, _bc_curves_closed)
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
    d, slope = _d_and_slope(q)
    m = ad(x)
    m2 = m @ m
    even = (d - q * slope)[..., None, None] * _EYE6 - slope[..., None, None] * m2
    return _EYE6 + 0.5 * m + m2 @ even


def left_jacobian_inverse(x: Array) -> Array:
    """J_l(x)⁻¹ (…, 6, 6): log(exp(d) exp(x)) = x + J_l(x)⁻¹ d to first order in d."""
    return right_jacobian_inverse(-x)
