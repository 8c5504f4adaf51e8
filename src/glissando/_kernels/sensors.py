"""Readings: twins of sensors.py, poses with or without their roll, and of placed.py."""

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
from glissando._kernels.process import whiten_into


@jit
def pose_miss(values, pose, mount, rolls):
    """Errors (M, 6) of measured poses; with `rolls` their roll is turned to agree."""
    out, roll = np.empty((len(pose), 6)), np.zeros(6)
    there, apart, turn = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    for n in range(len(pose)):
        compose_into(pose[n], mount[n], there)
        ahead_into(values[n], there, apart)
        if rolls:
            roll[5] = -atan2(apart[1, 0] - apart[0, 1], apart[0, 0] + apart[1, 1])
            exp_into(roll, turn)
            there[:] = apart
            compose_into(turn, there, apart)
        log_into(apart, out[n])
    return out


@jit
def pose_slope(miss, mount, rolls):
    """Slopes of those errors by the pose, (M, 6, 6) or (M, 5, 6)."""
    rows = 5 if rolls else 6
    out = np.empty((len(miss), rows, 6))
    spread, back, whole = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    for n in range(len(miss)):
        right_jacobian_inverse_into(miss[n], spread)
        adjoint_back_into(mount[n], back)
        times_into(spread, back, whole)
        if rolls:  # that by a roll before the error; J_l(x) is J_r(−x)
            right_jacobian_inverse_into(-miss[n], spread)
        for i in range(rows):
            follow = spread[i, 5] / spread[5, 5] if rolls else 0.0
            for j in range(6):
                out[n, i, j] = whole[i, j] - follow * whole[5, j]
    return out


@jit
def by_nodes_of(by_state, jacobian, left, cov):
    """Slopes (M, r, c, d) of residuals by nodes and whiteners (M, r, r)."""
    m, r, dof = by_state.shape
    c, d = jacobian.shape[2:]
    out, whitener = np.zeros((m, r, c, d)), np.empty((m, r, r))
    half, whole = np.empty((r, dof)), np.empty((r, r))
    for n in range(m):
        half[:] = 0.0
        for i in range(r):
            for k in range(dof):
                share = by_state[n, i, k]
                if share != 0.0:  # a sensor sees little of a state
                    for j in range(dof):
                        half[i, j] += share * left[n, k, j]
                    for a in range(c):
                        for j in range(d):
                            out[n, i, a, j] += share * jacobian[n, k, a, j]
        for i in range(r):
            for j in range(r):
                whole[i, j] = cov[n, i, j]
                for k in range(dof):
                    whole[i, j] += half[i, k] * by_state[n, j, k]
        whiten_into(whole, whitener[n])
    return out, whitener
