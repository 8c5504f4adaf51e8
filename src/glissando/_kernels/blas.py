"""Products of matrix views by BLAS without copies; zeros of triangles are skipped."""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando._kernels.jit import External, jit

_BAND = 32  # columns of a triangle that are computed together
_TILE = 16  # rows and columns that are copied together
_SCALARS = np.array([-1.0, 0.0, 1.0])

_gemm: Any = External(
    "numba_xxgemm",  # numba's interface to BLAS, by pointers and leading dimensions
    "intc(char, char, char, intp, intp, intp, CPointer(f8), CPointer(f8), intp, CPointer(f8),"
    " intp, CPointer(f8), CPointer(f8), intp)",
)


@jit()
def product(a, b, out, scale, keep, turn_a, turn_b):
    """Out = scale · a b + keep · out, with a or b transposed if `turn_a` or `turn_b`.

    Rows are contiguous. Scale and keep are −1, 0 or 1, since BLAS takes their addresses.
    """
    inner = a.shape[0] if turn_a else a.shape[1]
    if out.size and inner:
        _gemm(
            ord("d"), ord("t") if turn_b else ord("n"), ord("t") if turn_a else ord("n"),
            out.shape[1], out.shape[0], inner, _SCALARS[int(scale) + 1 :].ctypes,
            b.ctypes, b.strides[0] // 8, a.ctypes, a.strides[0] // 8,
            _SCALARS[int(keep) + 1 :].ctypes, out.ctypes, out.strides[0] // 8,
        )  # fmt: skip


@jit()
def lower_product(a, b, out, scale, keep, turn_a, turn_b):
    """Compute the lower triangle, and a little more, of the result of `product`."""
    n = len(out)
    for j in range(0, n, _BAND):
        e = min(j + _BAND, n)
        rows = a[:, j:n] if turn_a else a[j:n, :]
        columns = b[j:e, :] if turn_b else b[:, j:e]
        product(rows, columns, out[j:n, j:e], scale, keep, turn_a, turn_b)


@jit()
def copy_into(given, out):
    """Copy a matrix: `out[:] = given` has an error message that takes seconds to compile."""
    for i in range(given.shape[0]):
        for j in range(given.shape[1]):
            out[i, j] = given[i, j]


@jit()
def take_square(a, first, out):
    """Subtract aᵀ a from the lower triangle of `out`, and from a little more.

    In column j of a, the rows before first[j] are zeros.
    """
    n = len(out)
    for j in range(0, n, _BAND):
        e = min(j + _BAND, n)
        begin = first[j:e].min()
        product(a[begin:, j:n], a[begin:, j:e], out[j:n, j:e], -1.0, 1.0, True, False)


@jit()
def mirrored_into(lower, out):
    """Write a symmetric matrix from its lower triangle, by tiles for local memory access."""
    n = len(out)
    for i in range(0, n, _TILE):
        for j in range(0, i + 1, _TILE):
            for x in range(i, min(i + _TILE, n)):
                for y in range(j, min(j + _TILE, x + 1)):
                    out[x, y] = out[y, x] = lower[x, y]


@jit()
def triangle_square(root, out):
    """Compute the lower triangle, and a little more, of rootᵀ root for a lower triangular root."""
    n = len(out)
    for j in range(0, n, _BAND):
        e = min(j + _BAND, n)
        product(root[j:n, j:n], root[j:n, j:e], out[j:n, j:e], 1.0, 0.0, True, False)


@jit()
def turned_product(b, root, out):
    """Bᵀ root for a lower triangular root; leading zeros of the columns of b are skipped."""
    n = len(out)
    for j in range(0, n, _BAND):
        e = min(j + _BAND, n)
        begin = _first_row(b, j, e)
        product(b[j:n, 0:e], root[j:n, j:e], out[0:e, j:e], 1.0, 0.0, True, False)
        if j:
            product(b[begin:n, j:e], root[begin:n, 0:j], out[j:e, 0:j], 1.0, 0.0, True, False)


@jit()
def _first_row(b, begin, end):
    """First row with a non-zero in columns `begin` to `end`; the last row if there is none."""
    for i in range(len(b)):
        for j in range(begin, end):
            if b[i, j] != 0.0:
                return i
    return len(b) - 1


@jit()
def right_product(b, root, out, turned):
    """B root for a lower triangular root, or b rootᵀ if `turned`."""
    n = len(root)
    for j in range(0, n, _BAND):
        e = min(j + _BAND, n)
        if turned:
            product(b[:, :e], root[j:e, :e], out[:, j:e], 1.0, 0.0, False, True)
        else:
            product(b[:, j:n], root[j:n, j:e], out[:, j:e], 1.0, 0.0, False, False)


@jit()
def left_product(root, b, out, scale):
    """Scale · root b for a lower triangular root."""
    n = len(root)
    for j in range(0, n, _BAND):
        e = min(j + _BAND, n)
        product(root[j:e, :e], b[:e, :], out[j:e, :], scale, 0.0, False, False)


@jit()
def _first_and_last(row):
    """First non-zero column of a row and the end of its non-zeros; (n, 0) if all are zero."""
    first, last = 0, len(row)
    while first < last and row[first] == 0.0:
        first += 1
    while last > first and row[last - 1] == 0.0:
        last -= 1
    return (first, last) if first < last else (len(row), 0)


@jit()
def banded_product(root, b, out, first):
    """Root bᵀ for a lower triangular root and a b whose rows have a narrow band of non-zeros.

    Rows with overlapping bands are multiplied together. In column j of `out`, the rows before
    first[j] are zeros, which is written to `first` (n,).
    """
    n, j = len(root), 0
    low, high = _first_and_last(b[0])
    while j < n:
        e, begin, end = j + 1, low, high
        while e < n:
            low, high = _first_and_last(b[e])
            apart = max(low, begin) >= min(high, end) and low < high and begin < end
            if apart or e - j == _BAND:
                break
            begin, end, e = min(low, begin), max(high, end), e + 1
        out[:begin, j:e], first[j:e] = 0.0, begin
        if begin < end:
            product(
                root[begin:, begin:end], b[j:e, begin:end], out[begin:, j:e], 1.0, 0.0, False, True
            )
        j = e
