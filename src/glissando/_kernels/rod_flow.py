"""A loaded rod from one cross-section to another: its path, slopes and noise.

Source: docs/math.md, equations (26) and (27).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import (
    ad_into,
    adjoint_back_into,
    adjoint_into,
    compose_into,
    exp_into,
    right_jacobian_into,
)

STEPS = 3  # into which an interval is divided
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
_TERMS = 6  # of the exponential of a step, whose norm is small


@jit()
def _add(a, b, factor, out):
    """Add a multiple of the product a b of matrices, or of a matrix and columns."""
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            x = factor * a[i, k]
            if x != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += x * b[k, j]


@jit()
def _add_times(a, x, factor, out):
    """Add a multiple of the vector a x."""
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            out[i] += factor * a[i, k] * x[k]


@jit()
def _hat_into(x, out):
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1], out[1, 0] = -x[2], x[2]
    out[0, 2], out[2, 0] = x[1], -x[1]
    out[1, 2], out[2, 1] = -x[0], x[0]


@jit()
def _pull_into(wrench, out):
    """B(W) (6, 6) with B(W) η = ad(η)ᵀ W."""
    out[:] = 0.0
    for first, row, column in ((0, 0, 3), (0, 3, 0), (3, 3, 3)):
        x, y, z = wrench[first], wrench[first + 1], wrench[first + 2]
        out[row, column + 1], out[row + 1, column] = -z, z
        out[row, column + 2], out[row + 2, column] = y, -y
        out[row + 1, column + 2], out[row + 2, column + 1] = -x, x


@jit()
def _series_into(stiffness, rest, rest_slope, strain, wrench, weight, d_strain, d_wrench, d_weight,
                 ad, pull):  # fmt: skip
    """Strain, wrench and weight (4, …) with three derivatives by arclength, and their slopes.

    The first wrench and weight are given; slopes (4, …, 9) are by [weight, wrench] there. ∂W/∂s =
    ad(ε)ᵀ W − w_g and ∂w_g/∂s = −u × w_g are differentiated by Leibniz' rule.
    """
    spin, heavy = np.empty((3, 3)), np.empty((3, 3))
    d_wrench[:], d_weight[:], wrench[1:], weight[1:] = 0.0, 0.0, 0.0, 0.0
    for i in range(6):
        d_wrench[0, i, 3 + i] = 1.0
    for i in range(3):
        d_weight[0, i, i] = 1.0
    for order in range(4):
        for i in range(6):
            unloaded = rest[i] if order == 0 else rest_slope[i] if order == 1 else 0.0
            strain[order, i] = unloaded + wrench[order, i] / stiffness[i]
            for j in range(9):
                d_strain[order, i, j] = d_wrench[order, i, j] / stiffness[i]
        ad_into(strain[order], ad[order])
        _pull_into(wrench[order], pull[order])
        if order == 3:
            break
        for k in range(order + 1):
            times, j = 2.0 if order == 2 and k == 1 else 1.0, order - k
            _add_times(ad[k].T, wrench[j], times, wrench[order + 1])
            _add(ad[k].T, d_wrench[j], times, d_wrench[order + 1])
            _add(pull[j], d_strain[k], times, d_wrench[order + 1])
            _hat_into(strain[k, 3:], spin)
            _hat_into(weight[j], heavy)
            _add_times(spin, weight[j], -times, weight[order + 1])
            _add(heavy, d_strain[k, 3:], times, d_weight[order + 1])
            _add(spin, d_weight[j], -times, d_weight[order + 1])
        for i in range(3):
            wrench[order + 1, i] -= weight[order, i]
            for j in range(9):
                d_wrench[order + 1, i, j] -= d_weight[order, i, j]


@jit()
def _less_weight_into(h, strain, weight, d_strain, d_weight, carried, by_carried):
    """Take off the weight over a step, from a wrench about its beginning and its slope (6, 9)."""
    spin, along, hat = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    _hat_into(strain[0, 3:], spin)
    _hat_into(strain[0], along)
    a, b = 0.5 * h * h, h * h * h / 6.0
    lever, by_lever = np.zeros(3), np.zeros((3, 9))
    _add_times(spin, strain[0, :3], b, lever)
    _add(spin, d_strain[0, :3], b, by_lever)
    _add(along, d_strain[0, 3:], -b, by_lever)
    for i in range(3):
        lever[i] += a * strain[0, i] + b * strain[1, i]
        carried[i] -= h * weight[0, i]
        for j in range(9):
            by_lever[i, j] += a * d_strain[0, i, j] + b * d_strain[1, i, j]
            by_carried[i, j] -= h * d_weight[0, i, j]
    _hat_into(lever, hat)
    _add_times(hat, weight[0], -1.0, carried[3:])
    _add(hat, d_weight[0], -1.0, by_carried[3:])
    _hat_into(weight[0], hat)
    _add(hat, by_lever, 1.0, by_carried[3:])


@jit()
def _step_into(h, strain, wrench, weight, d_strain, d_wrench, d_weight, ad, pose, end, phi, own):
    """Pose (4, 4) and wrench (6,) after a step, slopes (12, 12) by both and (12, 9) as above."""
    ahead, slope = np.zeros(6), np.zeros((6, 9))
    power = 1.0
    for k in range(4):
        power *= h / (k + 1.0)
        for i in range(6):
            ahead[i] += power * strain[k, i]
            for j in range(9):
                slope[i, j] += power * d_strain[k, i, j]
    for k, factor in ((1, h**3 / 12.0), (2, h**4 / 24.0)):
        _add_times(ad[0], strain[k], factor, ahead)
        _add(ad[0], d_strain[k], factor, slope)
        _add(ad[k], d_strain[0], -factor, slope)
    turn, moved = np.empty((6, 6)), np.zeros((6, 9))
    exp_into(ahead, pose)
    right_jacobian_into(ahead, turn)
    _add(turn, slope, 1.0, moved)
    carried, by_carried = wrench[0].copy(), d_wrench[0].copy()
    _less_weight_into(h, strain, weight, d_strain, d_weight, carried, by_carried)
    frame, pull, hat = np.empty((6, 6)), np.empty((6, 6)), np.empty((3, 3))
    adjoint_into(pose, frame)
    end[:], own[:], phi[:] = 0.0, 0.0, 0.0
    _add_times(frame.T, carried, 1.0, end)
    _pull_into(end, pull)
    own[:6] = moved
    _add(frame.T, by_carried, 1.0, own[6:])
    _add(pull, moved, 1.0, own[6:])
    adjoint_back_into(pose, frame)
    phi[:6, :6] = frame
    phi[:, 6:] = own[:, 3:]
    _hat_into(weight[0], hat)
    for i in range(12):
        for j in range(3):
            for k in range(3):
                phi[i, 3 + j] += own[i, k] * hat[k, j]


@jit()
def _noise_into(h, psd, stiffness, weight, ad, pull, out):
    """Add the covariance (12, 12) of white noise of densities `psd` (12,) over a step."""
    powers = np.zeros((_TERMS, 12, 12))
    generator, hat = powers[1], np.empty((3, 3))
    _hat_into(weight, hat)
    for i in range(6):
        generator[i, 6 + i] = h / stiffness[i]
        for j in range(6):
            middle = h * (0.5 * h * ad[1, i, j] + ad[0, i, j])
            generator[i, j] = -middle
            generator[6 + j, 6 + i] += middle
            force = h * (pull[0, i, j] + 0.5 * h * pull[1, i, j])
            generator[6 + i, 6 + j] += force / stiffness[j]
    for i in range(3):
        for j in range(3):
            generator[6 + i, 3 + j] = -h * hat[i, j]
    for i in range(12):
        powers[0, i, i] = 1.0
    for k in range(2, _TERMS):
        _add(powers[k - 1], generator, 1.0 / k, powers[k])
    lever = np.empty((12, 12))
    for node in range(4):
        for i in range(12):
            for j in range(12):
                value = 0.0
                for k in range(_TERMS - 1, -1, -1):
                    value = value * _NODES[node] + powers[k, i, j]
                lever[i, j] = value * np.sqrt(h * psd[j])
        for i in range(12):
            for j in range(i + 1):
                value = 0.0
                for k in range(12):
                    value += lever[i, k] * lever[j, k]
                out[i, j] += _WEIGHTS[node] * value
                if j < i:
                    out[j, i] += _WEIGHTS[node] * value


@jit()
def _flow_into(rotation, length, stiffness, rest, rest_slope, load, load_slope, psd, noisy, pose,
               wrench, phi, noise, by_weight):  # fmt: skip
    """One interval, from its wrench to that at its end; pose, phi, noise and slope are made."""
    strain, wrenches, weight = np.empty((4, 6)), np.empty((4, 6)), np.empty((4, 3))
    d_strain, d_wrench = np.empty((4, 6, 9)), np.empty((4, 6, 9))
    d_weight, ad, pull = np.empty((4, 3, 9)), np.empty((4, 6, 6)), np.empty((4, 6, 6))
    forward, before, onward = np.empty((4, 4)), np.empty((4, 4)), np.empty((12, 12))
    own, old, half, here = np.empty((12, 9)), np.empty((12, 12)), np.empty((12, 12)), np.empty(6)
    turn, added, h = np.empty((3, 3)), np.empty((12, 6)), length / STEPS
    for i in range(4):
        pose[i, i] = 1.0
    for i in range(12):
        phi[i, i] = 1.0
    for step in range(STEPS):
        turn[:], weight[0] = 0.0, 0.0
        _add(rotation, pose[:3, :3], 1.0, turn)
        for j in range(3):
            acting = load[j] + (step + 0.5) * h * load_slope[j]
            for i in range(3):
                weight[0, i] += turn[j, i] * acting
        for i in range(6):
            here[i] = rest[i] + step * h * rest_slope[i]
        wrenches[0] = wrench
        _series_into(stiffness, here, rest_slope, strain, wrenches, weight, d_strain, d_wrench,
                     d_weight, ad, pull)  # fmt: skip
        _step_into(h, strain, wrenches, weight, d_strain, d_wrench, d_weight, ad, forward, wrench,
                   onward, own)  # fmt: skip
        if noisy:
            half[:], old[:] = 0.0, noise
            _add(onward, old, 1.0, half)
            for i in range(12):
                for j in range(12):
                    value = 0.0
                    for k in range(12):
                        value += half[i, k] * onward[j, k]
                    noise[i, j] = value
            _noise_into(h, psd, stiffness, weight[0], ad, pull, noise)
        added[:] = 0.0
        _add(onward, by_weight, 1.0, added)
        for i in range(12):
            for j in range(3):
                value = 0.0
                for k in range(3):
                    value += own[i, k] * turn[j, k]
                by_weight[i, j] = added[i, j] + value
                by_weight[i, 3 + j] = added[i, 3 + j] + (step + 0.5) * h * value
        before[:], old[:] = pose, phi
        compose_into(before, forward, pose)
        phi[:] = 0.0
        _add(onward, old, 1.0, phi)


@jit(
    "(f8[:,:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], "
    "f8[:,::1], b1)"
)
def flow(rotation, wrench, step, stiffness, rest, rest_slope, weight, weight_slope, psd, noisy):
    """See `model.priors.mechanical.flow.flow`: pose, wrench, phi, noise, slope by the weight."""
    m = step.size
    pose, end, phi = np.zeros((m, 4, 4)), wrench.copy(), np.zeros((m, 12, 12))
    noise, by_weight = np.zeros((m, 12, 12)), np.zeros((m, 12, 6))
    for i in range(m):
        _flow_into(rotation[i], step[i], stiffness[i], rest[i], rest_slope[i], weight[i],
                   weight_slope[i], psd[i], noisy, pose[i], end[i], phi[i], noise[i],
                   by_weight[i])  # fmt: skip
    return pose, end, phi, noise, by_weight
