"""Factors whitened and summed into the normal equations, and squared innovations of readings.

A factor lies in the interval between two time nodes, or on the first of them. A time node has
D numbers: `dof` for each of its `n_count` arclength nodes, then those of sensor parameters.
Source: equations (19) and (20).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.blas import product
from glissando._kernels.jit import jit
from glissando._kernels.process import apply_into, whiten_into

_SIX = np.uint64(6)  # columns of one field of a node: pose, strain, velocity, strain rate
_ONE, _TWO, _THREE, _FOUR, _FIVE = (np.uint64(i) for i in range(1, 6))  # need no check of bounds
_BATCH = "i8[:,::1], i8, f8[:,:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1]"
SUMS = "f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1]"


@jit(inline=True)
def _is_zero(jacobian, node, first, last):
    """Whether a Jacobian is zero in the columns `first` to `last` of a node."""
    for y in range(len(jacobian)):
        for x in range(first, last):
            if jacobian[y, node, x] != 0.0:
                return False
    return True


@jit(inline=True)
def _begins_with_zeros(slopes, width):
    """Whether a Jacobian is zero in its first columns."""
    for y in range(len(slopes)):
        for x in range(width):
            if slopes[y, x] != 0.0:
                return False
    return True


@jit(inline=True)
def _groups(nodes, first_dof, jacobian, extras, n_count, dof, count, groups):
    """Interval of a factor, and number of its groups of non-zero columns, which are written.

    A group is up to six columns of a node, or adjacent columns of the parameters at one end of the
    interval. A row of `groups` has its end of the interval, its column there, its width, and its
    column in the Jacobian. A factor on the last node is of that node alone, as nodes follow it in
    a window.
    """
    c, d = jacobian.shape[1:]
    e = extras.shape[1] // 2
    k, filled, ahead = nodes[0] // n_count, 0, 0
    if e and 0 < k == count - 1:  # slopes by parameters are of the interval that ends there
        ahead = 1 if _begins_with_zeros(extras, e) else 0
        k -= 1 - ahead
    for a in range(c):
        slab = nodes[a] // n_count
        first = (nodes[a] - slab * n_count) * dof + first_dof
        for part in range(0, d if slab < count else 0, 6):
            end = min(part + 6, d)
            if not _is_zero(jacobian, np.uint64(a), np.uint64(part), np.uint64(end)):
                groups[filled, 0], groups[filled, 1] = slab - k, first + part
                groups[filled, 2], groups[filled, 3] = end - part, a * d + part
                filled += 1
    for later in range(ahead, 2 if e else 0):
        if k + later - ahead < count:  # parameters after the last node have no weight
            first, at = n_count * dof, c * d + later * e
            filled = _add_runs(
                extras[:, later * e : later * e + e], later - ahead, first, at, groups, filled
            )
    return k, filled


@jit(inline=True)
def _add_runs(slopes, later, first, at, groups, filled):
    """Add runs of non-zero columns of parameters to the groups; returns the new number."""
    begin, count = -1, slopes.shape[1]
    for x in range(count + 1):
        live = False
        for y in range(len(slopes) if x < count else 0):
            live = live or slopes[y, x] != 0.0
        if live and begin < 0:
            begin = x
        elif not live and begin >= 0:
            groups[filled, 0], groups[filled, 1] = later, first + begin
            groups[filled, 2], groups[filled, 3] = x - begin, at + begin
            filled, begin = filled + 1, -1
    return filled


@jit(inline=True)
def _whitened(sqrt_info, jacobian, extras, residual, groups, filled, slopes, white, miss):
    """Whiten the Jacobian (r, ·) of adjacent groups and the residual (r,); returns the width."""
    r, wide, width = len(miss), jacobian.shape[1] * jacobian.shape[2], 0
    rows = jacobian.reshape(r, wide)
    for g in range(filled):
        at, columns = groups[g, 3], groups[g, 2]
        if at < wide and columns == 6:
            first, to = np.uint64(at), np.uint64(width)
            for i in range(r):
                for j in range(_SIX):
                    slopes[i, to + j] = rows[i, first + j]
        else:
            for i in range(r):
                for j in range(columns):
                    slopes[i, width + j] = (
                        rows[i, at + j] if at < wide else extras[i, at - wide + j]
                    )
        width += columns
    apply_into(sqrt_info, residual, miss)
    product(sqrt_info, slopes[:, :width], white[:, :width], 1.0, 0.0, False, False)
    return width


@jit(inline=True)
def _subtract_gradient(weight, miss, white, first, columns, rhs, k, at):
    """Subtract Jᵀr of a group, whitened and weighted, from a right-hand side."""
    if columns == 6:
        column, a, b, c, d, e, f = np.uint64(first), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for y in range(len(miss)):
            pull = weight * miss[y]
            a, b = a + pull * white[y, column], b + pull * white[y, column + _ONE]
            c, d = c + pull * white[y, column + _TWO], d + pull * white[y, column + _THREE]
            e, f = e + pull * white[y, column + _FOUR], f + pull * white[y, column + _FIVE]
        for x, value in enumerate((a, b, c, d, e, f)):
            rhs[k, at + x] -= value
        return
    for y in range(len(miss)):
        for x in range(columns):
            rhs[k, at + x] -= weight * miss[y] * white[y, first + x]


@jit(inline=True)
def _add_six(weight, square, row, column, blocks, k, at, beside):
    """Add a weighted part (6, 6) of JᵀJ to a block; a row is read before it is written."""
    for x in range(_SIX):
        i, j = row + x, at + x
        a, b, c = square[i, column], square[i, column + _ONE], square[i, column + _TWO]
        d, e = square[i, column + _THREE], square[i, column + _FOUR]
        f = square[i, column + _FIVE]
        a, b = blocks[k, j, beside] + weight * a, blocks[k, j, beside + _ONE] + weight * b
        c, d = blocks[k, j, beside + _TWO] + weight * c, blocks[k, j, beside + _THREE] + weight * d
        e, f = blocks[k, j, beside + _FOUR] + weight * e, blocks[k, j, beside + _FIVE] + weight * f
        blocks[k, j, beside], blocks[k, j, beside + _ONE], blocks[k, j, beside + _TWO] = a, b, c
        blocks[k, j, beside + _THREE], blocks[k, j, beside + _FOUR] = d, e
        blocks[k, j, beside + _FIVE] = f


@jit(inline=True)
def _add_part(weight, square, row, column, height, wide, blocks, k, at, beside):
    """Add a weighted part (height, wide) of JᵀJ to a block."""
    if height == wide == 6:
        _add_six(
            weight, square, np.uint64(row), np.uint64(column), blocks, np.uint64(k), np.uint64(at),
            np.uint64(beside),
        )  # fmt: skip
        return
    for x in range(height):
        for y in range(wide):
            blocks[k, at + x, beside + y] += weight * square[row + x, column + y]


@jit()
def add_factor(
    nodes, first_dof, jacobian, residual, sqrt_info, extras, weight, n_count, dof,
    begin, end, across, rhs_begin, rhs_end, slopes, white, miss, square, room,
):  # fmt: skip
    """Whiten a factor and add it to the blocks of intervals; the last five arrays are scratch."""
    count, row = len(begin), 0
    k, filled = _groups(nodes, first_dof, jacobian, extras, n_count, dof, count, room)
    width = _whitened(sqrt_info, jacobian, extras, residual, room, filled, slopes, white, miss)
    live = white[: len(residual), :width]
    product(live, live, square[:width, :width], 1.0, 0.0, True, False)
    for a in range(filled):
        late, at, height, column = room[a, 0], room[a, 1], room[a, 2], 0
        _subtract_gradient(weight, miss, white, row, height, rhs_end if late else rhs_begin, k, at)
        for b in range(filled):
            beside, wide = room[b, 1], room[b, 2]
            if room[b, 0] <= late:
                blocks = begin
                if late:
                    blocks = end if room[b, 0] else across
                _add_part(weight, square, row, column, height, wide, blocks, k, at, beside)
            column += wide
        row += height


@jit(f"({_BATCH}, f8[::1], i8, i8, {SUMS})")
def accumulate(
    nodes, first_dof, jacobian, residual, sqrt_info, extras, weights, n_count, dof,
    begin, end, across, rhs_begin, rhs_end,
):  # fmt: skip
    """Add JᵀJ and −Jᵀr of a batch to the blocks of intervals.

    `begin` and `end` (·, D, D) are of the time node where an interval begins and ends, `across`
    couples its end (rows) with its beginning (columns).
    """
    m, r, c, d = jacobian.shape
    q = c * d + extras.shape[2]
    slopes, white, miss = np.empty((r, q)), np.empty((r, q)), np.empty(r)
    square, room = np.empty((q, q)), np.empty((q + 2, 4), np.int64)
    for i in range(m):
        add_factor(
            nodes[i], first_dof, jacobian[i], residual[i], sqrt_info[i], extras[i], weights[i],
            n_count, dof, begin, end, across, rhs_begin, rhs_end, slopes, white, miss, square, room,
        )  # fmt: skip


@jit(f"({_BATCH}, i8[::1], i8, i8, f8[:,:,::1], f8[:,:,::1], i8[::1], f8[:,::1], f8[::1])")
def squared_innovations(
    nodes, first_dof, jacobian, residual, sqrt_info, extras, which, n_count, dof,
    inverse, coupling, slot, step, weight,
):  # fmt: skip
    """Squared innovations of `which` factors (M,) of a batch, each against all others.

    `inverse` and `coupling` are the block Cholesky factor, its slabs in the order `slot` (K,), of a
    system that contains each factor with a `weight` w (M,) and is solved by `step` (K, D). With
    G = Y Yᵀ the white covariance of its prediction and S = 1 − w G, a white residual e at the
    solution corresponds to the innovation S⁻¹ e of covariance S⁻¹ (S + G), whose normalised square
    is eᵀ (S (S + G))⁻¹ e.
    """
    r, c, d = jacobian.shape[1:]
    q, count, size, m = c * d + extras.shape[2], len(slot), step.shape[1], len(which)
    slopes, white, room = np.empty((r, q)), np.empty((r, q)), np.empty((q + 2, 4), np.int64)
    rows, miss, first = np.zeros((count, m * r, size)), np.empty((m, r)), count
    begins = np.zeros(m + 1, np.int64)
    for n in range(m):
        i = which[n]
        k, filled = _groups(nodes[i], first_dof, jacobian[i], extras[i], n_count, dof, count, room)
        column = 0
        width = _whitened(
            sqrt_info[i], jacobian[i], extras[i], residual[i], room, filled, slopes, white, miss[n]
        )
        live, first = _nonzero_rows(white[:, :width], miss[n]), min(first, k)
        begins[n + 1] = begins[n] + live
        for g in range(filled):
            slab, at = k + room[g, 0], room[g, 1]
            for y in range(live):
                for x in range(room[g, 2]):
                    rows[slab, begins[n] + y, at + x] = white[y, column + x]
                    miss[n, y] += white[y, column + x] * step[slab, at + x]
            column += room[g, 2]
    return _squared(rows[first:], begins, inverse, coupling, slot[first:], miss, weight)


@jit(inline=True)
def _nonzero_rows(white, miss):
    """Number of rows before those at the end that are zero in Jacobian and residual."""
    live = len(white)
    while live > 1 and miss[live - 1] == 0.0 and not white[live - 1].any():
        live -= 1
    return live


@jit(inline=True)
def _explained(rows, root, out):
    """Rows with few non-zero columns times the transpose of a lower triangular root."""
    low, high = rows.shape[1], 0
    for i in range(len(rows)):
        for j in range(rows.shape[1]):
            if rows[i, j] != 0.0:
                low, high = min(low, j), max(high, j + 1)
            out[i, j] = 0.0
    if low < high:
        product(rows[:, low:high], root[low:, low:high], out[:, low:], 1.0, 0.0, False, True)


@jit(inline=True)
def _squared(rows, begins, inverse, coupling, slot, miss, weight):
    """Normalised squares (M,), from white Jacobians (K, ·, D), residuals (M, r), and weights."""
    m, r = miss.shape
    gain, share, root, out = np.zeros((m, r, r)), np.empty((r, r)), np.empty((r, r)), np.zeros(m)
    cov, count = np.empty((r, r)), begins[m]
    before, explained = np.empty((count, rows.shape[2])), np.empty((count, rows.shape[2]))
    for k in range(len(rows)):
        live = rows[k, :count]
        if k:
            product(before, coupling[slot[k - 1]], live, -1.0, 1.0, False, False)
            product(live, inverse[slot[k]], explained, 1.0, 0.0, False, True)
        for n in range(m):
            first, size = begins[n], begins[n + 1] - begins[n]
            own = explained[first : first + size]
            if k == 0:  # columns of few nodes
                _explained(live[first : first + size], inverse[slot[0]], own)
            for a in range(size):
                for b in range(size):
                    for j in range(own.shape[1]):
                        gain[n, a, b] += own[a, j] * own[b, j]
        before, explained = explained, before
    for n in range(m):
        for a in range(r):
            for b in range(r):
                share[a, b] = (1.0 + 1e-9) * (a == b) - weight[n] * gain[n, a, b]
                gain[n, a, b] += share[a, b]
        product(share, gain[n], cov, 1.0, 0.0, False, False)
        whiten_into(cov, root)
        for a in range(r):
            value = 0.0
            for b in range(a + 1):
                value += root[a, b] * miss[n, b]
            out[n] += value * value
    return out


@jit(inline=True)
def at_nodes_into(by_state, jacobian, left, cov, out, whitener):
    """Jacobian (r, c, d) of a residual by nodes, into zeros, and its whitener: see `at_nodes`."""
    r, dof = by_state.shape
    c, d = jacobian.shape[1:]
    half, whole = np.zeros((r, dof)), np.empty((r, r))
    for i in range(r):
        for k in range(dof):
            share = by_state[i, k]
            if share != 0.0:  # most of them are zero
                for j in range(dof):
                    half[i, j] += share * left[k, j]
                for a in range(c):
                    for j in range(d):
                        out[i, a, j] += share * jacobian[k, a, j]
    for i in range(r):
        for j in range(r):
            whole[i, j] = cov[i, j]
            for k in range(dof):
                whole[i, j] += half[i, k] * by_state[j, k]
    whiten_into(whole, whitener)


@jit("(f8[:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1])")
def at_nodes(by_state, jacobian, left, cov):
    """Jacobians of residuals by nodes (M, r, c, d), and their whiteners (M, r, r).

    `by_state` (M, r, 18) is that by the state between the nodes, which has the Jacobian `jacobian`
    (M, 18, c, d) and the bridge covariance `left` (M, 18, 18), added to `cov` (M, r, r): (13).
    """
    m, r = by_state.shape[:2]
    c, d = jacobian.shape[2:]
    out, whitener = np.zeros((m, r, c, d)), np.empty((m, r, r))
    for n in range(m):
        at_nodes_into(by_state[n], jacobian[n], left[n], cov[n], out[n], whitener[n])
    return out, whitener
