"""Block-tridiagonal systems: factor, solve, covariances. Source: equations (20) and (21)."""

from __future__ import annotations

import numpy as np

from glissando._kernels.blas import (
    banded_product,
    left_product,
    lower_product,
    mirrored_into,
    product,
    right_product,
    take_square,
    triangle_square,
    turned_product,
)
from glissando._kernels.jit import jit
from glissando._kernels.process import SMALL, inverse_root_into

_PIVOT_FLOOR = 1e-13  # a pivot this small against its diagonal entry carries no information


@jit()
def inverse_factor(a, out):
    """Inverse Cholesky factor L⁻¹ of a = L Lᵀ, into `out`, by halves with products of BLAS.

    Only its lower triangle is read; `a` is overwritten. Returns whether it is positive definite.
    """
    n = len(a)
    if n <= SMALL:
        return inverse_root_into(a, out)
    h = n // 2
    side, top, below = a[h:n, 0:h], out[0:h, 0:h], out[h:n, 0:h]
    tail, low = a[h:n, h:n], out[h:n, h:n]
    if not inverse_factor(a[0:h, 0:h], top):
        return False
    right_product(side, top, below, True)
    lower_product(below, below, tail, -1.0, 1.0, False, True)
    if not inverse_factor(tail, low):
        return False
    right_product(below, top, side, False)
    left_product(low, side, below, -1.0)
    out[0:h, h:n] = 0.0
    return True


@jit()
def has_information(inverse, scale):
    """Whether all pivots of a slab exceed the rounding error of its diagonal `scale` (D,)."""
    least = np.inf
    for i in range(len(scale)):
        pivot = 1.0 / (inverse[i, i] * inverse[i, i]) - _PIVOT_FLOOR * scale[i]
        least = pivot if not pivot >= least else least  # also if it is NaN
    return least >= 0.0


@jit("(f8[:,:,::1], f8[:,:,::1], i8, f8[:,:,::1], f8[:,:,::1])")
def factor(diagonal, lower, start, inverse, coupling):
    """Block Cholesky factorisation from slab `start` on, while the matrix is positive definite.

    The inverses of the factor's diagonal blocks, `inverse` (K, D, D), and `coupling` (K−1, D, D) =
    inverse[k] A[k, k+1] are written; those before `start` are used as they are. Returns the first
    slab with a direction without information, −1 if there is none.
    """
    d, vanished = diagonal.shape[1], -1
    schur, scale, first = np.empty((d, d)), np.empty(d), np.zeros(d, np.int64)
    for k in range(start, len(diagonal)):
        for i in range(d):
            scale[i] = diagonal[k, i, i]
            for j in range(d):
                schur[i, j] = diagonal[k, i, j]
        if k:
            take_square(coupling[k - 1], first, schur)
        if not inverse_factor(schur[0:d, 0:d], inverse[k, 0:d, 0:d]):
            return k if vanished < 0 else vanished
        if k < len(coupling):
            banded_product(inverse[k], lower[k], coupling[k], first)
        if vanished < 0 and not has_information(inverse[k], scale):
            vanished = k
    return vanished


@jit()
def subtract_coupling(coupling, before, y):
    """Subtract the coupling C (D, D) to the solution of the slab before: y −= Cᵀ x."""
    for j in range(len(y)):
        row, value = coupling[j], before[j]
        for i in range(len(y)):
            y[i] -= row[i] * value


@jit()
def less_coupling(coupling, later, y):
    """Subtract the coupling C (D, D) to the solution of the next slab: y −= C x."""
    for i in range(len(y)):
        row, value = coupling[i], 0.0
        for j in range(len(y)):
            value += row[j] * later[j]
        y[i] -= value


@jit()
def forward_slab(inverse, y):
    """Multiply the vector of a slab by a lower triangular `inverse`, in place."""
    for i in range(len(y) - 1, -1, -1):
        row, value = inverse[i], 0.0
        for j in range(i + 1):
            value += row[j] * y[j]
        y[i] = value


@jit()
def backward_slab(inverse, y):
    """Multiply the vector of a slab by the transpose of `inverse`, in place."""
    for j in range(len(y)):  # column after column: x_i needs x_j of j ≥ i only
        row, value = inverse[j], y[j]
        y[j] = 0.0
        for i in range(j + 1):
            y[i] += row[i] * value


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1])")
def backward(inverse, coupling, x):
    """Solve with the transposed factor for x (K, D), in place."""
    for k in range(len(x) - 1, -1, -1):
        if k < len(coupling):
            less_coupling(coupling[k], x[k + 1], x[k])
        backward_slab(inverse[k], x[k])


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1])")
def solve(inverse, coupling, x):
    """Solve with the factorised matrix for x (K, D), in place."""
    for k in range(len(x)):
        if k:
            subtract_coupling(coupling[k - 1], x[k - 1], x[k])
        forward_slab(inverse[k], x[k])
    backward(inverse, coupling, x)


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1])")
def marginals(inverse, coupling, cov, cross):
    """Blocks of the inverse at [k, k] and [k, k+1]; they may overwrite the factor."""
    d = inverse.shape[1]
    block, gain = np.empty((d, d)), np.empty((d, d))
    for k in range(len(inverse) - 1, -1, -1):
        triangle_square(inverse[k], block)
        if k < len(coupling):
            turned_product(coupling[k], inverse[k], gain)
            product(gain, cov[k + 1], cross[k], -1.0, 0.0, True, False)
            lower_product(cross[k], gain, block, -1.0, 1.0, False, False)
        mirrored_into(block, cov[k])


@jit("(f8[:,:,::1], f8[:,:,::1], i8[:,::1], i8[:,::1], f8[:,:,:,::1], f8[:,:,::1])")
def add_spread(cov, cross, slab, first, slopes, out):
    """Add covariances J C Jᵀ to `out` (M, r, r), with C of parts of neighbouring slabs.

    Part j of point m has the components of slab[m, j] from column first[m, j] on and the Jacobian
    slopes[m, :, j]; `cov` and `cross` are blocks of the inverse, as of `marginals`.
    """
    rows, parts, size = slopes.shape[1:]
    half = np.empty((rows, parts * size))
    for m in range(len(slab)):
        slope = slopes[m].reshape(rows, parts * size)
        half[:] = 0.0
        for i in range(parts):
            k, row = slab[m, i], first[m, i]
            own = slope[:, i * size : (i + 1) * size]
            for j in range(parts):
                other, column = slab[m, j], first[m, j]
                spread = half[:, j * size : (j + 1) * size]
                if k > other:
                    block = cross[other, column : column + size, row : row + size]
                    product(own, block, spread, 1.0, 1.0, False, True)
                else:
                    blocks = cov if k == other else cross
                    block = blocks[k, row : row + size, column : column + size]
                    product(own, block, spread, 1.0, 1.0, False, False)
        product(half, slope, out[m], 1.0, 1.0, False, True)
