"""The normal equations of a sliding window, kept by interval: summed, factored, solved, dropped.

`blocks` (6, ·, D, D) are of every slab: what its interval adds where it begins, where it ends and
across, the diagonal, and of the factor the inverse and the coupling. `vectors` (3, ·, D) are what
the interval adds to the right-hand side where it begins and ends, and that side solved forward.
Source: equations (19) and (20).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from glissando._kernels.blas import lower_product, product
from glissando._kernels.block_tridiagonal import backward, factor, forward
from glissando._kernels.jit import jit

BEGIN, END, ACROSS, DIAGONAL, INVERSE, COUPLING = range(6)
_WINDOW = "f8[:,:,:,::1], f8[:,:,::1], f8[:,::1], f8[::1], i8, i8"


@jit(f"({_WINDOW}, i8)")
def sum_intervals(blocks, vectors, info, rhs, first, stop, start):
    """Sum the intervals to diagonal and right-hand side, of slabs from `first` + `start` on.

    `info` (D, D) and `rhs` (D,) are what is known of the slab `first` from before.
    """
    d = len(rhs)
    for k in range(first + start, stop):
        begin, end, known = blocks[BEGIN, k], blocks[END, k - 1], k > first
        if not known:
            end = info
        ahead, behind = vectors[0, k], vectors[1, k - 1]
        if not known:
            behind = rhs
        for i in range(d):
            vectors[2, k, i] = ahead[i] + behind[i]
            row, other, out = begin[i], end[i], blocks[DIAGONAL, k, i]
            for j in range(d):
                out[j] = row[j] + other[j]


@jit(f"({_WINDOW}, i8, f8[:,::1], i8[::1])")
def solve(blocks, vectors, info, rhs, first, stop, start, step, at):
    """Sum, eliminate from slab `first` + `start` on and solve for the step (K, D) of all slabs.

    Returns what `factor` does.
    """
    sum_intervals(blocks, vectors, info, rhs, first, stop, start)
    inverse, coupling = blocks[INVERSE, first:stop], blocks[COUPLING, first : stop - 1]
    across = blocks[ACROSS, first : stop - 1]
    vanished = factor(blocks[DIAGONAL, first:stop], across, start, inverse, coupling, at)
    solved = vectors[2, first:stop]
    forward(inverse, coupling, solved, start)
    for k in range(len(solved)):
        for i in range(len(rhs)):
            step[k, i] = solved[k, i]
    backward(inverse, coupling, step)
    return vanished


@jit("(f8[:,:,:,::1], f8[:,:,::1], f8[:,::1], f8[::1], i8)")
def drop(blocks, vectors, info, rhs, first):
    """Overwrite `info` and `rhs` with what slab `first` and its interval say of the next slab."""
    d, end, coupling = len(rhs), blocks[END, first], blocks[COUPLING, first]
    for i in range(d):
        for j in range(d):
            info[i, j] = end[i, j]
        rhs[i] = vectors[1, first, i]
    lower_product(coupling, coupling, info, -1.0, 1.0, True)
    for j in range(d):
        row, value = coupling[j], vectors[2, first, j]
        for i in range(d):
            rhs[i] -= row[i] * value
        for i in range(j):
            info[i, j] = info[j, i]


@jit("(f8[:,::1], i8, i8, i8)")
def node_covariances(root, n_count, dof, size):
    """Covariances (N, size, size) of the first numbers of nodes of `dof`; rootᵀ root is theirs."""
    out = np.empty((n_count, size, size))
    for n in range(n_count):
        at = n * dof
        own = root[at:, at : at + size]
        product(own, own, out[n], 1.0, 0.0, True, False)
    return out


@jit("(f8[:,::1], f8[:,::1], i8, i8)")
def missed(root, step, n_count, dof):
    """Half the length of the newest step, in standard deviations, times the largest turn of any."""
    turn = length = 0.0
    for k in range(len(step)):
        for n in range(n_count):
            for i in range(3, 6):
                turn = max(turn, abs(step[k, n * dof + i]))
    for n in range(n_count):
        for i in range(6):
            variance = 0.0
            for j in range(len(root)):
                variance += root[j, n * dof + i] ** 2
            length = max(length, abs(step[-1, n * dof + i]) / sqrt(variance))
    return 0.5 * turn * length
