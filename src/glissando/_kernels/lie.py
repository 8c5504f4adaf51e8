"""SE(3) of single items, for use inside compiled loops.

Matrices of the form [A B; 0 A], as adjoints and Jacobians of SE(3) are, are multiplied by blocks.
"""

from __future__ import annotations

from fractions import Fraction
from math import asin, atan2, comb, cos, factorial, sin, sqrt, tan

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.scratch import matrix, vector, zero_matrix

BELOW = 1.0  # squared angle under which the power series are used
_TERMS = 12
_NEAR = 2.0  # trace of a rotation above which its angle follows from its sine


def _factorial_series(offset: int) -> list[float]:
    """Coefficients of Σ (−q)^m / (2m + offset)!, lowest first."""
    return [(-1.0) ** m / factorial(2 * m + offset) for m in range(_TERMS)]


def _cotangent_series() -> list[float]:
    """Coefficients |B_2m+2| / (2m + 2)! of D(q), from the Bernoulli numbers B."""
    bernoulli = [Fraction(1)]
    for n in range(1, 2 * _TERMS + 9):
        rest = sum((comb(n + 1, k) * b for k, b in enumerate(bernoulli)), Fraction(0))
        bernoulli.append(-rest / (n + 1))
    return [float(abs(bernoulli[n]) / factorial(n)) for n in range(2, 2 * _TERMS + 9, 2)]


def _derivative(coefficients: list[float]) -> list[float]:
    return [m * c for m, c in enumerate(coefficients)][1:]


_A, _B, _C = (np.array(_factorial_series(k)) for k in (1, 2, 3))
_D = np.array(_cotangent_series())
_B1, _C1, _D1 = (np.array(_derivative(list(series))) for series in (_B, _C, _D))
_B2, _C2 = (np.array(_derivative(list(series))) for series in (_B1, _C1))


@jit(inline=True)
def _series(coefficients, q):
    """Σ c_m q^m for q < 1, with as many terms as q requires."""
    terms = 5 if q < 1e-3 else 7 if q < 0.05 else coefficients.size
    value = coefficients[terms - 1]
    for m in range(terms - 2, -1, -1):
        value = value * q + coefficients[m]
    return value


@jit(inline=True)
def _abc(q):
    if q < BELOW:
        return _series(_A, q), _series(_B, q), _series(_C, q)
    theta = sqrt(q)
    a = sin(theta) / theta
    return a, (1.0 - cos(theta)) / q, (1.0 - a) / q


@jit(inline=True)
def _d_and_slope(q):
    if q < BELOW:
        return _series(_D, q), _series(_D1, q)
    half = 0.5 * sqrt(q)
    g = half / tan(half)
    d = (1.0 - g) / q
    return d, (-(g - (half / sin(half)) ** 2) / (2.0 * q) - d) / q


@jit(inline=True)
def _bc_slopes(q):
    if q < BELOW:
        return _series(_B, q), _series(_C, q), _series(_B1, q), _series(_C1, q)
    a, b, c = _abc(q)
    a_slope = (cos(sqrt(q)) - a) / (2.0 * q)
    return b, c, (0.5 * a - b) / q, (-a_slope - c) / q


@jit(inline=True)
def _bc_curves(q):
    """Second derivatives of B and C by q."""
    if q < BELOW:
        return _series(_B2, q), _series(_C2, q)
    a, _, _ = _abc(q)
    _, _, b_slope, c_slope = _bc_slopes(q)
    a_slope = (cos(sqrt(q)) - a) / (2.0 * q)
    a_curve = -(0.5 * a + 3.0 * a_slope) / (2.0 * q)
    return (0.5 * a_slope - 2.0 * b_slope) / q, -(a_curve + 2.0 * c_slope) / q


@jit(inline=True)
def squared_angle(x):
    """The squared angle of a six-vector."""
    return x[3] * x[3] + x[4] * x[4] + x[5] * x[5]


