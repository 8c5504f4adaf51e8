"""Rolls of a body about its z, which leave its curve unchanged.

An error in the body frame rotates with the roll. Its cost does not change if weights are equal in x
and y, but the derivative of the error by the roll is −z × error, which Gauss–Newton counts as
information about the roll, the more of it the larger the error. An error rotated back by the roll
of its first node has the same cost, and a zero derivative by a common roll of all nodes. Source:
equation (35).
"""

from __future__ import annotations

from math import atan2, cos, sin

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import ahead_into
from glissando._kernels.scratch import matrix


@jit(inline=True)
def roll_into(pose, angle):
    """Rotate a pose (4, 4) about its own z, in place."""
    c, s = cos(angle), sin(angle)
    for i in range(3):
        x, y = pose[i, 0], pose[i, 1]
        pose[i, 0], pose[i, 1] = c * x + s * y, c * y - s * x


@jit(inline=True)
def roll_of(pose):
    """Roll about z of a pose (4, 4), applied after a rotation about an axis across z."""
    return atan2(pose[1, 0] - pose[0, 1], pose[0, 0] + pose[1, 1])


@jit(inline=True)
def transversely_isotropic(density):
    """Whether densities (6,) are equal in x and y."""
    return density[0] == density[1] and density[3] == density[4]


@jit()
def turn_back(error, slopes):
    """Change slopes (r, c, dof) to those of the error (r,) rotated back by the first node's roll.

    The error itself is unchanged at a roll of zero. It consists of three-vectors.
    """
    for i in range(0, len(error), 3):
        slopes[i, 0, 5] -= error[i + 1]
        slopes[i + 1, 0, 5] += error[i]


@jit()
def turn_on(angle, error, slopes):
    """Rotate an error and its slopes about z, by the roll since weights were evaluated."""
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
    """`turn_back` and `turn_on` of errors (M, r), slopes (M, r, c, dof) and angles (M,)."""
    for n in range(len(error)):
        turn_back(error[n], slopes[n])
        turn_on(angle[n], error[n], slopes[n])


@jit("(f8[:,:,::1], f8[:,:,::1])")
def rolls_between(before, after):
    """Angles (M,), rad, by which poses (M, 4, 4) rolled about their z."""
    out, apart = np.empty(len(before)), matrix(4, 4)
    for n in range(len(before)):
        ahead_into(before[n], after[n], apart)
        out[n] = roll_of(apart)
    return out


@jit("(f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], i8)")
def slopes_between(before, here, after, there, dof):
    """Jacobians of steps from poses (M, 4, 4) `after` by steps from poses `before`.

    Args:
        before: Poses before the roll.
        here: Body-frame fields (M, f) before the roll, which rotate with the bodies.
        after: Poses after the roll.
        there: Body-frame fields (M, f) after the roll.
        dof: Degrees of freedom of a point: first those of the pose, then of these fields.

    Returns:
        Jacobians (M, dof, dof); see `State.slope_to`.
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
    """Multiply blocks (K, R, D) on the right by the transposes of results of `State.slope_to`.

    In place; `slopes` (K, N, dof, dof) rotate pairs of components and add multiples of the roll,
    which is component 5.
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
    """Multiply blocks (K, D, C) on the left by results of `State.slope_to`, in place."""
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
