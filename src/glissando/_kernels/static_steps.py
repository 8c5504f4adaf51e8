"""Errors of arclength steps of static shapes. Source: equation (2')."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.process import middle_into, pair_whiten_into, process_into
from glissando._kernels.scratch import matrix, vector
from glissando._kernels.steps import pair_into


@jit("(f8[:,:,::1], f8[:,::1], i8[:,::1], f8[::1], f8[:,::1], f8[:,::1], b1)")
def static_steps(pose, strain, nodes, step, psd, jump, rigid):
    """Errors (M, 12) of static steps, Jacobians (M, 12, 2, 12), whiteners (M, 12, 12)."""
    m = len(step)
    error, jacobian, info = np.empty((m, 12)), np.zeros((m, 12, 2, 12)), np.zeros((m, 12, 12))
    back, pull, spread = matrix(6, 6), matrix(6, 6), matrix(6, 6)
    middle, cov, unused = vector(6), matrix(12, 12), matrix(6, 6)
    for n in range(m):
        a, b, h = nodes[n, 0], nodes[n, 1], step[n]
        pair_into(pose[a], pose[b], strain[a], strain[b], h, error[n], back, pull, spread)
        out = jacobian[n]
        for i in range(6):
            for j in range(6):
                out[i, 0, j], out[i, 0, 6 + j], out[i, 1, j] = back[i, j], pull[i, j], spread[i, j]
            out[6 + i, 0, 6 + i], out[6 + i, 1, 6 + i] = -1.0, 1.0
        middle_into(strain[a], strain[b], h, psd[n], jump[n], middle)
        process_into(middle, h, psd[n], psd[n], jump[n], rigid, cov, unused)
        pair_whiten_into(cov, info[n])
    return error, jacobian, info
