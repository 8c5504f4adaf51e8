"""Products of parts of matrices by BLAS, without copies; triangles cost what they hold."""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando._kernels.jit import External, jit

_BAND = 32  # columns of a triangle that are computed together

_gemm: Any = External(
    "numba_xxgemm",  # numba's door to BLAS: it takes pointers and leading dimensions
    "intc(char, char, char, intp, intp, intp, CPointer(f8), CPointer(f8), intp, CPointer(f8),"
    " intp, CPointer(f8), CPointer(f8), intp)",
)


@jit()
def product(a, b, out, scale, keep, turn_a, turn_b):
    """Out = scale · a b + keep · out, a or b transposed; the rows of each are contiguous."""
    scalars = np.array([scale, keep])
    inner = a.shape[0] if turn_a else a.shape[1]
    if out.size and inner:
        _gemm(
            ord("d"), ord("t") if turn_b else ord("n"), ord("t") if turn_a else ord("n"),
            out.shape[1], out.shape[0], inner, scalars.ctypes, b.ctypes, b.strides[0] // 8,
            a.ctypes, a.strides[0] // 8, scalars[1:].ctypes, out.ctypes, out.strides[0] // 8,
        )  # fmt: skip


@jit()
def lower_product(a, b, out, scale, keep, turned):
    """The lower triangle, and a little more, of out = scale · a bᵀ + keep · out; aᵀ b if turned."""
    n = len(out)
    for j in range(0, n, _BAND):
        e = min(j + _BAND, n)
        if turned:
            product(a[:, j:n], b[:, j:e], out[j:n, j:e], scale, keep, True, False)
        else:
            product(a[j:n, :], b[j:e, :], out[j:n, j:e], scale, keep, False, True)


@jit()
def triangle_square(root, out):
    """The lower triangle, and a little more, of rootᵀ root for a lower triangular root."""
    n = len(out)
    for j in range(0, n, _BAND):
        e = min(j + _BAND, n)
        product(root[j:n, j:n], root[j:n, j:e], out[j:n, j:e], 1.0, 0.0, True, False)


@jit()
def triangle_product(root, b, out):
    """rootᵀ b for a lower triangular root."""
    n = len(out)
    for j in range(0, n, _BAND):
        e = min(j + _BAND, n)
        product(root[j:n, j:e], b[j:n, :], out[j:e, :], 1.0, 0.0, True, False)


@jit()
def banded_product(root, b, out):
    """Root bᵀ for a lower triangular root and a b whose rows hold few numbers, close together."""
    n = len(root)
    for j in range(0, n, _BAND // 2):
        e, low, high = min(j + _BAND // 2, n), n, 0
        for i in range(j, e):
            row, first, last = b[i], 0, n
            while first < low and row[first] == 0.0:
                first += 1
            while last > high and row[last - 1] == 0.0:
                last -= 1
            low, high = min(low, first), max(high, last)
        out[:low, j:e] = 0.0
        if low < high:
            product(root[low:, low:high], b[j:e, low:high], out[low:, j:e], 1.0, 0.0, False, True)
