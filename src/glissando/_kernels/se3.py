"""SE(3) over lists of items, for `geometry.se3`."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import (
    compose_into,
    exp_into,
    log_into,
    right_jacobian_into,
    right_jacobian_inverse_into,
    slope_into,
)


@jit("(f8[:,::1],)")
def exp(x):
    """Poses (M, 4, 4) of six-vectors (M, 6)."""
    out = np.empty((len(x), 4, 4))
    for i in range(len(x)):
        exp_into(x[i], out[i])
    return out


@jit("(f8[:,:,::1], f8[:,::1])")
def retract(pose, step):
    """Poses (M, 4, 4) perturbed on the right by the first six components of steps (M, ·)."""
    out, move = np.empty((len(pose), 4, 4)), np.empty((4, 4))
    for i in range(len(pose)):
        exp_into(step[i], move)
        compose_into(pose[i], move, out[i])
    return out


@jit("(f8[:,:,::1],)")
def log(pose):
    """Six-vectors (M, 6) of poses (M, 4, 4)."""
    out = np.empty((len(pose), 6))
    for i in range(len(pose)):
        log_into(pose[i], out[i])
    return out


@jit("(f8[:,::1],)")
def right_jacobian(x):
    """Right Jacobians (M, 6, 6) of six-vectors (M, 6)."""
    out = np.empty((len(x), 6, 6))
    for i in range(len(x)):
        right_jacobian_into(x[i], out[i])
    return out


@jit("(f8[:,::1],)")
def right_jacobian_inverse(x):
    """Inverse right Jacobians (M, 6, 6) of six-vectors (M, 6)."""
    out = np.empty((len(x), 6, 6))
    for i in range(len(x)):
        right_jacobian_inverse_into(x[i], out[i])
    return out


@jit("(f8[:,::1], f8[:,::1])")
def right_jacobian_slope(x, w):
    """Derivatives (M, 6, 6) of J_r(x) w by x, both (M, 6)."""
    out = np.empty((len(x), 6, 6))
    for i in range(len(x)):
        slope_into(x[i], w[i], out[i])
    return out
