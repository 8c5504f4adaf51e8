"""SE(3) over lists of items: twins of se3.py."""

from __future__ import annotations

import numpy as np

from glissando.compiled.jit import jit
from glissando.compiled.lie import (
    ad_into,
    adjoint_into,
    bc_curves,
    exp_into,
    jacobian_coefficients,
    log_into,
    right_jacobian_into,
    right_jacobian_inverse_into,
    square,
    times_into,
)


@jit
def exp(x):
    """Poses (M, 4, 4) of six-vectors (M, 6)."""
    out = np.empty((len(x), 4, 4))
    for i in range(len(x)):
        exp_into(x[i], out[i])
    return out


@jit
def log(pose):
    """Six-vectors (M, 6) of poses (M, 4, 4)."""
    out = np.empty((len(pose), 6))
    for i in range(len(pose)):
        log_into(pose[i], out[i])
    return out


@jit
def adjoint(pose):
    """Adjoints (M, 6, 6) of poses (M, 4, 4)."""
    out = np.empty((len(pose), 6, 6))
    for i in range(len(pose)):
        adjoint_into(pose[i], out[i])
    return out


@jit
def right_jacobian(x):
    """Right Jacobians (M, 6, 6) of six-vectors (M, 6)."""
    out = np.empty((len(x), 6, 6))
    for i in range(len(x)):
        right_jacobian_into(x[i], out[i])
    return out


@jit
def right_jacobian_inverse(x):
    """Their inverses (M, 6, 6)."""
    out = np.empty((len(x), 6, 6))
    for i in range(len(x)):
        right_jacobian_inverse_into(x[i], out[i])
    return out


@jit
def right_jacobian_slope(x, w):
    """Derivatives (M, 6, 6) of J_r(x) w by x, both (M, 6)."""
    out = np.zeros((len(x), 6, 6))
    m, by_x, fresh = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    power, next_ = np.empty(6), np.empty(6)
    c = np.empty(4)
    slopes = np.empty(4)
    for n in range(len(x)):
        q = square(x[n])
        c[0], c[1], c[2], c[3] = jacobian_coefficients(q)
        b2, c2 = bc_curves(q)
        slopes[0], slopes[1], slopes[2], slopes[3] = q * b2, -q * c2, b2, -c2
        ad_into(x[n], m)
        by_x[:] = 0.0
        power[:] = w[n]
        for i in range(4):
            times_into(m, by_x, fresh)
            ad_into(power, by_x)
            for r in range(6):
                next_[r] = 0.0
                for k in range(6):
                    next_[r] += m[r, k] * power[k]
                    by_x[r, k] = fresh[r, k] - by_x[r, k]
                    out[n, r, k] += c[i] * by_x[r, k]
            power[:] = next_
            for r in range(6):
                for k in range(3):
                    out[n, r, 3 + k] += 2.0 * slopes[i] * power[r] * x[n, 3 + k]
    return out


@jit
def inverse(pose):
    """Inverses (M, 4, 4) of poses."""
    out = np.empty(pose.shape)
    for n in range(len(pose)):
        for i in range(3):
            out[n, 3, i] = out[n, i, 3] = 0.0
            for j in range(3):
                out[n, i, j] = pose[n, j, i]
                out[n, i, 3] -= pose[n, j, i] * pose[n, j, 3]
        out[n, 3, 3] = 1.0
    return out
