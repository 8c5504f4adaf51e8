"""Errors of arclength intervals, states inside them, and rates. Source: (2'), (9), (10)."""

from __future__ import annotations

import numpy as np

from glissando._kernels.blas import product
from glissando._kernels.jit import jit
from glissando._kernels.lie import (
    ad_into,
    adjoint_back_into,
    ahead_into,
    compose_into,
    exp_into,
    log_into,
    right_jacobian_into,
    right_jacobian_inverse_into,
    slope_into,
    times_into,
)
from glissando._kernels.process import apply_into
from glissando._kernels.scratch import matrix, vector, zero_matrix


@jit()
def _scaled(factor, x, out):
    """A six-vector times a number."""
    for i in range(6):
        out[i] = factor * x[i]


@jit()
def _put(out, row, column, block, sign):
    """Write a block (6, 6), times a sign, at a row and column."""
    for i in range(6):
        for j in range(6):
            out[row + i, column + j] = sign * block[i, j]


@jit()
def _error(pose0, pose1, fields0, fields1, step, error, j0, j1):
    """Error [r; ṙ] (24,) of an interval between nodes of `fields` (18,); Jacobians into zeros."""
    x, drawn, carried = vector(6), vector(6), vector(6)
    ahead, miss, pose = matrix(4, 4), matrix(4, 4), matrix(4, 4)
    spread, stretch, pull = matrix(6, 6), matrix(6, 6), matrix(6, 6)
    back, unmiss = matrix(6, 6), matrix(6, 6)
    strain0, velocity0, rate0 = fields0[:6], fields0[6:12], fields0[12:]
    ahead_into(pose0, pose1, ahead)
    scaled = vector(6)
    _scaled(-step, strain0, scaled)
    exp_into(scaled, pose)
    compose_into(pose, ahead, miss)
    xi, xi_rate = error[:6], error[12:18]
    log_into(miss, xi)
    right_jacobian_inverse_into(xi, spread)
    _scaled(step, strain0, scaled)
    right_jacobian_into(scaled, stretch)
    adjoint_back_into(ahead, back)
    adjoint_back_into(miss, unmiss)
    times_into(unmiss, stretch, pull)
    for i in range(6):
        for j in range(6):
            pull[i, j] *= step
    apply_into(back, velocity0, carried)
    apply_into(pull, rate0, drawn)
    for i in range(6):
        x[i] = fields1[6 + i] - carried[i] - drawn[i]
        error[6 + i] = fields1[i] - strain0[i]
        error[18 + i] = fields1[12 + i] - rate0[i]
    apply_into(spread, x, xi_rate)
    _error_slopes(
        xi, xi_rate, scaled, rate0, step, spread, back, pull, unmiss, drawn, carried, j0, j1
    )


@jit()
def _error_slopes(
    xi, xi_rate, scaled, rate0, step, spread, back, pull, unmiss, drawn, carried, j0, j1
):
    """Jacobians (24, 24) of `_error` by both nodes, from its intermediate results, into zeros."""
    slope, by_miss, by_ahead = matrix(6, 6), matrix(6, 6), matrix(6, 6)
    a, b = matrix(6, 6), matrix(6, 6)
    times_into(spread, back, a)
    _put(j0, 0, 0, a, -1.0)
    _put(j0, 12, 12, a, -1.0)
    times_into(spread, pull, a)
    _put(j0, 0, 6, a, -1.0)
    _put(j0, 12, 18, a, -1.0)
    _put(j1, 0, 0, spread, 1.0)
    _put(j1, 12, 12, spread, 1.0)
    slope_into(xi, xi_rate, slope)
    product(spread, slope, a, 1.0, 0.0, False, False)
    product(a, spread, by_miss, 1.0, 0.0, False, False)
    ad_into(drawn, b)
    times_into(spread, b, a)
    for i in range(6):
        for j in range(6):
            by_miss[i, j] = -by_miss[i, j] - a[i, j]
    ad_into(carried, b)
    times_into(spread, b, a)
    for i in range(6):
        for j in range(6):
            by_ahead[i, j] = by_miss[i, j] - a[i, j]
    _put(j1, 12, 0, by_ahead, 1.0)
    product(by_ahead, back, a, 1.0, 0.0, False, False)
    _put(j0, 12, 0, a, -1.0)
    slope_into(scaled, rate0, slope)
    times_into(spread, unmiss, a)
    product(a, slope, b, 1.0, 0.0, False, False)
    product(by_miss, pull, a, 1.0, 0.0, False, False)
    for i in range(6):
        for j in range(6):
            a[i, j] += step * step * b[i, j]
    _put(j0, 12, 6, a, -1.0)
    for i in range(6):
        j0[6 + i, 6 + i] = j0[18 + i, 18 + i] = -1.0
        j1[6 + i, 6 + i] = j1[18 + i, 18 + i] = 1.0


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[::1])")
def interval_error(pose0, pose1, fields0, fields1, step):
    """Errors (M, 24) of intervals, Jacobians (M, 24, 24) by both ends."""
    m = len(step)
    error, j0, j1 = np.empty((m, 24)), np.zeros((m, 24, 24)), np.zeros((m, 24, 24))
    for n in range(m):
        _error(pose0[n], pose1[n], fields0[n], fields1[n], step[n], error[n], j0[n], j1[n])
    return error, j0, j1


