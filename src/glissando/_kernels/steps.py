"""Errors of steps between two nodes, and states inside steps.

A step goes along arclength, where the pose moves by its strain and the velocity is carried rigidly,
or along time, where the pose moves by its velocity and the strain stays: `rigid` says which. `at`
and `carried_at` are the first columns of the moving and of the carried field. Source: equations
(2') to (4), (10).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.blas import product
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
    bridge_into,
    middle_into,
    pair_whiten_into,
    process_into,
    whiten_into,
)
from glissando._kernels.rolls import transversely_isotropic, turn_back, turn_on
from glissando._kernels.scratch import matrix, vector

RIGID, FREE = np.True_, np.False_  # not literals, for which numba would compile a second time


@jit()
def pair_into(start, end, rate0, rate1, step, error, back, pull, spread):
    """Error (12,) of a step in the order [pose, rate], and blocks (6, 6) of its Jacobians.

    These are [back, pull; 0, −1] by the start and [spread, 0; 0, 1] by the end.
    """
    scaled, xi = vector(6), vector(6)
    ahead, miss, pose = matrix(4, 4), matrix(4, 4), matrix(4, 4)
    a, b = matrix(6, 6), matrix(6, 6)
    for i in range(6):
        scaled[i] = -step * rate0[i]
    ahead_into(start, end, ahead)
    exp_into(scaled, pose)
    compose_into(pose, ahead, miss)
    log_into(miss, xi)
    right_jacobian_inverse_into(xi, spread)
    adjoint_back_into(ahead, a)
    times_into(spread, a, back)
    adjoint_back_into(miss, a)
    times_into(spread, a, b)
    for i in range(6):
        scaled[i] = step * rate0[i]
    right_jacobian_into(scaled, a)
    times_into(b, a, pull)
    for i in range(6):
        error[i], error[6 + i] = xi[i], rate1[i] - rate0[i]
        for j in range(6):
            back[i, j] *= -1.0
            pull[i, j] *= -step


@jit()
def _carried(start, end, field0, field1, at, rigid, error, j0, j1):
    """Error (6,) of the carried field and its Jacobians (6, 18), which are written."""
    for i in range(6):
        for j in range(18):
            j0[i, j] = j1[i, j] = 0.0
    for i in range(6):
        j1[i, at + i] = 1.0
        if not rigid:
            j0[i, at + i], error[i] = -1.0, field1[i] - field0[i]
    if not rigid:
        return
    pose, transport, curl, lean = matrix(4, 4), matrix(6, 6), matrix(6, 6), matrix(6, 6)
    moved = vector(6)
    ahead_into(end, start, pose)
    adjoint_into(pose, transport)
    apply_into(transport, field0, moved)
    ad_into(field0, curl)
    times_into(transport, curl, lean)
    ad_into(moved, curl)
    for i in range(6):
        error[i] = field1[i] - moved[i]
        for j in range(6):
            j0[i, j], j0[i, at + j], j1[i, j] = lean[i, j], -transport[i, j], -curl[i, j]


@jit()
def step_into(
    pose0, pose1, rate0, rate1, field0, field1, about0, about1, step, weight, psd, carried_psd,
    jump, rigid, error, slopes, info, carried_error, carried_slopes, carried_info,
):  # fmt: skip
    """Errors (12,), (6,) of a step, Jacobians (r, 2, 18), whiteners; the pair's into zeros."""
    at, carried_at = (6, 12) if rigid else (12, 6)
    back, pull, spread = matrix(6, 6), matrix(6, 6), matrix(6, 6)
    middle, cov, carried_cov = vector(6), matrix(12, 12), matrix(6, 6)
    c0, c1 = matrix(6, 18), matrix(6, 18)
    pair_into(pose0, pose1, rate0, rate1, step, error, back, pull, spread)
    _carried(pose0, pose1, field0, field1, carried_at, rigid, carried_error, c0, c1)
    for i in range(6):
        for j in range(6):
            slopes[i, 0, j], slopes[i, 0, at + j] = back[i, j], pull[i, j]
            slopes[i, 1, j] = spread[i, j]
        slopes[6 + i, 0, at + i], slopes[6 + i, 1, at + i] = -1.0, 1.0
        for j in range(18):
            carried_slopes[i, 0, j], carried_slopes[i, 1, j] = c0[i, j], c1[i, j]
    middle_into(about0, about1, step, psd, jump, middle)
    process_into(middle, step, psd, carried_psd, jump, rigid, cov, carried_cov)
    pair_whiten_into(cov, info)
    whiten_into(carried_cov, carried_info)
    for i in range(12):
        for j in range(12):
            info[i, j] *= weight
    for i in range(6):
        for j in range(6):
            carried_info[i, j] *= weight
    if (
        transversely_isotropic(psd)
        and transversely_isotropic(carried_psd)
        and transversely_isotropic(jump)
    ):
        turn_back(error, slopes)
        turn_back(carried_error, carried_slopes)


