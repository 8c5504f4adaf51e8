"""Flow of a loaded rod from one cross-section to another: path, Jacobians and noise.

Source: docs/math.md, equations (26) and (27).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.blas import copy_into
from glissando._kernels.jit import jit
from glissando._kernels.lie import adjoint_back_into, compose_into, exp_into, right_jacobian_into
from glissando._kernels.rod_noise import add_noise, carry_noise, noise_memory, product_into
from glissando._kernels.rod_series import (
    ALONG,
    FORCE,
    MOMENT,
    ORDERS,
    TURN,
    WEIGHT,
    cross,
    cross_slopes,
    series_into,
    turn_slopes,
)

STEPS = 3  # of an interval
_AHEAD, _CARRIED, _END, _LEVER, _POSITION, _PLACES = 20, 22, 24, 28, 29, 30  # rows of vectors
_END_WRENCH = _END + 2


@jit()
def _ahead(h, x, slopes, six):
    """Six-vector of a step's pose by Magnus' expansion, and its Jacobian."""
    power = 1.0
    for i in range(3):
        x[_AHEAD, i] = x[_AHEAD + 1, i] = 0.0
        for j in range(9):
            slopes[_AHEAD, i, j] = slopes[_AHEAD + 1, i, j] = 0.0
    for k in range(ORDERS):
        power *= h / (k + 1.0)
        for i in range(3):
            x[_AHEAD, i] += power * x[ALONG + k, i]
            x[_AHEAD + 1, i] += power * x[TURN + k, i]
            for j in range(9):
                slopes[_AHEAD, i, j] += power * slopes[ALONG + k, i, j]
                slopes[_AHEAD + 1, i, j] += power * slopes[TURN + k, i, j]
    for k, factor in ((1, h**3 / 12.0), (2, h**4 / 24.0)):
        for a, b, c in (
            (TURN, ALONG + k, _AHEAD), (ALONG, TURN + k, _AHEAD), (TURN, TURN + k, _AHEAD + 1),
        ):  # fmt: skip
            cross(x, a, b, factor, c)
            cross_slopes(x, a, slopes, b, factor, c)
            cross_slopes(x, b, slopes, a, -factor, c)
    for i in range(3):
        six[i], six[3 + i] = x[_AHEAD, i], x[_AHEAD + 1, i]


@jit()
def _carry(h, x, slopes):
    """Wrench at the beginning of a step less the step's weight, and its Jacobian."""
    a, b = 0.5 * h * h, h * h * h / 6.0
    for i in range(3):
        x[_LEVER, i] = a * x[ALONG, i] + b * x[ALONG + 1, i]
        x[_CARRIED, i] = x[FORCE, i] - h * x[WEIGHT, i]
        x[_CARRIED + 1, i] = x[MOMENT, i]
        for j in range(9):
            slopes[_LEVER, i, j] = a * slopes[ALONG, i, j] + b * slopes[ALONG + 1, i, j]
            slopes[_CARRIED, i, j] = slopes[FORCE, i, j] - h * slopes[WEIGHT, i, j]
            slopes[_CARRIED + 1, i, j] = slopes[MOMENT, i, j]
    cross(x, TURN, ALONG, b, _LEVER)
    cross_slopes(x, TURN, slopes, ALONG, b, _LEVER)
    cross_slopes(x, ALONG, slopes, TURN, -b, _LEVER)
    cross(x, _LEVER, WEIGHT, -1.0, _CARRIED + 1)
    cross_slopes(x, _LEVER, slopes, WEIGHT, -1.0, _CARRIED + 1)
    cross_slopes(x, WEIGHT, slopes, _LEVER, 1.0, _CARRIED + 1)


@jit()
def _step(h, x, slopes, six, frame, pose, phi):
    """Pose (4, 4), wrench and transition matrix `phi` (12, 12) of a step."""
    _ahead(h, x, slopes, six)
    exp_into(six, pose)
    right_jacobian_into(six, frame)
    for i in range(3):
        x[_POSITION, i] = pose[i, 3]
        for part in range(4):
            x[_END + part, i] = 0.0
            for j in range(9):
                slopes[_END + part, i, j] = 0.0
    turn_slopes(frame, 0, slopes, _AHEAD, _END)
    turn_slopes(frame, 3, slopes, _AHEAD + 1, _END)
    turn_slopes(frame, 0, slopes, _AHEAD + 1, _END + 1)
    _carry(h, x, slopes)
    cross(x, _POSITION, _CARRIED, -1.0, _CARRIED + 1)
    cross_slopes(x, _POSITION, slopes, _CARRIED, -1.0, _CARRIED + 1)
    adjoint_back_into(pose, frame)
    for part in range(2):
        for i in range(3):
            for k in range(3):
                x[_END_WRENCH + part, i] += frame[i, k] * x[_CARRIED + part, k]
        turn_slopes(frame, 0, slopes, _CARRIED + part, _END_WRENCH + part)
    cross_slopes(x, _END_WRENCH, slopes, _END + 1, 1.0, _END_WRENCH)
    cross_slopes(x, _END_WRENCH, slopes, _END, 1.0, _END_WRENCH + 1)
    cross_slopes(x, _END_WRENCH + 1, slopes, _END + 1, 1.0, _END_WRENCH + 1)
    for i in range(12):
        at, k = _END + i // 3, i % 3
        for j in range(6):
            phi[i, j] = frame[i, j] if i < 6 else 0.0
            phi[i, 6 + j] = slopes[at, k, 3 + j]
        a, b, c = slopes[at, k, 0], slopes[at, k, 1], slopes[at, k, 2]
        phi[i, 3] += b * x[WEIGHT, 2] - c * x[WEIGHT, 1]
        phi[i, 4] += c * x[WEIGHT, 0] - a * x[WEIGHT, 2]
        phi[i, 5] += a * x[WEIGHT, 1] - b * x[WEIGHT, 0]


