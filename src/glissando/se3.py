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


def _factorial_series(offset: int) -> list[float]:
    """Coefficients of Σ (−q)^m / (2m + offset)!, lowest first."""
    return [(-1.0) ** m / factorial(2 * m + offset) for m in range(_TERMS)]


_A, _B, _C = (_factorial_series(k) for k in (1, 2, 3))
_D = [2.0 * float(zeta(2 * m + 2)) / (2.0 * np.pi) ** (2 * m + 2) for m in range(_TERMS + 4)]


def _series(coefficients: list[float], q: Array) -> Array:
    """Σ c_m q^m for q < 1, with no more terms than the largest q asks for."""
    largest = float(q.max(initial=0.0))
    terms = 5 if largest < 1e-3 else 7 if largest < 0.05 else len(coefficients)
    value = np.full_like(q, coefficients[terms - 1])
    for c in reversed(coefficients[: terms - 1]):
        value *= q
        value += c
    return value


def _derivative(coefficients: list[float]) -> list[float]:
    return [m * c for m, c in enumerate(coefficients)][1:]


_A1, _B1, _C1, _D1 = (_derivative(c) for c in (_A, _B, _C, _D))
_B2, _C2 = _derivative(_B1), _derivative(_C1)


def _piecewise(
    q: Array, series: tuple[list[float], ...], closed: Callable[[Array], tuple[Array, ...]]
) -> tuple[Array, ...]:
    """Functions of q = θ²: power series near zero, closed forms (given q) away from it."""
    far = q >= _SERIES_BELOW
    if not np.any(far):
        return tuple(_series(c, q) for c in series)
    values = tuple(_series(c, np.where(far, 0.0, q)) for c in series)
    for value, exact in zip(values, closed(q[far]), strict=True):
        value[far] = exact
    return values


def _abc_closed(q: Array) -> tuple[Array, ...]:
    theta = np.sqrt(q)
    a = np.sin(theta) / theta
    return a, (1.0 - np.cos(theta)) / q, (1.0 - a) / q


def _abc(q: Array) -> tuple[Array, ...]:
    """A = sin θ/θ, B = (1−cos θ)/θ², C = (θ−sin θ)/θ³ as functions of q = θ²."""
    return _piecewise(q, (_A, _B, _C), _abc_closed)


def _d_closed(q: Array) -> tuple[Array, ...]:
    half = 0.5 * np.sqrt(q)
    g = half / np.tan(half)
    g_slope = (g - half**2 / np.sin(half) ** 2) / (2.0 * q)
    d = (1.0 - g) / q
    return d, (-g_slope - d) / q


def _d_and_slope(q: Array) -> tuple[Array, ...]:
    """D = (1 − (θ/2) cot(θ/2))/θ² and dD/dq."""
    return _piecewise(q, (_D, _D1), _d_closed)


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


def hat3(v: Array) -> Array:
    """Skew matrix (…, 3, 3) of a three-vector (…, 3); its product is the cross product."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


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
    return np.eye(3) + a[..., None, None] * w + b[..., None, None] * (w @ w)


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
    return np.eye(3) + 2.0 * q[..., :1, None] * w + 2.0 * (w @ w)


def so3_log(rotation: Array) -> Array:
    """Rotation vector (…, 3) of a rotation matrix (…, 3, 3), its norm in [0, π]."""
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
    v = np.eye(3) + b[..., None, None] * w + c[..., None, None] * (w @ w)
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
    v_inverse = np.eye(3) - 0.5 * w + d[..., None, None] * (w @ w)
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
    out = np.zeros((*x.shape[:-1], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = hat3(x[..., 3:])
    out[..., :3, 3:] = hat3(x[..., :3])
    return out


def right_jacobian_coefficients(q: Array) -> Array:
    """Coefficients (…, 5) of J_r(x) = Σ c_i ad(x)^i as functions of the squared angle (…)."""
    b, c, b_slope, c_slope = _piecewise(q, (_B, _C, _B1, _C1), _bc_closed)
    one = np.ones_like(q)
    return np.stack([one, q * b_slope - b, c - q * c_slope, b_slope, -c_slope], axis=-1)


def ad_powers(x: Array) -> Array:
    """Powers 0 to 4 of ad(x), stacked (…, 5, 6, 6); higher ones depend on these."""
    m = ad(x)
    m2 = m @ m
    return np.stack([np.broadcast_to(np.eye(6), m.shape), m, m2, m2 @ m, m2 @ m2], axis=-3)


def right_jacobian(x: Array) -> Array:
    """J_r(x) (…, 6, 6): exp(x + d) = exp(x) exp(J_r(x) d) to first order in d.

    Also ∫₀¹ Ad(exp(−u x)) du, which is how the prior uses it.
    """
    c = right_jacobian_coefficients(np.sum(x[..., 3:] ** 2, axis=-1))[..., None, None]
    m = ad(x)
    m2 = m @ m
    eye = np.eye(6)
    return (
        eye
        + m @ (c[..., 1, :, :] * eye + c[..., 3, :, :] * m2)
        + m2 @ (c[..., 2, :, :] * eye + c[..., 4, :, :] * m2)
    )


def right_jacobian_slope(x: Array, w: Array) -> Array:
    """Derivative (…, 6, 6) of J_r(x) w with respect to x, for six-vectors x and w (…, 6)."""
    q = np.sum(x[..., 3:] ** 2, axis=-1)
    c = right_jacobian_coefficients(q)[..., None, None]
    b2, c2 = _piecewise(q, (_B2, _C2), _bc_curves_closed)
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
    even = (d - q * slope)[..., None, None] * np.eye(6) - slope[..., None, None] * m2
    return np.eye(6) + 0.5 * m + m2 @ even


def left_jacobian_inverse(x: Array) -> Array:
    """J_l(x)⁻¹ (…, 6, 6): log(exp(d) exp(x)) = x + J_l(x)⁻¹ d to first order in d."""
    return right_jacobian_inverse(-x)
