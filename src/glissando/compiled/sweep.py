"""Sums over factors and their innovations: twins of sweep.py and sums.py."""

from __future__ import annotations

import numpy as np

from glissando.compiled.jit import jit


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
def _side_by_side(jacobian, extras, out):
    """The Jacobian (r, c, d) of one factor as a matrix (r, q), its extras last."""
    wide = jacobian.shape[1] * jacobian.shape[2]
    out[:, :wide] = jacobian.reshape(len(out), wide)
    out[:, wide:] = extras


@jit
def add_factors(
    nodes, first_dof, jacobian, residual, sqrt_info, weights, extras, n_count, dof, size, blocks,
    pulls,
):  # fmt: skip
    """Add a batch of factors to the blocks of intervals."""
    m, r, c, d = jacobian.shape
    q = c * d + extras.shape[2]
    columns, white, row = np.empty(q, np.int64), np.empty((r, q)), np.empty((r, q))
    square = np.empty((q, q))
    for i in range(m):
        k = _columns(
            nodes[i], first_dof, d, extras.shape[2] // 2, n_count, dof, size, len(blocks), columns
        )
        _side_by_side(jacobian[i], extras[i], row)
        np.dot(sqrt_info[i], row, white)
        miss = np.dot(sqrt_info[i], residual[i])
        np.dot(white.T, white, square)
        for a in range(q):
            pull = 0.0
            for b in range(r):
                pull += white[b, a] * miss[b]
            pulls[k, columns[a]] -= weights[i] * pull
            for b in range(q):
                blocks[k, columns[a], columns[b]] += weights[i] * square[a, b]


@jit
def spread_out(nodes, first_dof, jacobian, residual, sqrt_info, extras, n_count, dof, size, count):
    """Whitened residuals (M, r) and Jacobians (M, r, count · D) with respect to all time nodes."""
    m, r, c, d = jacobian.shape
    q = c * d + extras.shape[2]
    columns, row, white = np.empty(q, np.int64), np.empty((r, q)), np.empty((r, q))
    out, miss = np.zeros((m, r, count * size)), np.empty((m, r))
    for i in range(m):
        k = _columns(
            nodes[i], first_dof, d, extras.shape[2] // 2, n_count, dof, size, count, columns
        )
        _side_by_side(jacobian[i], extras[i], row)
        np.dot(sqrt_info[i], row, white)
        miss[i] = np.dot(sqrt_info[i], residual[i])
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
    white, square = np.empty((r, c * d)), np.empty((c * d, c * d))
    for i in range(m):
        np.dot(sqrt_info[i], jacobian[i].reshape(r, c * d), white)
        miss = np.dot(sqrt_info[i], residual[i])
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