@jit(inline=True)
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@jit(inline=True)
def exp_into(x, out):
    """Pose (4, 4) of a six-vector, into `out`."""
    q = squared_angle(x)
    a, b, c = _abc(q)
    x3, x4, x5 = x[3], x[4], x[5]
    diagonal = 1.0 - b * q
    out[0, 0], out[1, 1], out[2, 2] = diagonal + b * x3 * x3, diagonal + b * x4 * x4, 0.0
    out[2, 2] = diagonal + b * x5 * x5
    out[0, 1], out[1, 0] = b * x3 * x4 - a * x5, b * x3 * x4 + a * x5
    out[0, 2], out[2, 0] = b * x3 * x5 + a * x4, b * x3 * x5 - a * x4
    out[1, 2], out[2, 1] = b * x4 * x5 - a * x3, b * x4 * x5 + a * x3
    u, v, w = _cross(x3, x4, x5, x[0], x[1], x[2])
    uu, vv, ww = _cross(x3, x4, x5, u, v, w)
    out[0, 3] = x[0] + b * u + c * uu
    out[1, 3] = x[1] + b * v + c * vv
    out[2, 3] = x[2] + b * w + c * ww
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@jit(inline=True)
def _rotation_log(r, out):
    """Rotation vector of a rotation, into out[3:6]."""
    x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    if trace > _NEAR:
        sine = max(0.5 * sqrt(x * x + y * y + z * z), 1e-9)
        scale = 0.5 * asin(min(sine, 1.0)) / sine
        out[3], out[4], out[5] = scale * x, scale * y, scale * z
        return
    best = max(trace, r[0, 0], r[1, 1], r[2, 2])
    if best == trace:
        w = 1.0 + trace
    elif best == r[0, 0]:
        w, x, y, z = x, 1.0 + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]
    elif best == r[1, 1]:
        w, x, y, z = y, r[0, 1] + r[1, 0], 1.0 - r[0, 0] + r[1, 1] - r[2, 2], r[1, 2] + r[2, 1]
    else:
        w, x, y, z = z, r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1.0 - r[0, 0] - r[1, 1] + r[2, 2]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    length = sqrt(x * x + y * y + z * z)
    scale = 2.0 * atan2(length, w) / length
    out[3], out[4], out[5] = scale * x, scale * y, scale * z


@jit(inline=True)
def log_into(pose, out):
    """Six-vector of a pose, into `out`."""
    _rotation_log(pose, out)
    d, _ = _d_and_slope(squared_angle(out))
    px, py, pz = pose[0, 3], pose[1, 3], pose[2, 3]
    u, v, w = _cross(out[3], out[4], out[5], px, py, pz)
    uu, vv, ww = _cross(out[3], out[4], out[5], u, v, w)
    out[0], out[1], out[2] = px - 0.5 * u + d * uu, py - 0.5 * v + d * vv, pz - 0.5 * w + d * ww


@jit(inline=True)
def compose_into(a, b, out):
    """The pose a b, into `out`."""
    for i in range(3):
        for j in range(4):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
        out[i, 3] += a[i, 3]
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@jit(inline=True)
def ahead_into(a, b, out):
    """The pose a⁻¹ b."""
    x, y, z = b[0, 3] - a[0, 3], b[1, 3] - a[1, 3], b[2, 3] - a[2, 3]
    for i in range(3):
        for j in range(3):
            out[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]
        out[i, 3] = a[0, i] * x + a[1, i] * y + a[2, i] * z
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@jit(inline=True)
def fill(out):
    """Complete the lower half of [A B; 0 A]."""
    for i in range(3):
        for j in range(3):
            out[3 + i, j] = 0.0
            out[3 + i, 3 + j] = out[i, j]


@jit(inline=True)
def adjoint_into(pose, out):
    """Adjoint (6, 6) of a pose, into `out`."""
    for j in range(3):
        for i in range(3):
            out[i, j] = pose[i, j]
        u, v, w = _cross(pose[0, 3], pose[1, 3], pose[2, 3], pose[0, j], pose[1, j], pose[2, j])
        out[0, 3 + j], out[1, 3 + j], out[2, 3 + j] = u, v, w
    fill(out)


