"""Sums over factors and their innovations: twins of sweep.py."""

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
def squared_innovations(
    nodes, first_dof, jacobian, residual, sqrt_info, extras, n_count, dof, size, steps, cov, cross
):
    """Squared innovations (M,) of a batch at a solution."""
    m, r, c, d = jacobian.shape
    q, last = c * d + extras.shape[2], len(steps) - 1
    columns, row, joint = np.empty(q, np.int64), np.empty((r, q)), np.empty((q, q))
    out, x, slab = np.empty(m), np.empty(q), np.empty(q, np.int64)
    for i in range(m):
        k = _columns(
            nodes[i], first_dof, d, extras.shape[2] // 2, n_count, dof, size, len(steps), columns
        )
        _side_by_side(jacobian[i], extras[i], row)
        for a in range(q):
            later = columns[a] >= size
            slab[a], columns[a] = min(k + later, last), columns[a] - later * size
            x[a] = steps[slab[a], columns[a]]
        for a in range(q):
            ka, ca = slab[a], columns[a]
            for b in range(q):
                kb, cb = slab[b], columns[b]
                if ka == kb:
                    joint[a, b] = cov[ka, ca, cb]
                elif ka < kb:
                    joint[a, b] = cross[ka, ca, cb]
                else:
                    joint[a, b] = cross[kb, cb, ca]
        white = np.dot(sqrt_info[i], row)
        miss = np.dot(sqrt_info[i], residual[i]) + np.dot(white, x)
        share = (1.0 + 1e-9) * np.eye(r) - np.dot(white, np.dot(joint, white.T))
        out[i] = np.dot(miss, np.linalg.solve(share, miss))
    return out
