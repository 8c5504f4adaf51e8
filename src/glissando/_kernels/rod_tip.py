"""The wrench at a rod's tip beyond its tool's weight, and its rate. Source: (27)."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.scratch import matrix, vector


@jit()
def _hat_into(x, out):
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1], out[1, 0] = -x[2], x[2]
    out[0, 2], out[2, 0] = x[1], -x[1]
    out[1, 2], out[2, 1] = -x[0], x[0]


@jit()
def _times_into(a, b, out):
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@jit("(f8[:,:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1], f8[::1])")
def tip_error(pose, fields, stiffness, rest, weight, center):
    """See `model.priors.mechanical.tip.tip_error`; `weight` (M, 3) is the tool's in the world."""
    m = len(pose)
    error, jacobian = np.empty((m, 12)), np.zeros((m, 12, 24))
    force, heavy, turning = vector(3), matrix(3, 3), matrix(3, 3)
    lever, by_turn, spin = matrix(3, 3), matrix(3, 3), matrix(3, 3)
    leant = matrix(3, 3)
    _hat_into(center, lever)
    for n in range(m):
        for i in range(3):
            force[i] = 0.0
            for j in range(3):
                force[i] += pose[n, j, i] * weight[n, j]
        _hat_into(force, heavy)
        _hat_into(fields[n, 9:12], turning)
        _times_into(lever, heavy, by_turn)
        _times_into(turning, heavy, spin)
        _times_into(lever, spin, leant)
        for i in range(6):
            error[n, i] = stiffness[i] * (fields[n, i] - rest[i])
            error[n, 6 + i] = stiffness[i] * fields[n, 12 + i]
            jacobian[n, i, 6 + i] = jacobian[n, 6 + i, 18 + i] = stiffness[i]
        for i in range(3):
            error[n, i] -= force[i]
            for j in range(3):
                error[n, 3 + i] -= lever[i, j] * force[j]
                error[n, 6 + i] -= heavy[i, j] * fields[n, 9 + j]
                error[n, 9 + i] -= by_turn[i, j] * fields[n, 9 + j]
                jacobian[n, i, 3 + j] = jacobian[n, 6 + i, 15 + j] = -heavy[i, j]
                jacobian[n, 3 + i, 3 + j] = jacobian[n, 9 + i, 15 + j] = -by_turn[i, j]
                jacobian[n, 6 + i, 3 + j], jacobian[n, 9 + i, 3 + j] = spin[i, j], leant[i, j]
    return error, jacobian
