"""Factors whitened, summed into the normal equations, and judged.

A factor lies in the interval between two time nodes, or on the first of them. A time node has
`size` numbers: `dof` for each of its `n_count` arclength nodes, then those of sensor parameters.
Source: equations (19) and (20).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.process import whiten_into

_BATCH = "i8[:,::1], i8, f8[:,:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1]"


@jit()
def _whitened(sqrt_info, jacobian, extras, residual, white, miss):
    """White Jacobian (r, q) of one factor, parameters' columns last, and white residual (r,)."""
    r, wide = len(miss), jacobian.shape[1] * jacobian.shape[2]
    rows = jacobian.reshape(r, wide)
    for i in range(r):
        miss[i] = 0.0
        for j in range(white.shape[1]):
            white[i, j] = 0.0
        for k in range(r):
            share = sqrt_info[i, k]
            if share != 0.0:
                miss[i] += share * residual[k]
                for j in range(wide):
                    white[i, j] += share * rows[k, j]
                for j in range(extras.shape[1]):
                    white[i, wide + j] += share * extras[k, j]


@jit()
def _places(nodes, first_dof, d, extras, n_count, dof, count, place):
    """Interval of a factor; of each group of its columns: end of the interval, column, width."""
    k = nodes[0] // n_count
    if extras:
        k = min(k, max(count - 2, 0))
    for a in range(len(nodes)):
        slab, inner = divmod(nodes[a], n_count)
        place[a, 0], place[a, 1], place[a, 2] = slab - k, inner * dof + first_dof, d
    for later in range(2):
        a = len(nodes) + later
        place[a, 0], place[a, 1], place[a, 2] = later, n_count * dof, extras
    return k


@jit(f"({_BATCH}, f8[::1], i8, i8, f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1])")
def accumulate(
    nodes, first_dof, jacobian, residual, sqrt_info, extras, weights, n_count, dof,
    begin, end, across, rhs_begin, rhs_end,
):  # fmt: skip
    """Add JᵀJ and −Jᵀr of a batch to the blocks of intervals.

    `begin` and `end` (·, D, D) are of the time node where an interval begins and ends, `across`
    couples its end (rows) with its beginning (columns).
    """
    m, r, c, d = jacobian.shape
    e, count = extras.shape[2] // 2, len(begin)
    q = c * d + 2 * e
    white, miss, square = np.empty((r, q)), np.empty(r), np.empty((q, q))
    place = np.empty((c + 2, 3), np.int64)
    for i in range(m):
        k = _places(nodes[i], first_dof, d, e, n_count, dof, count, place)
        _whitened(sqrt_info[i], jacobian[i], extras[i], residual[i], white, miss)
        for a in range(q):
            for b in range(a + 1):
                square[a, b] = 0.0
        for y in range(r):
            for a in range(q):
                for b in range(a + 1):
                    square[a, b] += white[y, a] * white[y, b]
        for a in range(q):
            for b in range(a):
                square[b, a] = square[a, b]
        row = 0
        for a in range(c + 2):
            late, at, width = place[a, 0], place[a, 1], place[a, 2]
            if k + late < count:
                for x in range(width):
                    pull = 0.0
                    for y in range(r):
                        pull += white[y, row + x] * miss[y]
                    if late:
                        rhs_end[k, at + x] -= weights[i] * pull
                    else:
                        rhs_begin[k, at + x] -= weights[i] * pull
                column = 0
                for b in range(c + 2):
                    if place[b, 0] <= late and (place[b, 0] or not late or k < len(across)):
                        block = begin[k]
                        if late:
                            block = end[k] if place[b, 0] else across[k]
                        for x in range(width):
                            for y in range(place[b, 2]):
                                block[at + x, place[b, 1] + y] += (
                                    weights[i] * square[row + x, column + y]
                                )
                    column += place[b, 2]
            row += width


@jit(f"({_BATCH}, i8, i8, i8, i8)")
def spread_out(
    nodes, first_dof, jacobian, residual, sqrt_info, extras, n_count, dof, size, count
):  # fmt: skip
    """Whitened residuals (M, r) and Jacobians (M, r, count · size) by all time nodes."""
    m, r, c, d = jacobian.shape
    e = extras.shape[2] // 2
    white, place = np.empty((r, c * d + 2 * e)), np.empty((c + 2, 3), np.int64)
    out, miss = np.zeros((m, r, count * size)), np.empty((m, r))
    for i in range(m):
        k = _places(nodes[i], first_dof, d, e, n_count, dof, count, place)
        _whitened(sqrt_info[i], jacobian[i], extras[i], residual[i], white, miss[i])
        column = 0
        for a in range(c + 2):
            at = (k + place[a, 0]) * size + place[a, 1]
            for x in range(place[a, 2]):
                if at + x < count * size:  # parameters after the last node have no weight
                    for y in range(r):
                        out[i, y, at + x] = white[y, column + x]
            column += place[a, 2]
    return miss, out


@jit("(f8[:,::1], f8[:,:,::1])")
def squared_innovations(residual, explained):
    """Squared innovations (M,) of white residuals (M, r): eᵀ (1 − Y Yᵀ)⁻¹ e."""
    m, r = residual.shape
    out, share, root = np.zeros(m), np.empty((r, r)), np.empty((r, r))
    for i in range(m):
        for a in range(r):
            for b in range(r):
                share[a, b] = (1.0 + 1e-9) * (a == b)
                for k in range(explained.shape[2]):
                    share[a, b] -= explained[i, a, k] * explained[i, b, k]
        whiten_into(share, root)
        for a in range(r):
            value = 0.0
            for b in range(a + 1):
                value += root[a, b] * residual[i, b]
            out[i] += value * value
    return out


@jit("(f8[:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1])")
def at_nodes(by_state, jacobian, left, cov):
    """Slopes of residuals by nodes (M, r, c, d), and what whitens the residuals (M, r, r).

    `by_state` (M, r, 18) is their slope by the state between the nodes, which has slopes `jacobian`
    (M, 18, c, d) and what nodes `left` uncertain (M, 18, 18), added to `cov` (M, r, r): (13).
    """
    m, r, dof = by_state.shape
    c, d = jacobian.shape[2:]
    out, whitener = np.zeros((m, r, c, d)), np.empty((m, r, r))
    half, whole = np.empty((r, dof)), np.empty((r, r))
    for n in range(m):
        for i in range(r):
            for j in range(dof):
                half[i, j] = 0.0
            for k in range(dof):
                share = by_state[n, i, k]
                if share != 0.0:  # a sensor sees little of a state
                    for j in range(dof):
                        half[i, j] += share * left[n, k, j]
                    for a in range(c):
                        for j in range(d):
                            out[n, i, a, j] += share * jacobian[n, k, a, j]
        for i in range(r):
            for j in range(r):
                whole[i, j] = cov[n, i, j]
                for k in range(dof):
                    whole[i, j] += half[i, k] * by_state[n, j, k]
        whiten_into(whole, whitener[n])
    return out, whitener