@jit(
    "(f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], i8[:,::1], f8[::1], f8[::1],"
    " f8[:,::1], f8[:,::1], f8[:,::1], b1, f8[::1])"
)
def weighted_steps(
    pose, rates, fields, about, nodes, step, weight, psd, carried_psd, jump, rigid, angle
):  # fmt: skip
    """Errors of pair and carried field, Jacobians (M, r, 2, 18) and whiteners (M, r, r).

    `angle` (L,) are rolls of nodes since their rates were `about`, at which weights are evaluated.
    """
    m = len(step)
    error, carried_error = np.empty((m, 12)), np.empty((m, 6))
    slopes, carried_slopes = np.zeros((m, 12, 2, 18)), np.empty((m, 6, 2, 18))
    info, carried_info = np.zeros((m, 12, 12)), np.empty((m, 6, 6))
    for n in range(m):
        a, b = nodes[n, 0], nodes[n, 1]
        step_into(
            pose[a], pose[b], rates[a], rates[b], fields[a], fields[b], about[a], about[b],
            step[n], weight[n], psd[n], carried_psd[n], jump[n], rigid,
            error[n], slopes[n], info[n], carried_error[n], carried_slopes[n], carried_info[n],
        )  # fmt: skip
        if (
            transversely_isotropic(psd[n])
            and transversely_isotropic(carried_psd[n])
            and transversely_isotropic(jump[n])
        ):
            turn_on(angle[a], error[n], slopes[n])
            turn_on(angle[a], carried_error[n], carried_slopes[n])
    return error, slopes, info, carried_error, carried_slopes, carried_info


@jit()
def _pair_covariance(turn, cov, at, left):
    """Bridge covariance of pose and rate, into zeros; `turn` is J_r of the pose's bend."""
    half, square = matrix(6, 12), matrix(6, 6)
    product(turn, cov[0:6], half, 1.0, 0.0, False, False)
    product(half[:, 0:6], turn, square, 1.0, 0.0, False, True)
    for i in range(6):
        for j in range(6):
            left[i, j] = square[i, j]
            left[i, at + j] = left[at + j, i] = half[i, 6 + j]
            left[at + i, at + j] = cov[6 + i, 6 + j]


@jit()
def _onward(start, rate, offset, delta, pose, turn, back, pull):
    """Pose at `offset` along a rate from `start`, perturbed by `delta` (12,), and its Jacobians.

    They are by `delta` (`turn`), the start (`back`) and the rate (`pull`), all (6, 6).
    """
    ahead, bend, end = matrix(4, 4), matrix(4, 4), matrix(4, 4)
    unbend, a, scaled = matrix(6, 6), matrix(6, 6), vector(6)
    for i in range(6):
        scaled[i] = offset * rate[i]
    exp_into(scaled, ahead)
    exp_into(delta, bend)
    compose_into(start, ahead, end)
    compose_into(end, bend, pose)
    right_jacobian_into(delta, turn)
    adjoint_back_into(bend, unbend)
    adjoint_back_into(ahead, a)
    times_into(unbend, a, back)
    right_jacobian_into(scaled, a)
    times_into(unbend, a, pull)
    for i in range(6):
        for j in range(6):
            pull[i, j] *= offset


