"""Rolls of a body about its z, which leave a curve and much of what is said of it as they are.

An error of the body frame turns with the roll. Its cost does not, where weights are alike across
z, and yet the slope of the error by the roll is −z × error, from which Gauss–Newton takes the roll
for known, the better the larger the error. Of an error that is turned back by the roll of its first
node, which costs the same, a roll of all its nodes has slope zero. Source: equation (35).
"""

from __future__ import annotations

from math import atan2, cos, sin

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import ahead_into
from glissando._kernels.scratch import matrix


@jit(inline=True)
def roll_into(pose, angle):
    """Turn a pose (4, 4) about its own z."""
    c, s = cos(angle), sin(angle)
    for i in range(3):
        x, y = pose[i, 0], pose[i, 1]
        pose[i, 0], pose[i, 1] = c * x + s * y, c * y - s * x


@jit(inline=True)
def roll_of(pose):
    """The angle about z of a pose (4, 4), after a turn about an axis across z."""
    return atan2(pose[1, 0] - pose[0, 1], pose[0, 0] + pose[1, 1])


@jit(inline=True)
def transversely_isotropic(density):
    """Whether densities (6,) are the same across z in every direction."""
    return density[0] == density[1] and density[3] == density[4]


@jit()
def turn_back(error, slopes):
    """Make slopes (r, c, dof) those of the error (r,) turned back by the roll of the first node.

    The error itself is the same at a roll of zero. Its numbers are three-vectors.
    """
    for i in range(0, len(error), 3):
        slopes[i, 0, 5] -= error[i + 1]
        slopes[i + 1, 0, 5] += error[i]


@jit()
def turn_on(angle, error, slopes):
    """Turn an error and its slopes about z, by what nodes rolled since weights were found."""
    if angle == 0.0:
        return
    c, s = cos(angle), sin(angle)
    for i in range(0, len(error), 3):
        x, y = error[i], error[i + 1]
        error[i], error[i + 1] = c * x - s * y, c * y + s * x
        for k in range(slopes.shape[1]):
            for j in range(slopes.shape[2]):
                x, y = slopes[i, k, j], slopes[i + 1, k, j]
                slopes[i, k, j], slopes[i + 1, k, j] = c * x - s * y, c * y + s * x


@jit("(f8[::1], f8[:,::1], f8[:,:,:,::1])")
def turn_all_back(angle, error, slopes):
    """Both for a list of errors (M, r) with slopes (M, r, c, dof) and angles (M,)."""
    for n in range(len(error)):
        turn_back(error[n], slopes[n])
        turn_on(angle[n], error[n], slopes[n])


@jit("(f8[:,:,::1], f8[:,:,::1])")
def rolls_between(before, after):
    """The angles (M,) by which poses (M, 4, 4) rolled about their z."""
    out, apart = np.empty(len(before)), matrix(4, 4)
    for n in range(len(before)):
        ahead_into(before[n], after[n], apart)
        out[n] = roll_of(apart)
    return out


@jit("(f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], i8)")
def slopes_between(before, here, after, there, dof):
    """How steps from poses (M, 4, 4) `after` go with those from `before` that led there.

    Args:
        before: Poses that rolled.
        here: Their fields (M, f) of the body frame, which turn with them.
        after: Where they are.
        there: Those fields now.
        dof: Numbers of a point, of which the first are the pose's and then these fields'.

    Returns:
        Slopes (M, dof, dof); see `State.slope_to`.
    """
    out, angle = np.zeros((len(before), dof, dof)), rolls_between(before, after)
    for n in range(len(before)):
        c, s, slope = cos(angle[n]), sin(angle[n]), out[n]
        for i in range(dof):
            slope[i, i] = 1.0
        for x in range(0, 6 + here.shape[1], 3):
            slope[x, x] = slope[x + 1, x + 1] = c
            slope[x, x + 1], slope[x + 1, x] = s, -s
            if x > 3:
                a, b = here[n, x - 6], here[n, x - 5]
                slope[x, 5] = there[n, x - 5] - c * b + s * a
                slope[x + 1, 5] = c * a + s * b - there[n, x - 6]
    return out


@jit("(f8[:,:,:,::1], f8[:,:,::1])")
def transport_columns(slopes, blocks):
    """Multiply blocks (K, R, D) on the right by the transposes of what `State.slope_to` returns.

    In place; `slopes` (K, N, dof, dof) turn pairs of numbers and add parts of the roll, number 5.
    """
    dof = slopes.shape[2]
    for k in range(len(slopes)):
        for r in range(blocks.shape[1]):
            for n in range(slopes.shape[1]):
                slope, row = slopes[k, n], blocks[k, r, n * dof : (n + 1) * dof]
                for x in range(0, dof, 3):
                    a, b = row[x], row[x + 1]
                    row[x] = slope[x, x] * a + slope[x, x + 1] * b
                    row[x + 1] = slope[x + 1, x] * a + slope[x + 1, x + 1] * b
                    if x > 3:
                        row[x] += slope[x, 5] * row[5]
                        row[x + 1] += slope[x + 1, 5] * row[5]


@jit("(f8[:,:,:,::1], f8[:,:,::1])")
def transport_rows(slopes, blocks):
    """Multiply blocks (K, D, C) on the left by what `State.slope_to` returns, in place."""
    dof = slopes.shape[2]
    for k in range(len(slopes)):
        for n in range(slopes.shape[1]):
            slope, rows = slopes[k, n], blocks[k, n * dof : (n + 1) * dof]
            for x in range(0, dof, 3):
                aa, ab, by_roll = slope[x, x], slope[x, x + 1], slope[x, 5] if x > 3 else 0.0
                ba, bb, too = (
                    slope[x + 1, x],
                    slope[x + 1, x + 1],
                    slope[x + 1, 5] if x > 3 else 0.0,
                )
                for c in range(rows.shape[1]):
                    a, b = rows[x, c], rows[x + 1, c]
                    rows[x, c] = aa * a + ab * b + by_roll * rows[5, c]
                    rows[x + 1, c] = ba * a + bb * b + too * rows[5, c]
