"""Errors of measured poses, with or without their roll. Source: equations (14) and (15)."""

from __future__ import annotations

from math import atan2

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import (
    adjoint_back_into,
    ahead_into,
    compose_into,
    exp_into,
    log_into,
    right_jacobian_inverse_into,
    times_into,
)


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], b1)")
def pose_error(values, pose, mount, rolls):
    """Errors (M, 6) of measured poses; with `rolls` their roll is turned to agree."""
    out, roll = np.empty((len(pose), 6)), np.zeros(6)
    there, apart, turn = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    for n in range(len(pose)):
        compose_into(pose[n], mount[n], there)
        ahead_into(values[n], there, apart)
        if rolls:
            roll[5] = -atan2(apart[1, 0] - apart[0, 1], apart[0, 0] + apart[1, 1])
            exp_into(roll, turn)
            for i in range(4):
                for j in range(4):
                    there[i, j] = apart[i, j]
            compose_into(turn, there, apart)
        log_into(apart, out[n])
    return out


@jit("(f8[:,::1], f8[:,:,::1], b1)")
def pose_error_jacobian(miss, mount, rolls):
    """Slopes of those errors by the pose, (M, 6, 6) or (M, 5, 6)."""
    rows = 5 if rolls else 6
    out = np.empty((len(miss), rows, 6))
    spread, back, whole = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    opposite = np.empty(6)
    for n in range(len(miss)):
        right_jacobian_inverse_into(miss[n], spread)
        adjoint_back_into(mount[n], back)
        times_into(spread, back, whole)
        if rolls:  # that by a roll before the error; J_l(x) is J_r(−x)
            for i in range(6):
                opposite[i] = -miss[n, i]
            right_jacobian_inverse_into(opposite, spread)
        for i in range(rows):
            follow = spread[i, 5] / spread[5, 5] if rolls else 0.0
            for j in range(6):
                out[n, i, j] = whole[i, j] - follow * whole[5, j]
    return out