@jit()
def pair_point_into(start, end, rate0, rate1, step, offset, gain, at, pose, rate, turn, j0, j1):
    """Pose and rate at `offset` into a step; their rows of the Jacobians (18, ·) by both ends.

    T(u) = T₀ exp(u rate₀) exp(δ), with [δ; δ_rate] = gain e, `gain` (12, 12); the Jacobians come as
    zeros, and J_r(δ) is written to `turn`.
    """
    error, delta = vector(12), vector(12)
    slopes, bent = matrix(6, 18), matrix(12, 24)
    back, pull, curved = matrix(6, 6), matrix(6, 6), matrix(6, 24)
    pair_into(start, end, rate0, rate1, step, error, back, pull, turn)
    for i in range(6):
        for j in range(6):
            slopes[i, j], slopes[i, 6 + j], slopes[i, 12 + j] = back[i, j], pull[i, j], turn[i, j]
    apply_into(gain, error, delta)
    product(gain[:, 0:6], slopes, bent[:, 0:18], 1.0, 0.0, False, False)
    for i in range(12):
        for j in range(6):  # the error of the rate is their difference
            bent[i, 6 + j] -= gain[i, 6 + j]
            bent[i, 18 + j] = gain[i, 6 + j]
    _onward(start, rate0, offset, delta, pose, turn, back, pull)
    product(turn, bent[0:6], curved, 1.0, 0.0, False, False)
    for i in range(6):
        rate[i] = rate0[i] + delta[6 + i]
        for j in range(6):
            j0[i, j], j0[i, at + j] = back[i, j] + curved[i, j], pull[i, j] + curved[i, 6 + j]
            j1[i, j], j1[i, at + j] = curved[i, 12 + j], curved[i, 18 + j]
            j0[at + i, j], j0[at + i, at + j] = bent[6 + i, j], bent[6 + i, 6 + j]
            j1[at + i, j], j1[at + i, at + j] = bent[6 + i, 12 + j], bent[6 + i, 18 + j]
        j0[at + i, at + i] += 1.0


@jit()
def _transport(pose, start, field0, at, field, j0, j1, left):
    """Add the field transported rigidly from the start of a step to a pose, with Jacobians."""
    end, transport = matrix(4, 4), matrix(6, 6)
    curl, lean, moved = matrix(6, 6), matrix(6, 6), vector(6)
    ahead_into(pose, start, end)
    adjoint_into(end, transport)
    apply_into(transport, field0, moved)
    ad_into(field0, curl)
    times_into(transport, curl, lean)
    for i in range(6):
        field[i] += moved[i]
        for j in range(6):
            j0[at + i, j] -= lean[i, j]
            j0[at + i, at + j] += transport[i, j]
    ad_into(moved, curl)
    for rows in (j0, j1, left):  # a transported field rotates with the pose
        product(curl, rows[0:6], rows[at : at + 6], 1.0, 1.0, False, False)
    product(left[:, 0:6], curl, left[:, at : at + 6], 1.0, 1.0, False, True)


@jit()
def _carried_point(
    start, end, field0, field1, pose, rigid, gain, cov, at, field, j0, j1, left
):  # fmt: skip
    """Carried field at a pose inside a step, with its rows of Jacobians and covariance."""
    for i in range(6):
        for j in range(6):
            left[at + i, at + j] = cov[i, j]
    if not rigid:
        for i in range(6):
            share = gain[i, i]
            field[i] = field0[i] + share * (field1[i] - field0[i])
            j0[at + i, at + i], j1[at + i, at + i] = 1.0 - share, share
        return
    lost, c0, c1 = vector(6), matrix(6, 18), matrix(6, 18)
    _carried(start, end, field0, field1, at, rigid, lost, c0, c1)
    apply_into(gain, lost, field)
    product(gain, c0, j0[at : at + 6], 1.0, 0.0, False, False)
    product(gain, c1, j1[at : at + 6], 1.0, 0.0, False, False)
    _transport(pose, start, field0, at, field, j0, j1, left)


@jit()
def bridged_into(
    start, end, rate0, rate1, field0, field1, step, offset, about, psd, carried_psd, jump,
    rigid, pose, rate, field, j0, j1, left,
):  # fmt: skip
    """State inside a step; Jacobians (18, 18) by both ends, bridge covariance, into zeros."""
    at, carried_at = (6, 12) if rigid else (12, 6)
    gain, cov, turn = matrix(12, 12), matrix(12, 12), matrix(6, 6)
    carried_gain, carried_cov = matrix(6, 6), matrix(6, 6)
    bridge_into(
        about, step, offset, psd, carried_psd, jump, rigid, gain, cov, carried_gain, carried_cov
    )
    pair_point_into(start, end, rate0, rate1, step, offset, gain, at, pose, rate, turn, j0, j1)
    _pair_covariance(turn, cov, at, left)
    _carried_point(
        start, end, field0, field1, pose, rigid, carried_gain, carried_cov, carried_at,
        field, j0, j1, left,
    )  # fmt: skip
