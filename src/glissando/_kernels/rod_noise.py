"""Process noise of a loaded rod. Source: docs/math.md, equation (27)."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.rod_series import ALONG, FORCE, MOMENT, TURN, WEIGHT

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
_TERMS = 6  # of the exponential of a step, whose norm is small


@jit()
def product_into(a, b, out):
    """Product of a sparse matrix (12, 12) and a matrix with as many columns as `out`."""
    for i in range(12):
        for j in range(out.shape[1]):
            out[i, j] = 0.0
        for k in range(12):
            x = a[i, k]
            if x != 0.0:
                for j in range(out.shape[1]):
                    out[i, j] += x * b[k, j]


@jit()
def carry_noise(onward, half, noise):
    """Propagate a covariance (12, 12) over a step of transition `onward`, in place."""
    product_into(onward, noise, half)
    for i in range(12):
        for j in range(12):
            value = 0.0
            for k in range(12):
                value += half[i, k] * onward[j, k]
            noise[i, j] = value


@jit()
def _add_hat(x, a, factor, scale, first, row, column, out):
    """Add a multiple of v^ of the vector v = x[a], columns over `scale` from `first` on."""
    u, v, w = factor * x[a, 0], factor * x[a, 1], factor * x[a, 2]
    p, q, r = scale[first], scale[first + 1], scale[first + 2]
    out[row + 1, column] += w / p
    out[row + 2, column] -= v / p
    out[row, column + 1] -= w / q
    out[row + 2, column + 1] += u / q
    out[row, column + 2] += v / r
    out[row + 1, column + 2] -= u / r


@jit()
def _growth_into(h, scale, x, out):
    """System matrix of errors [pose, wrench] (12, 12), times the step; `scale` is [1, K]."""
    out[:] = 0.0
    for order in range(2):
        factor = h if order == 0 else 0.5 * h * h
        for at in range(0, 12, 3):
            _add_hat(x, TURN + order, -factor, scale, 0, at, at, out)
        _add_hat(x, ALONG + order, -factor, scale, 0, 0, 3, out)
        _add_hat(x, ALONG + order, -factor, scale, 0, 9, 6, out)
        _add_hat(x, FORCE + order, factor, scale, 3, 9, 6, out)
        _add_hat(x, FORCE + order, factor, scale, 6, 6, 9, out)
        _add_hat(x, MOMENT + order, factor, scale, 6, 9, 9, out)
    _add_hat(x, WEIGHT, -h, scale, 0, 6, 3, out)
    for i in range(6):
        out[i, 6 + i] += h / scale[3 + i]


@jit()
def _powers_into(out):
    """Fill in the terms Gⁿ / n! of an exponential (TERMS, 12, 12), with G given in out[1]."""
    for i in range(12):
        for j in range(12):
            out[0, i, j] = 1.0 if i == j else 0.0
    for n in range(2, _TERMS):
        for i in range(12):
            for j in range(12):
                out[n, i, j] = 0.0
            for k in range(12):
                x = out[1, i, k] / n
                if x != 0.0:
                    for j in range(12):
                        out[n, i, j] += x * out[n - 1, k, j]


@jit()
def add_noise(h, psd, scale, x, memory, out):
    """Add the covariance (12, 12) of white noise of densities `psd` (12,) over a step."""
    powers, lever, root = memory
    _growth_into(h, scale, x, powers[1])
    _powers_into(powers)
    for i in range(12):
        root[i] = np.sqrt(h * psd[i])
    for node in range(_NODES.size):
        at, weight = _NODES[node], _WEIGHTS[node]
        for i in range(12):
            for j in range(12):
                value = powers[_TERMS - 1, i, j]
                for n in range(_TERMS - 2, -1, -1):
                    value = value * at + powers[n, i, j]
                lever[i, j] = value * root[j]
        for i in range(12):
            for j in range(i + 1):
                value = 0.0
                for k in range(12):
                    value += lever[i, k] * lever[j, k]
                out[i, j] += weight * value
                if j < i:
                    out[j, i] += weight * value


@jit()
def noise_memory():
    """Allocate arrays for the intermediate results of `add_noise`."""
    return np.empty((_TERMS, 12, 12)), np.empty((12, 12)), np.empty(12)
