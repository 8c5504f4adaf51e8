"""Errors of steps and the point between two nodes: twins of steps.py."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import (
    ad_into,
    adjoint_back_into,
    adjoint_into,
    ahead_into,
    compose_into,
    exp_into,
    log_into,
    right_jacobian_into,
    right_jacobian_inverse_into,
    times_into,
)
from glissando._kernels.process import (
    apply_into,
    matmul_into,
    middle_into,
    pair_whiten_into,
    process_into,
    whiten_into,
)


@jit
def _pair(start, end, rate0, rate1, step, error, back, pull, spread):
    """Error (12,) of a step; its Jacobian is [back, pull; 0, −1] at the start, [spread, 0; 0, 1].

    In the order [pose, rate]; the three blocks (6, 6) are written.
    """
    scaled, xi = np.empty(6), np.empty(6)
    ahead, miss, pose = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    a, b = np.empty((6, 6)), np.empty((6, 6))
    for i in range(6):
        scaled[i] = step * rate0[i]
    ahead_into(start, end, ahead)
    exp_into(-scaled, pose)
    compose_into(pose, ahead, miss)
    log_into(miss, xi)
    right_jacobian_inverse_into(xi, spread)
    adjoint_back_into(ahead, a)
    times_into(spread, a, back)
    adjoint_back_into(miss, a)
    times_into(spread, a, b)
    right_jacobian_into(scaled, a)
    times_into(b, a, pull)
    for i in range(6):
        error[i], error[6 + i] = xi[i], rate1[i] - rate0[i]
        for j in range(6):
            back[i, j] *= -1.0
            pull[i, j] *= -step


@jit
def pair_error(start, end, rate0, rate1, step, at):
    """Errors (M, 12) of pose and rate, Jacobians (M, 12, 18) at both ends."""
    m = len(step)
    error, j0, j1 = np.empty((m, 12)), np.zeros((m, 12, 18)), np.zeros((m, 12, 18))
    back, pull, spread = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    for n in range(m):
        _pair(start[n], end[n], rate0[n], rate1[n], step[n], error[n], back, pull, spread)
        for i in range(6):
            for j in range(6):
                j0[n, i, j], j0[n, i, at + j], j1[n, i, j] = back[i, j], pull[i, j], spread[i, j]
            j0[n, 6 + i, at + i], j1[n, 6 + i, at + i] = -1.0, 1.0
    return error, j0, j1


@jit
def static_steps(pose, strain, nodes, step, psd, jump):
    """Errors (M, 12) of steps that hold still, Jacobians (M, 12, 2, 12), whiteners (M, 12, 12)."""
    m = len(step)
    error, jacobian, info = np.empty((m, 12)), np.zeros((m, 12, 2, 12)), np.zeros((m, 12, 12))
    back, pull, spread = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    middle, cov, unused = np.empty(6), np.empty((12, 12)), np.empty((6, 6))
    for n in range(m):
        a, b, h = nodes[n, 0], nodes[n, 1], step[n]
        _pair(pose[a], pose[b], strain[a], strain[b], h, error[n], back, pull, spread)
        out = jacobian[n]
        for i in range(6):
            for j in range(6):
                out[i, 0, j], out[i, 0, 6 + j], out[i, 1, j] = back[i, j], pull[i, j], spread[i, j]
            out[6 + i, 0, 6 + i], out[6 + i, 1, 6 + i] = -1.0, 1.0
        middle_into(strain[a], strain[b], h, psd[n], jump[n], middle)
        process_into(middle, h, psd[n], psd[n], jump[n], False, cov, unused)
        pair_whiten_into(cov, info[n])
    return error, jacobian, info


@jit
def _carried(start, end, field0, field1, at, rigid, error, j0, j1):
    """Error (6,) of the carried field and its Jacobians (6, 18), which are written."""
    j0[:], j1[:] = 0.0, 0.0
    for i in range(6):
        j1[i, at + i] = 1.0
        if not rigid:
            j0[i, at + i], error[i] = -1.0, field1[i] - field0[i]
    if not rigid:
        return
    pose, ride, curl, lean = np.empty((4, 4)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    ridden = np.empty(6)
    ahead_into(end, start, pose)
    adjoint_into(pose, ride)
    apply_into(ride, field0, ridden)
    ad_into(field0, curl)
    times_into(ride, curl, lean)
    ad_into(ridden, curl)
    for i in range(6):
        error[i] = field1[i] - ridden[i]
        for j in range(6):
            j0[i, j], j0[i, at + j], j1[i, j] = lean[i, j], -ride[i, j], -curl[i, j]


@jit
def weighted_steps(
    pose, rates, fields, about, nodes, step, weight, psd, carried_psd, jump, at, carried_at, rigid
):
    """Errors of pair and carried, Jacobians (M, r, 2, 18) and whiteners (M, r, r)."""
    m = len(step)
    error, lost = np.empty((m, 12)), np.empty((m, 6))
    slopes, lost_slopes = np.zeros((m, 12, 2, 18)), np.empty((m, 6, 2, 18))
    info, lost_info = np.zeros((m, 12, 12)), np.empty((m, 6, 6))
    back, pull, spread = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    c0, c1, middle = np.empty((6, 18)), np.empty((6, 18)), np.empty(6)
    cov, carried_cov = np.empty((12, 12)), np.empty((6, 6))
    for n in range(m):
        a, b, h = nodes[n, 0], nodes[n, 1], step[n]
        _pair(pose[a], pose[b], rates[a], rates[b], h, error[n], back, pull, spread)
        _carried(pose[a], pose[b], fields[a], fields[b], carried_at, rigid, lost[n], c0, c1)
        for i in range(6):
            for j in range(6):
                slopes[n, i, 0, j], slopes[n, i, 0, at + j] = back[i, j], pull[i, j]
                slopes[n, i, 1, j] = spread[i, j]
            slopes[n, 6 + i, 0, at + i], slopes[n, 6 + i, 1, at + i] = -1.0, 1.0
            for j in range(18):
                lost_slopes[n, i, 0, j], lost_slopes[n, i, 1, j] = c0[i, j], c1[i, j]
        middle_into(about[a], about[b], h, psd[n], jump[n], middle)
        process_into(middle, h, psd[n], carried_psd[n], jump[n], rigid, cov, carried_cov)
        pair_whiten_into(cov, info[n])
        whiten_into(carried_cov, lost_info[n])
        for i in range(12):
            for j in range(12):
                info[n, i, j] *= weight[n]
        for i in range(6):
            for j in range(6):
                lost_info[n, i, j] *= weight[n]
    return error, slopes, info, lost, lost_slopes, lost_info


@jit
def _spread_out(turn, cov, carried_cov, at, carried_at, left):
    """Bridge covariance (18, 18) at a point whose pose is turned by `turn`, into zeros."""
    half = np.zeros((6, 12))
    for i in range(6):
        for k in range(6):
            for j in range(12):
                half[i, j] += turn[i, k] * cov[k, j]
    for i in range(6):
        for j in range(6):
            for k in range(6):
                left[i, j] += half[i, k] * turn[j, k]
            left[i, at + j] = left[at + j, i] = half[i, 6 + j]
            left[at + i, at + j] = cov[6 + i, 6 + j]
            left[carried_at + i, carried_at + j] = carried_cov[i, j]


@jit
def _lean(curl, at, rows):
    """What rides turns with the pose at the point."""
    for i in range(6):
        for k in range(6):
            for j in range(rows.shape[1]):
                rows[at + i, j] += curl[i, k] * rows[k, j]


@jit
def _onward(start, rate, offset, delta, pose, turn, back, pull):
    """Pose at `offset` along a rate from `start` and then bent by `delta` (6,), and its slopes.

    By the bend (`turn`), the start (`back`) and the rate (`pull`), all (6, 6).
    """
    ahead, bend, there = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    unbend, a = np.empty((6, 6)), np.empty((6, 6))
    scaled = offset * rate
    exp_into(scaled, ahead)
    exp_into(delta, bend)
    compose_into(start, ahead, there)
    compose_into(there, bend, pose)
    right_jacobian_into(delta, turn)
    adjoint_back_into(bend, unbend)
    adjoint_back_into(ahead, a)
    times_into(unbend, a, back)
    right_jacobian_into(scaled, a)
    times_into(unbend, a, pull)
    pull *= offset


@jit
def _spread(turn, gain, e, carried_gain, c, at, carried_at, d, out):
    """Slope (18, 18) at the point by one end, through the errors of the step, into zeros."""
    matmul_into(gain, e, d)
    for i in range(6):
        for k in range(6):
            for j in range(18):
                out[i, j] += turn[i, k] * d[k, j]
                out[carried_at + i, j] += carried_gain[i, k] * c[k, j]
        for j in range(18):
            out[at + i, j] += d[6 + i, j]


@jit
def _ride(pose, start, field0, at, field, j0, j1, left):
    """Add the field that rides from the start of a step to a pose, which turns it."""
    there, ride = np.empty((4, 4)), np.empty((6, 6))
    curl, lean, ridden = np.empty((6, 6)), np.empty((6, 6)), np.empty(6)
    ahead_into(pose, start, there)
    adjoint_into(there, ride)
    apply_into(ride, field0, ridden)
    ad_into(field0, curl)
    times_into(ride, curl, lean)
    for i in range(6):
        field[i] += ridden[i]
        for j in range(6):
            j0[at + i, j] -= lean[i, j]
            j0[at + i, at + j] += ride[i, j]
    ad_into(ridden, curl)
    _lean(curl, at, j0)
    _lean(curl, at, j1)
    _lean(curl, at, left)
    _lean(curl, at, left.T)


@jit
def between(
    start, end, rate0, rate1, field0, field1, step, offset, gain, cov, carried_gain, carried_cov,
    at, carried_at, rigid,
):  # fmt: skip
    """States between nodes, Jacobians (M, 18, 18) at both ends, bridge covariances."""
    m = len(step)
    pose, rate, field = np.empty((m, 4, 4)), np.empty((m, 6)), np.empty((m, 6))
    j0, j1, left = np.zeros((m, 18, 18)), np.zeros((m, 18, 18)), np.zeros((m, 18, 18))
    error, lost, delta, d = np.empty(12), np.empty(6), np.empty(12), np.empty((12, 18))
    back, pull, turn = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    e0, e1 = np.zeros((12, 18)), np.zeros((12, 18))
    c0, c1 = np.empty((6, 18)), np.empty((6, 18))
    for n in range(m):
        _pair(start[n], end[n], rate0[n], rate1[n], step[n], error, back, pull, turn)
        for i in range(6):
            for j in range(6):
                e0[i, j], e0[i, at + j], e1[i, j] = back[i, j], pull[i, j], turn[i, j]
            e0[6 + i, at + i], e1[6 + i, at + i] = -1.0, 1.0
        _carried(start[n], end[n], field0[n], field1[n], carried_at, rigid, lost, c0, c1)
        apply_into(gain[n], error, delta)
        apply_into(carried_gain[n], lost, field[n])
        _onward(start[n], rate0[n], offset[n], delta[:6], pose[n], turn, back, pull)
        _spread(turn, gain[n], e0, carried_gain[n], c0, at, carried_at, d, j0[n])
        _spread(turn, gain[n], e1, carried_gain[n], c1, at, carried_at, d, j1[n])
        for i in range(6):
            rate[n, i] = rate0[n, i] + delta[6 + i]
            for j in range(6):
                j0[n, i, j] += back[i, j]
                j0[n, i, at + j] += pull[i, j]
            j0[n, at + i, at + i] += 1.0
        _spread_out(turn, cov[n], carried_cov[n], at, carried_at, left[n])
        if rigid:
            _ride(pose[n], start[n], field0[n], carried_at, field[n], j0[n], j1[n], left[n])
            continue
        for i in range(6):
            field[n, i] += field0[n, i]
            j0[n, carried_at + i, carried_at + i] += 1.0
    return pose, rate, field, j0, j1, left
