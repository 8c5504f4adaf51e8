"""Block-tridiagonal systems: factor, solve, covariances. Source: equations (20) and (21)."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.process import whiten_into

_BASE = 24  # rows of a block up to which its inverse factor is found row by row


@jit()
def _product(a, b, out):
    """The product a b of contiguous matrices, by BLAS: one layout, so it is compiled once."""
    np.dot(a, b, out)


@jit()
def _transposed(a, out):
    """The transpose of a matrix, contiguous, in `out`."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[j, i] = a[i, j]
    return out


@jit()
def _copied(a, row, column, rows, columns):
    """A part of a matrix, contiguous."""
    out = np.empty((rows, columns))
    for i in range(rows):
        for j in range(columns):
            out[i, j] = a[row + i, column + j]
    return out


@jit()
def _inverse_factor(a, out):
    """L⁻¹ of a symmetric matrix L Lᵀ, into `out`: by halves, whose products run at full speed."""
    n = len(a)
    if n <= _BASE:
        whiten_into(a, out)
        return
    h = n // 2
    m = n - h
    corner, side, tail = _copied(a, 0, 0, h, h), _copied(a, h, 0, m, h), _copied(a, h, h, m, m)
    top, low = np.empty((h, h)), np.empty((m, m))
    below, half, square = np.empty((m, h)), np.empty((m, h)), np.empty((m, m))
    turned = np.empty((h, m))
    _inverse_factor(corner, top)
    _product(side, _transposed(top, corner), below)
    _product(below, _transposed(below, turned), square)
    for i in range(m):
        for j in range(m):
            tail[i, j] -= square[i, j]
    _inverse_factor(tail, low)
    _product(below, top, half)
    _product(low, half, side)
    for i in range(n):
        for j in range(n):
            if i < h:
                out[i, j] = top[i, j] if j < h else 0.0
            else:
                out[i, j] = -side[i - h, j] if j < h else low[i - h, j - h]


@jit("(f8[:,:,::1], f8[:,:,::1], i8, f8[:,:,::1], f8[:,:,::1])")
def factor(diagonal, lower, start, inverse, coupling):
    """Block Cholesky from slab `start` on; raises LinAlgError where it is not positive definite.

    `inverse` (K, D, D) of the factor's diagonal blocks and `coupling` (K−1, D, D) = inverse[k]
    A[k, k+1] are written; those before `start` are used as they are.
    """
    d = diagonal.shape[1]
    schur, turned = np.empty((d, d)), np.empty((d, d))
    for k in range(start, len(diagonal)):
        if k:
            _product(_transposed(coupling[k - 1], turned), coupling[k - 1], schur)
        for i in range(d):
            for j in range(d):
                schur[i, j] = diagonal[k, i, j] - (schur[i, j] if k else 0.0)
        _inverse_factor(schur, inverse[k])
        if k < len(coupling):
            _product(inverse[k], _transposed(lower[k], turned), coupling[k])


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1])")
def forward(inverse, coupling, x):
    """Solve with the factor, in place (K, D)."""
    for k in range(len(x)):
        if k:
            for j in range(x.shape[1]):
                for i in range(x.shape[1]):
                    x[k, i] -= coupling[k - 1, j, i] * x[k - 1, j]
        for i in range(x.shape[1] - 1, -1, -1):
            value = 0.0
            for j in range(i + 1):
                value += inverse[k, i, j] * x[k, j]
            x[k, i] = value


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1])")
def backward(inverse, coupling, x):
    """Solve with the transposed factor, in place (K, D)."""
    d = x.shape[1]
    for k in range(len(x) - 1, -1, -1):
        if k < len(coupling):
            for i in range(d):
                for j in range(d):
                    x[k, i] -= coupling[k, i, j] * x[k + 1, j]
        for j in range(d):  # column after column: x_i needs x_j of j ≥ i only
            value = x[k, j]
            x[k, j] = 0.0
            for i in range(j + 1):
                x[k, i] += inverse[k, j, i] * value


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1])")
def marginals(inverse, coupling, cov, cross):
    """Blocks of the inverse on the diagonal and next to it; they may overwrite the factor."""
    d = inverse.shape[1]
    block, gain = np.empty((d, d)), np.empty((d, d))
    carried, square, root = np.empty((d, d)), np.empty((d, d)), np.empty((d, d))
    for k in range(len(inverse) - 1, -1, -1):
        _transposed(inverse[k], root)
        _product(root, inverse[k], block)
        if k < len(coupling):
            _product(root, coupling[k], gain)
            _product(gain, cov[k + 1], carried)
            _product(carried, _transposed(gain, root), square)
            for i in range(d):
                for j in range(d):
                    block[i, j] += square[i, j]
                    cross[k, i, j] = -carried[i, j]
        for i in range(d):
            for j in range(i + 1):
                cov[k, i, j] = cov[k, j, i] = 0.5 * (block[i, j] + block[j, i])
