"""Noise of intervals, bridges inside them, whitening. Source: equations (2'), (3') and (12)."""

from __future__ import annotations

from math import sqrt

import numpy as np

from glissando._kernels.blas import product
from glissando._kernels.jit import jit
from glissando._kernels.lie import (
    ad_into,
    adjoint_into,
    exp_into,
    jacobian_coefficients,
    right_jacobian_into,
    squared_angle,
    times_into,
)
from glissando._kernels.scratch import cube, matrix, vector, zero_matrix, zero_vector

_RULES = [np.polynomial.legendre.leggauss(n) for n in (4, 5, 6)]
_NODES = np.array([np.resize(0.5 * (nodes + 1.0), 6) for nodes, _ in _RULES])
_WEIGHTS = np.array([np.resize(0.5 * weights, 6) for _, weights in _RULES])
SMALL = 48  # rows of a matrix up to which elimination by rows is faster than by halves
_ZERO, _ONE, _TWO = (np.uint64(i) for i in range(3))  # need no check of bounds
_FEW, _SOME = 0.02**2, 0.2**2  # squared angles up to which 4 and 5 nodes err by less than 1e-12


@jit(inline=True)
def apply_into(a, x, out):
    """The product of a matrix and a vector, into `out`."""
    for i in range(a.shape[0]):
        out[i] = 0.0
        for k in range(a.shape[1]):
            out[i] += a[i, k] * x[k]


@jit()
def whiten_into(cov, out):
    """W with Wᵀ W = cov⁻¹, lower triangular: the inverse of the Cholesky factor."""
    if not inverse_root_into(cov, out):
        raise np.linalg.LinAlgError("Matrix is not positive definite")


@jit()
def inverse_root_into(cov, out):
    """Compute the W of `whiten_into`; returns whether `cov` is positive definite.

    It raises no exception, which would leak a kernel's arrays. Only the lower triangle is read.
    """
    if len(cov) > SMALL:
        return _eliminate(cov, np.empty(cov.shape), out)
    return _eliminate(cov, matrix(SMALL, SMALL), out)


@jit()
def _eliminate(cov, room, out):
    """Eliminate [A, 1], two pivots at a time; returns whether all of them are positive.

    Row j of `room` holds L⁻¹ before column j and the remainder of A from there on. Whole rows are
    added, which is faster than adding their non-zero parts: the entries between are overwritten
    when their column is eliminated.
    """
    n = np.uint64(len(cov))
    for j in range(n):
        for i in range(n):
            room[j, i] = cov[i, j] if i >= j else 0.0
    for first in range(_ZERO, n, _TWO):
        second = first + _ONE
        pivot = room[first, first]
        if not pivot > 0.0:
            return False
        inverse, root = -1.0 / pivot, 1.0 / sqrt(pivot)
        room[first, first] = 1.0
        if second < n:
            across = room[first, second] * inverse
            for x in range(n):
                room[second, x] += across * room[first, x]
            room[second, first], pivot = across, room[second, second]
            if not pivot > 0.0:
                return False
            later, room[second, second] = -1.0 / pivot, 1.0
            for i in range(second + _ONE, n):
                a, b = room[first, i] * inverse, room[second, i] * later
                for x in range(n):
                    room[i, x] += a * room[first, x] + b * room[second, x]
                room[i, first], room[i, second] = a + b * across, b
            _row_into(second, n, 1.0 / sqrt(pivot), room, out)
        _row_into(first, n, root, room, out)
    return True


@jit(inline=True)
def _row_into(row, count, root, room, out):
    """Write a row of the inverse, scaled, and zeros beyond the diagonal."""
    for x in range(count):
        out[row, x] = root * room[row, x] if x <= row else 0.0


@jit(inline=True)
def _add_square(turn, density, weight, out):
    """Add weight · M diag(density) Mᵀ of M = [A B; 0 A] to the lower triangle of `out` (6, 6)."""
    for i in range(3):
        for j in range(3):
            top = corner = low = 0.0
            for k in range(3):
                scaled = turn[i, k] * density[3 + k]
                top += turn[i, k] * density[k] * turn[j, k]
                top += turn[i, 3 + k] * density[3 + k] * turn[j, 3 + k]
                corner += scaled * turn[j, 3 + k]
                low += scaled * turn[j, k]
            out[3 + i, j] += weight * corner
            if j <= i:
                out[i, j] += weight * top
                out[3 + i, 3 + j] += weight * low