@jit()
def _jacobian_through_error(gain, turn, curl, e, d, out):
    """Jacobian (24, 24) at the point by one end, through the interval's error."""
    for half in (0, 12):
        product(gain, e[half : half + 12], d[half : half + 12], 1.0, 0.0, False, False)
    for i in range(6):
        for j in range(24):
            out[6 + i, j], out[18 + i, j] = d[6 + i, j], d[18 + i, j]
            pose = rate = 0.0
            for k in range(6):
                pose += turn[i, k] * d[k, j]
                rate += curl[i, k] * d[k, j] + turn[i, k] * d[12 + k, j]
            out[i, j], out[12 + i, j] = pose, rate


@jit()
def _add_own_slopes(u, scaled, rate0, carried, stretch, unbend, back, j0):
    """Add the Jacobian (24, 24) at the point by its lower end at a fixed error."""
    a, b, slope = matrix(6, 6), matrix(6, 6), matrix(6, 6)
    ad_into(carried, a)
    times_into(a, stretch, b)
    slope_into(scaled, rate0, slope)
    for i in range(6):
        for j in range(6):
            b[i, j] += u * u * slope[i, j]
    product(unbend, b, slope, 1.0, 0.0, False, False)
    times_into(unbend, back, a)
    times_into(unbend, stretch, b)
    for i in range(6):
        for j in range(6):
            j0[i, j] += a[i, j]
            j0[12 + i, 12 + j] += a[i, j]
            j0[i, 6 + j] += b[i, j]
            j0[12 + i, 18 + j] += b[i, j]
            j0[12 + i, 6 + j] += slope[i, j]
        j0[6 + i, 6 + i] += 1.0
        j0[18 + i, 18 + i] += 1.0


@jit(
    "(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,:,::1], f8[:,::1],"
    " f8[:,::1])"
)
def interval_between(pose0, pose1, fields0, fields1, step, offset, gain, whole, part):
    """Poses, fields (M, 18) and Jacobians (M, 24, 24) by both ends, of points in intervals."""
    m = len(step)
    pose, fields = np.empty((m, 4, 4)), np.empty((m, 18))
    j0, j1 = np.empty((m, 24, 24)), np.empty((m, 24, 24))
    error, e0, e1, d = vector(24), zero_matrix(24, 24), zero_matrix(24, 24), matrix(24, 24)
    still, moving, off, carried = vector(12), vector(12), vector(12), vector(6)
    scaled = vector(6)
    x, after = vector(6), vector(6)
    ahead, bend, point = matrix(4, 4), matrix(4, 4), matrix(4, 4)
    stretch, turn, curl = matrix(6, 6), matrix(6, 6), matrix(6, 6)
    back, unbend, slope = matrix(6, 6), matrix(6, 6), matrix(6, 6)
    a = matrix(6, 6)
    for n in range(m):
        u, strain0, rate0 = offset[n], fields0[n, :6], fields0[n, 12:]
        _error(pose0[n], pose1[n], fields0[n], fields1[n], step[n], error, e0, e1)
        for i in range(12):
            off[i] = error[i] - whole[n, i]
        apply_into(gain[n], off, still)
        for i in range(12):
            still[i] += part[n, i]
        apply_into(gain[n], error[12:], moving)
        _scaled(u, strain0, scaled)
        exp_into(scaled, ahead)
        exp_into(still[:6], bend)
        compose_into(pose0[n], ahead, point)
        compose_into(point, bend, pose[n])
        right_jacobian_into(scaled, stretch)
        for i in range(6):
            for j in range(6):
                stretch[i, j] *= u
        right_jacobian_into(still[:6], turn)
        adjoint_back_into(ahead, back)
        adjoint_back_into(bend, unbend)
        apply_into(back, fields0[n, 6:12], carried)
        apply_into(stretch, rate0, x)
        for i in range(6):
            x[i] += carried[i]
        apply_into(unbend, x, after)
        apply_into(turn, moving[:6], x)
        for i in range(6):
            fields[n, i] = strain0[i] + still[6 + i]
            fields[n, 6 + i] = after[i] + x[i]
            fields[n, 12 + i] = rate0[i] + moving[6 + i]
        ad_into(after, a)
        times_into(a, turn, curl)
        slope_into(still[:6], moving[:6], slope)
        for i in range(6):
            for j in range(6):
                curl[i, j] += slope[i, j]
        _jacobian_through_error(gain[n], turn, curl, e0, d, j0[n])
        _jacobian_through_error(gain[n], turn, curl, e1, d, j1[n])
        _add_own_slopes(u, scaled, rate0, carried, stretch, unbend, back, j0[n])
    return pose, fields, j0, j1