@jit()
def _begin_step(rotation, pose, load, load_slope, middle, turn, x):
    """Initialise wrench and weight of a step from the end of the step before."""
    for i in range(3):
        x[WEIGHT, i] = 0.0
        for j in range(3):
            turn[j, i] = 0.0
            for k in range(3):
                turn[j, i] += rotation[j, k] * pose[k, i]
            x[WEIGHT, i] += turn[j, i] * (load[j] + middle * load_slope[j])
        x[FORCE, i], x[MOMENT, i] = x[_END_WRENCH, i], x[_END_WRENCH + 1, i]


@jit()
def _add_weight(slopes, turn, middle, by_weight):
    """Add the Jacobian (12, 6) of a step's end by weight in the world and its change a metre."""
    for i in range(12):
        at, k = _END + i // 3, i % 3
        for j in range(3):
            value = 0.0
            for m in range(3):
                value += slopes[at, k, m] * turn[j, m]
            by_weight[i, j] += value
            by_weight[i, 3 + j] += middle * value


@jit()
def flow_memory():
    """Allocate arrays for the intermediate results of `flow_into`."""
    slopes = np.zeros((_PLACES, 3, 9))
    for i in range(3):
        slopes[WEIGHT, i, i] = slopes[FORCE, i, 3 + i] = slopes[MOMENT, i, 6 + i] = 1.0
    return (
        np.empty((_PLACES, 3)), slopes, np.empty(6), np.empty((6, 6)), np.empty((4, 4)),
        np.empty((4, 4)), np.empty((12, 12)), np.empty((12, 12)), np.empty(6), np.empty((3, 3)),
        np.empty((12, 12)), np.ones(9), noise_memory(),
    )  # fmt: skip


@jit()
def flow_into(rotation, length, given, acting, noisy, memory, out):
    """Flow over one interval; `wrench` is replaced, pose, noise, by_weight come as zeros."""
    stiffness, rest, rest_slope = given
    load, load_slope, psd = acting
    x, slopes, six, frame, forward, before, onward, old, here, turn, half, scale, noises = memory
    pose, wrench, phi, noise, by_weight = out
    h = length / STEPS
    for i in range(4):
        pose[i, i] = 1.0
    for i in range(3):
        x[_END_WRENCH, i], x[_END_WRENCH + 1, i] = wrench[i], wrench[3 + i]
    for i in range(6):
        scale[3 + i] = stiffness[i]
    for step in range(STEPS):
        middle = (step + 0.5) * h
        _begin_step(rotation, pose, load, load_slope, middle, turn, x)
        for i in range(6):
            here[i] = rest[i] + step * h * rest_slope[i]
        series_into(stiffness, here, rest_slope, x, slopes)
        _step(h, x, slopes, six, frame, forward, onward)
        if noisy:
            if step:
                carry_noise(onward, half, noise)
            add_noise(h, psd, scale, x, noises, noise)
        if step:
            for i in range(12):
                for j in range(6):
                    half[i, j] = by_weight[i, j]
            product_into(onward, half, by_weight)
            copy_into(pose, before)
            copy_into(phi, old)
            compose_into(before, forward, pose)
            product_into(onward, old, phi)
        else:
            copy_into(forward, pose)
            copy_into(onward, phi)
        _add_weight(slopes, turn, middle, by_weight)
    for i in range(3):
        wrench[i], wrench[3 + i] = x[_END_WRENCH, i], x[_END_WRENCH + 1, i]


@jit(
    "(f8[:,:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], "
    "f8[:,::1], b1)"
)
def flow(rotation, wrench, step, stiffness, rest, rest_slope, weight, weight_slope, psd, noisy):
    """See `model.priors.mechanical.flow.flow`: pose, wrench, phi, noise, Jacobian by weight."""
    m = step.size
    pose, end, phi = np.zeros((m, 4, 4)), wrench.copy(), np.empty((m, 12, 12))
    noise, by_weight, memory = np.zeros((m, 12, 12)), np.zeros((m, 12, 6)), flow_memory()
    for i in range(m):
        given, acting = (stiffness[i], rest[i], rest_slope[i]), (weight[i], weight_slope[i], psd[i])
        out = pose[i], end[i], phi[i], noise[i], by_weight[i]
        flow_into(rotation[i], step[i], given, acting, noisy, memory, out)
    return pose, end, phi, noise, by_weight
