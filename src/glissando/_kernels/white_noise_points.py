"""States between nodes of the white-noise prior, conditional on them. Source: (10) to (12).

Arrays are those of `white_noise`.
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.blas import copy_into, product
from glissando._kernels.jit import jit
from glissando._kernels.process import middle_into
from glissando._kernels.scratch import matrix, vector
from glissando._kernels.steps import FREE, RIGID, bridged_into

STATE = "f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1]"


@jit()
def _carry(slope, inner, left, jacobian, first, cov):
    """Apply a Jacobian `slope` to Jacobians (18, 18) and covariance of an arclength step."""
    through, wide = matrix(18, 18), matrix(18, 18)
    for i in range(2):
        product(slope, inner[i], through, 1.0, 0.0, False, False)
        for a in range(18):
            for b in range(18):
                jacobian[a, first + i, b] = through[a, b]
    product(slope, left, wide, 1.0, 0.0, False, False)
    product(wide, slope, cov, 1.0, 1.0, False, True)


@jit()
def _bridge_rate(k, n, share, about, out):
    """Velocity at which the time step from node k, beyond arclength node n, is linearised."""
    for i in range(6):
        out[i] = 0.5 * (about[k, n, i] + about[k + 1, n, i])
        if share > 0.0:
            later = 0.5 * (about[k, n + 1, i] + about[k + 1, n + 1, i])
            out[i] = (1.0 - share) * out[i] + share * later


@jit()
def _on_line(
    n, step, offset, k, pose, strain, velocity, about, given, span, point, fields, slopes, left
):
    """Pose, strain and velocity at time node k, in interval n of arclength or on a node.

    Jacobians (2, 18, 18) by both nodes and covariance (18, 18) are written into zeros.
    """
    if not 0.0 < offset < step:
        copy_into(pose[k, n], point)
        for i in range(6):
            fields[0, i], fields[1, i] = strain[k, n, i], velocity[k, n, i]
        for i in range(18):
            slopes[0, i, i] = 1.0
        return
    density, middle = matrix(3, 6), vector(6)
    middle_into(about[k, n], about[k, n + 1], step, given[n, 0], given[n, 2], middle)
    for i in range(3):
        for j in range(6):
            density[i, j] = given[n, i, j] / span
    bridged_into(
        pose[k, n], pose[k, n + 1], strain[k, n], strain[k, n + 1], velocity[k, n],
        velocity[k, n + 1], step, offset, middle, density[0], density[1], density[2], RIGID,
        point, fields[0], fields[1], slopes[0], slopes[1], left,
    )  # fmt: skip


@jit()
def _between(
    n, share, k, step, offset, about, given, spans, poses, fields, slopes, around
):  # fmt: skip
    """State between two time nodes, the third of all arrays, from those there, the first two."""
    density, middle, span = matrix(3, 6), vector(6), spans[n]
    _bridge_rate(k, n, share, about, middle)
    if share > 0.0:
        span += share * (spans[n + 1] - span)
    for i in range(3):
        for j in range(6):
            density[i, j] = given[k, i, j] / span
    bridged_into(
        poses[0], poses[1], fields[0, 1], fields[1, 1], fields[0, 0], fields[1, 0], step, offset,
        middle, density[0], density[1], density[2], FREE, poses[2], fields[2, 1],
        fields[2, 0], slopes[2, 0], slopes[2, 1], around[2],
    )  # fmt: skip


@jit()
def lines():
    """Allocate scratch of `point_into`: states at both time nodes of a cell, and between."""
    fields, slopes, around = np.empty((3, 2, 6)), np.empty((3, 2, 18, 18)), np.empty((3, 18, 18))
    return np.empty((3, 4, 4)), fields, slopes, around


@jit()
def point_into(
    n, ds, us, k, dt, ut, pose, strain, velocity, about_strain, about_velocity, along, through,
    arclength_spans, time_spans, room, known, point, bend, motion, nodes, jacobian, left,
):  # fmt: skip
    """State in a cell; nodes (c,), Jacobian (18, c, 18) and covariance (18, 18) into zeros.

    Lower node, step and offset along arclength and time give the point. States are interpolated
    along arclength at one or both time nodes, unless `known` and in `room` already, then along
    time. Returns the number of nodes on which the state depends.
    """
    n_count, inside_s, inside_t = strain.shape[1], 0.0 < us < ds, 0.0 < ut < dt
    n += us >= ds > 0.0
    k += ut >= dt > 0.0
    wide, tall, share = 1 + inside_s, 1 + inside_t, us / ds if inside_s else 0.0
    poses, fields, slopes, around = room
    for part in range(tall):
        for i in range(wide):
            nodes[wide * part + i] = (k + part) * n_count + n + i
        if not known:
            slopes[part], around[part] = 0.0, 0.0
            _on_line(
                n, ds, us, k + part, pose, strain, velocity, about_strain, along,
                time_spans[k + part], poses[part], fields[part], slopes[part], around[part],
            )  # fmt: skip
    if inside_t:
        slopes[2], around[2] = 0.0, 0.0
        _between(
            n, share, k, dt, ut, about_velocity, through, arclength_spans, poses, fields, slopes,
            around,
        )  # fmt: skip
    last = 2 * inside_t
    copy_into(poses[last], point)
    copy_into(around[last], left)
    for i in range(6):
        bend[i], motion[i] = fields[last, 0, i], fields[last, 1, i]
    if inside_s and inside_t:
        for part in range(2):
            _carry(slopes[2, part], slopes[part], around[part], jacobian, 2 * part, left)
        return 4
    for i in range(wide * tall):
        for a in range(18):
            for b in range(18):
                jacobian[a, i, b] = slopes[last, i, a, b]
    return wide * tall


@jit(
    f"(i8[:,::1], f8[:,:,::1], {STATE}, f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1],"
    " f8[::1], f8[::1], i8)"
)
def points(
    lower, cell, pose, strain, velocity, about_strain, about_velocity, along, through,
    arclength_spans, time_spans, touched,
):  # fmt: skip
    """States at points that depend on `touched` nodes each, Jacobians, bridge covariances.

    `lower` (M, 2) are their cells' lower nodes and `cell` (M, 2, 2) the cells' steps and offsets,
    each along arclength and time.
    """
    m = len(lower)
    point, bend, motion = np.empty((m, 4, 4)), np.empty((m, 6)), np.empty((m, 6))
    nodes, jacobian = np.empty((m, touched), np.int64), np.zeros((m, 18, touched, 18))
    left, room, inside = np.zeros((m, 18, 18)), lines(), False
    for i in range(m):
        ds, us, dt, ut = cell[i, 0, 0], cell[i, 0, 1], cell[i, 1, 0], cell[i, 1, 1]
        known, inside = inside, 0.0 < ut < dt
        known = known and inside and us == cell[i - 1, 0, 1]
        for j in range(2):
            known = known and lower[i, j] == lower[i - 1, j]
        point_into(
            lower[i, 0], ds, us, lower[i, 1], dt, ut, pose, strain, velocity, about_strain,
            about_velocity, along, through, arclength_spans, time_spans, room, known, point[i],
            bend[i], motion[i], nodes[i], jacobian[i], left[i],
        )  # fmt: skip
    return point, bend, motion, nodes, jacobian, left
