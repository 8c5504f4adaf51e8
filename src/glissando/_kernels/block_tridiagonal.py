"""Block-tridiagonal systems: factor, solve, covariances. Source: equations (20) and (21)."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.process import whiten_into

_BASE = 24  # rows of a block from which on its inverse factor is found by halves


@jit()
def _inverse_factor(a, out):
    """L⁻¹ of a symmetric matrix L Lᵀ, into `out`: by halves, whose products run at full speed."""
    n = len(a)
    if n <= _BASE:
        whiten_into(a, out)
        return
    h = n // 2
    corner, tail = a[:h, :h].copy(), a[h:, h:].copy()
    top, low = np.empty((h, h)), np.empty((n - h, n - h))
    _inverse_factor(corner, top)
    below = np.dot(a[h:, :h].copy(), top.T)
    tail -= np.dot(below, below.T)
    _inverse_factor(tail, low)
    side = np.dot(low, np.dot(below, top))
    out[:h, :h], out[h:, h:] = top, low
    out[:h, h:], out[h:, :h] = 0.0, -side


@jit("(f8[:,:,::1], f8[:,:,::1], i8, f8[:,:,::1], f8[:,:,::1])")
def factor(diagonal, lower, start, inverse, coupling):
    """Block Cholesky from slab `start` on; raises LinAlgError where it is not positive definite.

    `inverse` (K, D, D) of the factor's diagonal blocks and `coupling` (K−1, D, D) = inverse[k]
    A[k, k+1] are written; those before `start` are used as they are.
    """
    for k in range(start, len(diagonal)):
        schur = diagonal[k].copy()
        if k:
            schur -= np.dot(coupling[k - 1].T, coupling[k - 1])
        _inverse_factor(schur, inverse[k])
        if k < len(coupling):
            np.dot(inverse[k], lower[k].T, coupling[k])


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1])")
def forward(inverse, coupling, x):
    """Solve with the factor, in place (K, D)."""
    for k in range(len(x)):
        if k:
            x[k] -= np.dot(coupling[k - 1].T, x[k - 1])
        x[k] = np.dot(inverse[k], x[k])


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1])")
def backward(inverse, coupling, x):
    """Solve with the transposed factor, in place (K, D)."""
    for k in range(len(x) - 1, -1, -1):
        if k < len(coupling):
            x[k] -= np.dot(coupling[k], x[k + 1])
        x[k] = np.dot(inverse[k].T, x[k])


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1])")
def marginals(inverse, coupling, cov, cross):
    """Blocks of the inverse on the diagonal and next to it; they may overwrite the factor."""
    for k in range(len(inverse) - 1, -1, -1):
        block = np.dot(inverse[k].T, inverse[k])
        if k < len(coupling):
            gain = -np.dot(inverse[k].T, coupling[k])
            np.dot(gain, cov[k + 1], cross[k])
            block += np.dot(cross[k], gain.T)
        for i in range(len(block)):
            for j in range(len(block)):
                cov[k, i, j] = 0.5 * (block[i, j] + block[j, i])