@jit(inline=True)
def adjoint_back_into(pose, out):
    """Ad(T⁻¹) = [Rᵀ, −Rᵀ p^; 0, Rᵀ], whose rows i are R's columns and p × them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = pose[j, i]
        u, v, w = _cross(pose[0, 3], pose[1, 3], pose[2, 3], pose[0, i], pose[1, i], pose[2, i])
        out[i, 3], out[i, 4], out[i, 5] = u, v, w
    fill(out)


@jit(inline=True)
def ad_into(x, out):
    """ad(x) (6, 6), the derivative of the adjoint at the identity, into `out`."""
    for first in (0, 3):
        k = 3 - first
        out[0, first] = out[1, first + 1] = out[2, first + 2] = 0.0
        out[0, first + 1], out[1, first] = -x[k + 2], x[k + 2]
        out[0, first + 2], out[2, first] = x[k + 1], -x[k + 1]
        out[1, first + 2], out[2, first + 1] = -x[k], x[k]
    fill(out)


@jit(inline=True)
def times_into(a, b, out):
    """Product of matrices [A B; 0 A]."""
    for i in range(3):
        for j in range(3):
            top = corner = 0.0
            for k in range(3):
                top += a[i, k] * b[k, j]
                corner += a[i, k] * b[k, 3 + j] + a[i, 3 + k] * b[k, j]
            out[i, j], out[i, 3 + j] = top, corner
    fill(out)


@jit(inline=True)
def _polynomial(x, c1, c2, c3, c4, out):
    """1 + Σ c_i ad(x)^i."""
    m, m2, tail = matrix(6, 6), matrix(6, 6), matrix(6, 6)
    ad_into(x, m)
    times_into(m, m, m2)
    for i in range(3):
        for j in range(6):
            tail[i, j] = c3 * m[i, j] + c4 * m2[i, j]
        tail[i, i] += c2
    fill(tail)
    times_into(m2, tail, out)
    for i in range(3):
        for j in range(6):
            out[i, j] += c1 * m[i, j]
        out[i, i] += 1.0
    fill(out)


@jit(inline=True)
def jacobian_coefficients(q):
    """Coefficients of ad(x)^i in J_r(x), i from 1 to 4, at a squared angle q."""
    b, c, b_slope, c_slope = _bc_slopes(q)
    return q * b_slope - b, c - q * c_slope, b_slope, -c_slope


@jit(inline=True)
def right_jacobian_into(x, out):
    """Right Jacobian (6, 6), into `out`."""
    c1, c2, c3, c4 = jacobian_coefficients(squared_angle(x))
    _polynomial(x, c1, c2, c3, c4, out)


@jit(inline=True)
def right_jacobian_inverse_into(x, out):
    """Inverse right Jacobian (6, 6), into `out`."""
    q = squared_angle(x)
    d, slope = _d_and_slope(q)
    _polynomial(x, 0.5, d - q * slope, 0.0, -slope, out)


@jit(inline=True)
def slope_into(x, w, out):
    """Derivative (6, 6) of J_r(x) w by x, into `out`."""
    m, by_x, fresh = matrix(6, 6), zero_matrix(6, 6), matrix(6, 6)
    power, next_ = vector(6), vector(6)
    q = squared_angle(x)
    c1, c2, c3, c4 = jacobian_coefficients(q)
    b_curve, c_curve = _bc_curves(q)
    ad_into(x, m)
    for r in range(6):
        power[r] = w[r]
        for k in range(6):
            out[r, k] = 0.0
    for i in range(4):
        coefficient, slope = c1, q * b_curve
        if i == 1:
            coefficient, slope = c2, -q * c_curve
        elif i == 2:
            coefficient, slope = c3, b_curve
        elif i == 3:
            coefficient, slope = c4, -c_curve
        times_into(m, by_x, fresh)
        ad_into(power, by_x)
        for r in range(6):
            next_[r] = 0.0
            for k in range(6):
                next_[r] += m[r, k] * power[k]
                by_x[r, k] = fresh[r, k] - by_x[r, k]
                out[r, k] += coefficient * by_x[r, k]
        for r in range(6):
            power[r] = next_[r]
            for k in range(3):
                out[r, 3 + k] += 2.0 * slope * power[r] * x[3 + k]
