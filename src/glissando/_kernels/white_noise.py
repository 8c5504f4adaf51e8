"""The white-noise prior on a grid: sums of its factors, and of readings between its nodes.

Nodes are (K, N) of time and arclength; `along` (N−1, 3, 6) and `through` (K−1, 3, 6) are densities
of the steps between them: of the moving field, of the carried one, and the variance of a jump.
`spans` are those that nodes represent. Source: equations (3') to (5), (10) to (13).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from glissando._kernels.blas import copy_into
from glissando._kernels.jit import jit
from glissando._kernels.lie import ahead_into, log_into, right_jacobian_inverse_into
from glissando._kernels.normal_equations import SUMS, add_factor, at_nodes_into
from glissando._kernels.process import apply_into
from glissando._kernels.scratch import cube, matrix, vector, zero_cube, zero_matrix
from glissando._kernels.sensors import sense_into
from glissando._kernels.steps import step_into
from glissando._kernels.white_noise_points import STATE, lines, point_into

_NEAR = 1e-9  # of a step: points that close to a node lie on it
_UNKNOWN = np.False_  # not a literal, for which numba would compile points a second time
HUBER, GEMAN_MCCLURE = 1.0, 2.0
"""Numbers of robust losses in the rows of readings; zero stands for none."""
WIDTH = 21
"""Length of a row."""


@jit()
def _base_into(pose, strain, velocity, base_pose, rest, error, slopes):
    """Error (18,) of the base from its expected state; Jacobian (18, 1, 18) into zeros."""
    apart, spread = matrix(4, 4), matrix(6, 6)
    ahead_into(base_pose, pose, apart)
    log_into(apart, error[:6])
    right_jacobian_inverse_into(error[:6], spread)
    for i in range(6):
        error[6 + i], error[12 + i] = strain[i] - rest[i], velocity[i]
        slopes[6 + i, 0, 6 + i] = slopes[12 + i, 0, 12 + i] = 1.0
        for j in range(6):
            slopes[i, 0, j] = spread[i, j]


@jit(
    f"(f8[::1], f8[::1], f8[::1], f8[::1], {STATE}, f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[::1],"
    f" f8[::1], {SUMS})"
)
def add_prior(
    arclength, time, arclength_spans, time_spans, pose, strain, velocity, along, through,
    base_pose, rest, base, begin, end, across, rhs_begin, rhs_end,
):  # fmt: skip
    """Add all factors between nodes, and of the base if its densities (18,) are not empty."""
    k_count, n_count = strain.shape[:2]
    error, slopes, info = vector(12), zero_cube(12, 2, 18), zero_matrix(12, 12)
    lost, lost_slopes, lost_info = vector(6), cube(6, 2, 18), matrix(6, 6)
    base_error, base_slopes, base_info = vector(18), zero_cube(18, 1, 18), zero_matrix(18, 18)
    room, none, node = np.empty((8, 4), np.int64), matrix(18, 0), np.empty(2, np.int64)
    a, b, miss, square = matrix(18, 36), matrix(18, 36), vector(18), matrix(36, 36)
    for k in range(k_count):
        for rigid in (True, False):
            count = n_count - 1 if rigid else n_count if k + 1 < k_count else 0
            rates, fields = (strain, velocity) if rigid else (velocity, strain)
            for n in range(count):
                j, m = (k, n + 1) if rigid else (k + 1, n)
                step = arclength[m] - arclength[n] if rigid else time[j] - time[k]
                weight = sqrt(time_spans[k] if rigid else arclength_spans[n])
                density = along[n] if rigid else through[k]
                node[0], node[1] = k * n_count + n, j * n_count + m
                slopes[:], info[:] = 0.0, 0.0
                step_into(
                    pose[k, n], pose[j, m], rates[k, n], rates[j, m], fields[k, n], fields[j, m],
                    rates[k, n], rates[j, m], step, weight, density[0], density[1], density[2],
                    rigid, error, slopes, info, lost, lost_slopes, lost_info,
                )  # fmt: skip
                add_factor(
                    node, 0, slopes, error, info, none[:12], 1.0, n_count, 18, begin, end, across,
                    rhs_begin, rhs_end, a[:12], b[:12], miss[:12], square, room,
                )  # fmt: skip
                add_factor(
                    node, 0, lost_slopes, lost, lost_info, none[:6], 1.0, n_count, 18, begin, end,
                    across, rhs_begin, rhs_end, a[:6], b[:6], miss[:6], square, room,
                )  # fmt: skip
        if base.size:
            _base_into(
                pose[k, 0], strain[k, 0], velocity[k, 0], base_pose, rest, base_error, base_slopes
            )
            for i in range(18):
                base_info[i, i] = sqrt(time_spans[k] / base[i])
            node[0] = k * n_count
            add_factor(
                node[:1], 0, base_slopes, base_error, base_info, none, 1.0, n_count, 18, begin,
                end, across, rhs_begin, rhs_end, a, b, miss, square, room,
            )  # fmt: skip


@jit()
def _cell(nodes, value):
    """Lower node, step and offset of a value among nodes; one next to a node is put on it."""
    if len(nodes) == 1:
        return 0, 0.0, 0.0
    n = 0
    while n < len(nodes) - 2 and value >= nodes[n + 1]:
        n += 1
    step = nodes[n + 1] - nodes[n]
    offset = min(max(value - nodes[n], 0.0), step)
    if offset < _NEAR * step:
        offset = 0.0
    if step - offset < _NEAR * step:
        offset = step
    return n, step, offset


@jit()
def _weight(loss, threshold, whitener, residual):
    """Robust weight of a reading."""
    if loss == 0.0:
        return 1.0
    white = vector(6)
    apply_into(whitener, residual, white)
    norm = 0.0
    for i in range(6):
        norm += white[i] * white[i]
    norm = sqrt(norm) / threshold
    return 1.0 / max(norm, 1.0) if loss == HUBER else 1.0 / (1.0 + norm * norm) ** 2


@jit(
    "(f8[:,::1], f8[:,:,::1], f8[:,:,::1], i8, i8, f8, f8, f8[::1], f8[::1], f8[::1], f8[:,:,::1],"
    " f8[:,:,::1])"
)
def write_rows(
    rows, mounts, covs, first, sensor, loss, threshold, time, arclength, values, mount, cov
):  # fmt: skip
    """Write readings of a sensor as rows from `first` on; one mount and covariance, or one each."""
    m, r = len(time), cov.shape[1]
    width = len(values) // m
    for i in range(m):
        row, own = rows[first + i], covs[first + i]
        row[0], row[1], row[2], row[3], row[4] = time[i], arclength[i], sensor, loss, threshold
        for j in range(width):
            row[5 + j] = values[i * width + j]
        spread = cov[min(i, len(cov) - 1)]
        copy_into(mount[min(i, len(mount) - 1)], mounts[first + i])
        for j in range(6):
            for k in range(6):
                own[j, k] = spread[j, k] if j < r and k < r else 1.0 if j == k else 0.0


@jit(
    "(f8[:,::1], f8[:,:,::1], f8[:,:,::1], i8[::1], f8[::1], f8[::1], f8[::1], f8[::1],"
    f" {STATE}, f8[:,:,::1], f8[:,:,::1], {SUMS})"
)
def add_readings(
    rows, mounts, covs, which, arclength, time, arclength_spans, time_spans, pose, strain, velocity,
    along, through, begin, end, across, rhs_begin, rhs_end,
):  # fmt: skip
    """Add the factors of readings, and return them.

    A row (21,) is time, arclength, sensor, loss and its threshold, then the values; `mounts` are
    (·, 4, 4) and `covs` (·, 6, 6). Factors of the rows `which` (M,) are returned: nodes (M, 4),
    Jacobians (M, 6, 4, 18), residuals (M, 6), whiteners (M, 6, 6) and robust weights (M,); unused
    nodes and residuals are zero.
    """
    m, n_count = len(which), len(arclength)
    nodes, slopes = np.zeros((m, 4), np.int64), np.zeros((m, 6, 4, 18))
    residual, whitener, weight = np.zeros((m, 6)), np.empty((m, 6, 6)), np.empty(m)
    point, bend, motion = matrix(4, 4), vector(6), vector(6)
    a, b, miss, square = matrix(6, 72), matrix(6, 72), vector(6), matrix(72, 72)
    room, none, cell = np.empty((14, 4), np.int64), matrix(6, 0), lines()
    for i in range(m):
        row, at = rows[which[i]], which[i]
        jacobian, left, by_state = zero_cube(18, 4, 18), zero_matrix(18, 18), zero_matrix(6, 18)
        n, ds, us = _cell(arclength, row[1])
        k, dt, ut = _cell(time, row[0])
        point_into(
            n, ds, us, k, dt, ut, pose, strain, velocity, strain, velocity, along, through,
            arclength_spans, time_spans, cell, _UNKNOWN, point, bend, motion, nodes[i], jacobian,
            left,
        )  # fmt: skip
        sense_into(
            int(row[2]), row[5:], mounts[at], point, bend, motion, residual[i], by_state
        )  # fmt: skip
        at_nodes_into(by_state, jacobian, left, covs[at], slopes[i], whitener[i])
        weight[i] = _weight(row[3], row[4], whitener[i], residual[i])
        add_factor(
            nodes[i], 0, slopes[i], residual[i], whitener[i], none, weight[i], n_count,
            18, begin, end, across, rhs_begin, rhs_end, a, b, miss, square,
            room,
        )  # fmt: skip
    return nodes, slopes, residual, whitener, weight
