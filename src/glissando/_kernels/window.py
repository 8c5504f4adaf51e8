"""The normal equations of a sliding window, kept by interval: summed, factored, solved, dropped.

`blocks` (5, ·, D, D) are of every slab: what its interval adds where it begins, where it ends and
across, and of the factor the inverse and the coupling. `vectors` (3, ·, D) are what
the interval adds to the right-hand side where it begins and ends, and that side solved forward.
Source: equations (19) and (20).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from glissando._kernels.blas import banded_product, lower_product, product
from glissando._kernels.block_tridiagonal import (
    backward,
    forward,
    has_information,
    inverse_factor,
)
from glissando._kernels.jit import jit

BEGIN, END, ACROSS, INVERSE, COUPLING = range(5)
_WINDOW = "f8[:,:,:,::1], f8[:,:,::1], f8[:,::1], f8[::1], i8, i8"


@jit(f"({_WINDOW}, i8, f8[:,:,::1])")
def sum_slab(blocks, vectors, info, rhs, first, k, at, diagonal):
    """Sum slab k to `diagonal[at]`, of which the lower half counts, and its right-hand side."""
    d, begin, end = len(rhs), blocks[BEGIN, k], blocks[END, k - 1]
    ahead, behind, out = vectors[0, k], vectors[1, k - 1], diagonal[at]
    if k == first:
        end, behind = info, rhs
    for i in range(d):
        vectors[2, k, i] = ahead[i] + behind[i]
        for j in range(d):
            out[i, j] = begin[i, j] + end[i, j]


@jit(f"({_WINDOW}, i8, f8[:,::1], i8[::1])")
def solve(blocks, vectors, info, rhs, first, stop, start, step, at):
    """Sum, eliminate from slab `first` + `start` on and solve for the step (K, D) of all slabs.

    Returns what `factor` does, and raises what it does.
    """
    d, vanished, inverse, coupling = len(rhs), -1, blocks[INVERSE], blocks[COUPLING]
    schur, scale = np.empty((1, d, d)), np.empty(d)
    for k in range(first + start, stop):
        at[0] = k - first
        sum_slab(blocks, vectors, info, rhs, first, k, 0, schur)
        for i in range(d):
            scale[i] = schur[0, i, i]
        if k > first:
            lower_product(coupling[k - 1], coupling[k - 1], schur[0], -1.0, 1.0, True)
        inverse_factor(schur[0, 0:d, 0:d], inverse[k, 0:d, 0:d])
        if k + 1 < stop:
            banded_product(inverse[k], blocks[ACROSS, k], coupling[k])
        if vanished < 0 and not has_information(inverse[k], scale):
            vanished = k - first
    inverse, coupling = inverse[first:stop], coupling[first : stop - 1]
    solved = vectors[2, first:stop]
    forward(inverse, coupling, solved, start)
    for k in range(len(solved)):
        for i in range(d):
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
