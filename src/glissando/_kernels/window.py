"""The normal equations of a sliding window: summed, eliminated slab by slab, solved.

For every slab `blocks` (5, ·, D, D) hold the sum of its own interval, the information from all
older slabs, the coupling of its interval to the next slab, and inverse and coupling of the factor.
`vectors` (4, ·, D) hold the right-hand sides of the first two, their sum solved forward, and the
diagonal of the second before older slabs are eliminated. Slabs are stored in any order, at `slot`
(K,), so that none is ever moved; only lower halves of symmetric blocks are used. Source: equations
(19) and (20).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from glissando._kernels.blas import banded_product, copy_into, lower_product, product
from glissando._kernels.block_tridiagonal import (
    backward_slab,
    forward_slab,
    has_information,
    inverse_factor,
    less_coupling,
    subtract_coupling,
)
from glissando._kernels.jit import jit
from glissando._kernels.normal_equations import SUMS

BEGIN, KNOWN, ACROSS, INVERSE, COUPLING = range(5)
AHEAD, BEHIND, SOLVED, SCALE = range(4)


@jit()
def _information_from_older(blocks, vectors, own, older, end, rhs_end):
    """Information on a slab from older slabs, with the sums at the end of the last interval."""
    known, behind, coupling = blocks[KNOWN, own], vectors[BEHIND, own], blocks[COUPLING, older]
    for a in range(len(behind)):
        behind[a], vectors[SCALE, own, a] = rhs_end[a], end[a, a]
        for b in range(a + 1):
            known[a, b] = end[a, b]
    lower_product(coupling, coupling, known, -1.0, 1.0, True, False)
    subtract_coupling(coupling, vectors[SOLVED, older], behind)


@jit()
def _sum_slab(blocks, vectors, own, begin, rhs_begin, schur, scale):
    """Sum the matrix of a slab, into the lower half of `schur`, and its right-hand side."""
    known, own_sum = blocks[KNOWN, own], blocks[BEGIN, own]
    for a in range(len(scale)):
        scale[a] = begin[a, a] + vectors[SCALE, own, a]
        vectors[AHEAD, own, a] = rhs_begin[a]
        vectors[SOLVED, own, a] = rhs_begin[a] + vectors[BEHIND, own, a]
        for b in range(a + 1):
            own_sum[a, b], schur[a, b] = begin[a, b], begin[a, b] + known[a, b]


@jit(f"(f8[:,:,:,::1], f8[:,:,::1], i8[::1], i8, {SUMS}, f8[:,::1])")
def solve(blocks, vectors, slot, start, begin, end, across, rhs_begin, rhs_end, step):
    """Eliminate from slab `start` on, with sums of intervals from there on; solve for `step`.

    The step (K, D) is that of all slabs. Returns the same as `block_tridiagonal.factor`.
    """
    d, count, vanished = begin.shape[1], len(slot), -1
    schur, scale, first = np.zeros((d, d)), np.empty(d), np.empty(d, np.int64)
    for k in range(start, count):
        own, i = slot[k], k - start
        if i:
            _information_from_older(blocks, vectors, own, slot[k - 1], end[i - 1], rhs_end[i - 1])
        _sum_slab(blocks, vectors, own, begin[i], rhs_begin[i], schur, scale)
        inverse = blocks[INVERSE, own]
        if not inverse_factor(schur[0:d, 0:d], inverse[0:d, 0:d]):
            return k if vanished < 0 else vanished
        if k + 1 < count:
            copy_into(across[i], blocks[ACROSS, own])
            banded_product(inverse, across[i], blocks[COUPLING, own], first)
        forward_slab(inverse, vectors[SOLVED, own])
        if vanished < 0 and not has_information(inverse, scale):
            vanished = k
    _backward(blocks, vectors[SOLVED], slot, step)
    return vanished


@jit()
def _backward(blocks, solved, slot, step):
    """Backward substitution into `step` (K, D), from vectors solved forward (·, D)."""
    count = len(slot)
    for k in range(count - 1, -1, -1):
        own = slot[k]
        for a in range(step.shape[1]):
            step[k, a] = solved[own, a]
        if k + 1 < count:
            less_coupling(blocks[COUPLING, own], step[k + 1], step[k])
        backward_slab(blocks[INVERSE, own], step[k])


@jit("(f8[:,:,:,::1], f8[:,:,::1], i8[::1], i8, f8[:,::1], f8[:,::1], f8[:,::1])")
def respond(blocks, vectors, slot, start, rhs_begin, rhs_end, step):
    """Solve for another right-hand side with the present factor.

    `vectors` (2, ·, D) keep, for each slab, the part of older slabs and the sum solved forward; the
    sums (K − start, D) are of the intervals from slab `start` on, `step` (K, D) is the solution.
    """
    behind, solved = vectors[0], vectors[1]
    for k in range(start, len(slot)):
        own, i = slot[k], k - start
        if i:
            for a in range(step.shape[1]):
                behind[own, a] = rhs_end[i - 1, a]
            subtract_coupling(blocks[COUPLING, slot[k - 1]], solved[slot[k - 1]], behind[own])
        for a in range(step.shape[1]):
            solved[own, a] = rhs_begin[i, a] + behind[own, a]
        forward_slab(blocks[INVERSE, own], solved[own])
    _backward(blocks, solved, slot, step)


@jit("(f8[:,::1], i8, i8, i8)")
def node_covariances(root, n_count, dof, size):
    """Covariances (N, size, size) of the first components of nodes of `dof`, of rootᵀ root."""
    out = np.empty((n_count, size, size))
    for n in range(n_count):
        at = n * dof
        own = root[at:, at : at + size]
        product(own, own, out[n], 1.0, 0.0, True, False)
    return out


@jit("(f8[:,::1], f8[:,::1], i8, i8)")
def missed(root, step, n_count, dof):
    """Size of neglected curvature: half the newest step, in std, times the largest rotation.

    Both are largest components; a roll, however large, does not count as a rotation (35).
    """
    turn = length = 0.0
    for k in range(len(step)):
        for n in range(n_count):
            for i in range(3, 5):
                turn = max(turn, abs(step[k, n * dof + i]))
    for n in range(n_count):
        for i in range(5):
            variance = 0.0
            for j in range(len(root)):
                variance += root[j, n * dof + i] ** 2
            length = max(length, abs(step[-1, n * dof + i]) / sqrt(variance))
    return 0.5 * turn * length