@jit()
def process_into(rate, step, psd, carried_psd, jump, rigid, cov, carried):
    """Process noise of an interval; `cov` (12, 12) and `carried` (6, 6) are written."""
    m, m2, m3, m4 = matrix(6, 6), matrix(6, 6), matrix(6, 6), matrix(6, 6)
    lever, transport, mean, angle = matrix(6, 6), matrix(6, 6), zero_vector(5), squared_angle(rate)
    for i in range(6):
        for j in range(6):
            cov[i, j] = cov[6 + i, 6 + j] = carried[i, j] = 0.0
    ad_into(rate, m)
    times_into(m, m, m2)
    times_into(m2, m, m3)
    times_into(m2, m2, m4)
    turn = step * step * angle
    rule = 0 if turn < _FEW else 1 if turn < _SOME else 2
    for n in range(4 + rule):
        u, weight = step * _NODES[rule, n], step * _WEIGHTS[rule, n]
        c1, c2, c3, c4 = jacobian_coefficients(u * u * angle)
        c1, c2, c3, c4 = c1 * u, c2 * u**2, c3 * u**3, c4 * u**4
        for i in range(3):
            for j in range(6):
                lever[i, j] = c1 * m[i, j] + c2 * m2[i, j] + c3 * m3[i, j] + c4 * m4[i, j]
            lever[i, i] += 1.0
        _add_square(lever, psd, weight * u * u, cov)
        mean[0] += weight * u
        mean[1] += weight * u * c1
        mean[2] += weight * u * c2
        mean[3] += weight * u * c3
        mean[4] += weight * u * c4
        if rigid:  # exp(−u ad) = 1 − u ad J_r(u rate)
            times_into(m, lever, transport)
            for i in range(3):
                for j in range(6):
                    transport[i, j] = (i == j) - u * transport[i, j]
            _add_square(transport, carried_psd, weight, carried)
    for i in range(6):
        for j in range(6):
            value = mean[1] * m[i, j] + mean[2] * m2[i, j] + mean[3] * m3[i, j] + mean[4] * m4[i, j]
            cov[i, 6 + j] = cov[6 + j, i] = ((i == j) * mean[0] + value) * psd[j]
            if j > i:
                cov[i, j], carried[i, j] = cov[j, i], carried[j, i]
        cov[6 + i, 6 + i] = step * psd[i] + jump[i]
        if not rigid:
            carried[i, i] = step * carried_psd[i]


@jit()
def middle_into(rate0, rate1, step, psd, jump, out):
    """Rate (6,) about which a step is linearised: the mean without the expected jump."""
    for i in range(6):
        share = 0.5 * step * psd[i] / (step * psd[i] + jump[i])
        out[i] = rate0[i] + share * (rate1[i] - rate0[i])


@jit()
def _condition(near, cross, root, gain, cov):
    """Gain = crossᵀ whole⁻¹ and cov = near − gain cross, with the whitener `root` of whole."""
    n = len(near)
    half = np.empty((n, n))
    product(root, cross, half, 1.0, 0.0, False, False)
    product(half, root, gain, 1.0, 0.0, True, False)
    for i in range(n):
        for j in range(n):
            cov[i, j] = near[i, j]
    product(half, half, cov, -1.0, 1.0, True, False)


@jit()
def transition_of_pair_into(rate, step, out):
    """Φ(step) (12, 12) of [pose error, rate error] about a constant rate."""
    x, pose, block = vector(6), matrix(4, 4), matrix(6, 6)
    for j in range(6):
        x[j] = step * rate[j]
    right_jacobian_into(x, block)
    for i in range(6):
        x[i] = -x[i]
        for j in range(6):
            out[i, 6 + j], out[6 + i, j] = step * block[i, j], 0.0
            out[6 + i, 6 + j] = 1.0 if i == j else 0.0
    exp_into(x, pose)
    adjoint_into(pose, block)
    for i in range(6):
        for j in range(6):
            out[i, j] = block[i, j]


@jit()
def bridge_into(
    rate, step, offset, psd, carried_psd, jump, rigid, gain, cov, carried_gain, carried_cov
):
    """Gains and bridge covariances at `offset` in a step: pair (12, 12), carried field (6, 6)."""
    rest, jumps, phi = step - offset, zero_matrix(2, 6), matrix(12, 12)
    noise, carried, cross = cube(2, 12, 12), cube(2, 6, 6), matrix(12, 12)
    root, root6, cross6 = zero_matrix(12, 12), matrix(6, 6), matrix(6, 6)
    transition_of_pair_into(rate, rest, phi)
    for j in range(6):
        jumps[1, j] = jump[j]
    for i in range(2):  # up to the point, and of the whole step
        process_into(
            rate, step if i else offset, psd, carried_psd, jumps[i], rigid, noise[i], carried[i]
        )
    product(phi, noise[0], cross, 1.0, 0.0, False, False)
    pair_whiten_into(noise[1], root)
    _condition(noise[0], cross, root, gain, cov)
    if rigid:
        product(phi[0:6, 0:6], carried[0], cross6, 1.0, 0.0, False, False)
        whiten_into(carried[1], root6)
        _condition(carried[0], cross6, root6, carried_gain, carried_cov)
        return
    for j in range(6):
        for k in range(6):
            carried_gain[j, k] = carried_cov[j, k] = 0.0
        carried_gain[j, j] = offset / step
        carried_cov[j, j] = carried[0, j, j] * rest / step


@jit("(f8[:,:,::1],)")
def sqrt_information(cov):
    """Whiteners (M, r, r) of covariances."""
    out = np.empty(cov.shape)
    for i in range(len(cov)):
        whiten_into(cov[i], out[i])
    return out


@jit()
def pair_whiten_into(cov, out):
    """Whitener (12, 12) of a covariance whose last block is diagonal, into zeros."""
    corner, root, slope = matrix(6, 6), matrix(6, 6), matrix(6, 6)
    for j in range(6):
        spread = 1.0 / cov[6 + j, 6 + j]
        out[6 + j, 6 + j] = sqrt(spread)
        for i in range(6):
            slope[i, j] = cov[i, 6 + j] * spread
    for i in range(6):
        for j in range(i + 1):
            corner[i, j] = cov[i, j]
            for k in range(6):
                corner[i, j] -= slope[i, k] * cov[j, 6 + k]
    whiten_into(corner, root)
    for i in range(6):
        for j in range(6):
            out[i, j] = root[i, j]
            for k in range(i + 1):
                out[i, 6 + j] -= root[i, k] * slope[k, j]
