"""Sums over factors and their innovations: twins of sweep.py and sums.py."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit


@jit
def _columns(nodes, first_dof, d, extras, n_count, dof, size, count, out):
    """Interval of a factor on `nodes` (c,); its columns (q,) there are written."""
    k = nodes[0] // n_count
    if extras:
        k = min(k, max(count - 2, 0))
    at = 0
    for node in nodes:
        slab, inner = divmod(node, n_count)
        begin = (slab - k) * size + inner * dof + first_dof
        for i in range(d):
            out[at] = begin + i
            at += 1
    for later in range(2):
        for i in range(extras):
            out[at] = later * size + n_count * dof + i
            at += 1
    return k


@jit
def _whitened(sqrt_info, jacobian, extras, residual, white, miss):
    """White Jacobian (r, q) of one factor, its extras last, and white residual (r,)."""
    r, wide = len(miss), jacobian.shape[1] * jacobian.shape[2]
    rows = jacobian.reshape(r, wide)
    white[:], miss[:] = 0.0, 0.0
    for i in range(r):
        for k in range(r):
            share = sqrt_info[i, k]
            if share != 0.0:
                miss[i] += share * residual[k]
                for j in range(wide):
                    white[i, j] += share * rows[k, j]
                for j in range(extras.shape[1]):
                    white[i, wide + j] += share * extras[k, j]


@jit
def add_factors(
    nodes, first_dof, jacobian, residual, sqrt_info, weights, extras, n_count, dof, size, blocks,
    pulls,
):  # fmt: skip
    """Add a batch of factors to the blocks of intervals."""
    m, r, c, d = jacobian.shape
    wide, q = c * d, c * d + extras.shape[2]
    columns, white, miss, line = np.empty(q, np.int64), np.empty((r, q)), np.empty(r), np.empty(q)
    for i in range(m):
        k = _columns(
            nodes[i], first_dof, d, extras.shape[2] // 2, n_count, dof, size, len(blocks), columns
        )
        _whitened(sqrt_info[i], jacobian[i], extras[i], residual[i], white, miss)
        for a in range(q):
            line[:], row = 0.0, blocks[k, columns[a]]
            for b in range(r):
                share = weights[i] * white[b, a]
                pulls[k, columns[a]] -= share * miss[b]
                for j in range(q):
                    line[j] += share * white[b, j]
            for first in range(0, wide, d):  # the numbers of a node stand side by side
                for j in range(d):
                    row[columns[first] + j] += line[first + j]
            for j in range(wide, q):
                row[columns[j]] += line[j]


@jit
def spread_out(nodes, first_dof, jacobian, residual, sqrt_info, extras, n_count, dof, size, count):
    """Whitened residuals (M, r) and Jacobians (M, r, count · D) with respect to all time nodes."""
    m, r, c, d = jacobian.shape
    q = c * d + extras.shape[2]
    columns, white = np.empty(q, np.int64), np.empty((r, q))
    out, miss = np.zeros((m, r, count * size)), np.empty((m, r))
    for i in range(m):
        k = _columns(
            nodes[i], first_dof, d, extras.shape[2] // 2, n_count, dof, size, count, columns
        )
        _whitened(sqrt_info[i], jacobian[i], extras[i], residual[i], white, miss[i])
        for a in range(q):
            at = k * size + columns[a]
            if at < count * size:  # unknowns after the last node have no weight
                for b in range(r):
                    out[i, b, at] = white[b, a]
    return miss, out


@jit
def squared_innovations(residual, known):
    """Squared innovations (M,) of residuals (M, r) of which `known` (M, r, …) is explained."""
    m, r = residual.shape
    out, share = np.empty(m), np.empty((r, r))
    for i in range(m):
        np.dot(known[i], known[i].T, share)
        for a in range(r):
            for b in range(r):
                share[a, b] = (1.0 + 1e-9) * (a == b) - share[a, b]
        out[i] = np.dot(residual[i], np.linalg.solve(share, residual[i]))
    return out


@jit
def add_to_neighbours(
    nodes, first_dof, jacobian, residual, sqrt_info, weights, n_count, blocks, right
):
    """Add a batch of factors to blocks of neighbouring nodes."""
    m, r, c, d = jacobian.shape
    white, square, miss = np.empty((r, c * d)), np.empty((c * d, c * d)), np.empty(r)
    none = np.empty((r, 0))
    for i in range(m):
        _whitened(sqrt_info[i], jacobian[i], none, residual[i], white, miss)
        np.dot(white.T, white, square)
        for b in range(c):
            slab, inner = divmod(nodes[i, b], n_count)
            for j in range(d):
                pull = 0.0
                for k in range(r):
                    pull += white[k, b * d + j] * miss[k]
                right[nodes[i, b], first_dof + j] -= weights[i] * pull
            for a in range(c):
                later, further = divmod(nodes[i, a], n_count)
                later, further = later - slab, further - inner
                which = -1
                if later == 0 and (further == 0 or further == 1):
                    which = further
                elif later == 1 and -1 <= further <= 1:
                    which = 3 + further
                if which >= 0:
                    block = blocks[which][slab, inner]
                    for j in range(d):
                        for k in range(d):
                            block[first_dof + j, first_dof + k] += (
                                weights[i] * square[a * d + j, b * d + k]
                            )
