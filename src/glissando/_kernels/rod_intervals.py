"""Intervals of a moving rod under loads: errors, states inside, and rates of both.

A node is its pose and its fields: strain, velocity, strain rate and, with inertia, acceleration and
its rate. A static Jacobian by a node has columns for pose, strain and acceleration.

Source: docs/math.md, equations (26), (27) and (32).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import (
    ad_into,
    adjoint_back_into,
    ahead_into,
    compose_into,
    exp_into,
    log_into,
    right_jacobian_into,
    right_jacobian_inverse_into,
)
from glissando._kernels.rod_flow import flow_into, flow_memory

STEP, STIFFNESS, REST, REST_SLOPE, WEIGHT, WEIGHT_SLOPE, END_STIFFNESS, END_REST, MASS = (
    0, 1, 7, 13, 19, 22, 25, 31, 37,
)  # fmt: skip
"""First columns of the parameters of intervals."""
NUDGE = 1e-4  # rad or so, step of difference quotients along the nodes' motion
_HALF = 15  # columns of a static Jacobian by a node, with inertia
_NOISELESS = np.False_  # not a literal, for which numba would compile flows a second time


@jit()
def _loads_into(rod, fields0, fields1, half, acting):
    """Weight and its change a metre (2, 3), with inertia between two nodes. Source: (32)."""
    for i in range(3):
        acting[0, i], acting[1, i] = rod[WEIGHT + i], rod[WEIGHT_SLOPE + i]
        if half == _HALF:
            early, late = -rod[MASS] * fields0[18 + i], -rod[MASS] * fields1[18 + i]
            acting[0, i] += early
            acting[1, i] = (late - early) / rod[STEP]


@jit()
def _undisturbed_end(pose, fields, rod, length, made, acting, memory, out):
    """Pose and strain at the end of an undisturbed rod, Jacobians by pose and strain, by weight.

    `made` (2, 6) are stiffness and rest strain at the end.
    """
    ahead, strain, phi, _, by_weight = out
    for i in range(6):
        strain[i] = rod[STIFFNESS + i] * (fields[i] - rod[REST + i])
    for i in range(12):
        for j in range(6):
            by_weight[i, j] = 0.0
    for i in range(4):
        for j in range(4):
            ahead[i, j] = 0.0
    given = rod[STIFFNESS:REST], rod[REST:REST_SLOPE], rod[REST_SLOPE:WEIGHT]
    loads = acting[0], acting[1], rod[:12]  # densities, which are not used
    flow_into(pose, length, given, loads, _NOISELESS, memory, out)
    for i in range(6):
        scale = 1.0 / made[0, i]
        strain[i] = made[1, i] + scale * strain[i]
        for j in range(12):
            phi[6 + i, j] *= scale
            phi[j, 6 + i] *= rod[STIFFNESS + i]
        for j in range(6):
            by_weight[6 + i, j] *= scale


@jit()
def _by_push(rod, by_weight, i, j):
    """Derivatives of a component by accelerations of both ends, from those by weight."""
    late = -rod[MASS] * by_weight[i, 3 + j] / rod[STEP]
    return -rod[MASS] * by_weight[i, j] - late, late


@jit()
def _apply_top(matrix, rows, slopes, end, half):
    """Multiply the first six rows of a Jacobian (2, 12, 15) by a matrix (6, 6)."""
    for j in range(half):
        for i in range(6):
            value = 0.0
            for k in range(6):
                value += matrix[i, k] * slopes[end, k, j]
            rows[i] = value
        for i in range(6):
            slopes[end, i, j] = rows[i]


@jit()
def _still(nodes, rod, half, work, error, slopes):
    """Error (12,) of an interval and its static Jacobians (2, 12, 15) by both nodes."""
    pose0, fields0, pose1, fields1 = nodes
    memory, out, acting, made, six, end_pose, miss, matrix, _, _ = work
    ahead, strain, phi, _, by_weight = out
    _loads_into(rod, fields0, fields1, half, acting)
    for i in range(6):
        made[0, i], made[1, i] = rod[END_STIFFNESS + i], rod[END_REST + i]
    _undisturbed_end(pose0, fields0, rod, rod[STEP], made, acting, memory, out)
    compose_into(pose0, ahead, end_pose)
    ahead_into(end_pose, pose1, miss)
    log_into(miss, six)
    for i in range(6):
        error[i], error[6 + i] = six[i], fields1[i] - strain[i]
        six[i] = -six[i]
    for i in range(12):
        for j in range(12):
            slopes[0, i, j], slopes[1, i, j] = -phi[i, j], 0.0
        for j in range(half - 12):
            early, late = _by_push(rod, by_weight, i, j)
            slopes[0, i, 12 + j], slopes[1, i, 12 + j] = -early, -late
    right_jacobian_inverse_into(six, matrix)
    _apply_top(matrix, six, slopes, 0, half)
    if half == _HALF:
        _apply_top(matrix, six, slopes, 1, half)
    for i in range(6):
        six[i] = error[i]
        slopes[1, 6 + i, 6 + i] = 1.0
    right_jacobian_inverse_into(six, matrix)
    for i in range(6):
        for j in range(6):
            slopes[1, i, j] = matrix[i, j]


@jit()
def _still_inside(nodes, rod, half, offset, gain, work, point, slopes):
    """Pose (4, 4) and strain (6,) inside an interval, static Jacobians (2, 12, 15)."""
    pose0, fields0 = nodes[0], nodes[1]
    pose, strain = point
    memory, out, acting, made, six, begin, bend, matrix, error, whole = work
    _still(nodes, rod, half, work, error, whole)
    for i in range(12):
        for end in range(2):
            for j in range(half):
                value = 0.0
                for k in range(12):
                    value += gain[i, k] * whole[end, k, j]
                slopes[end, i, j] = value
    for i in range(6):
        six[i] = strain[i] = 0.0
        for k in range(12):
            six[i] += gain[i, k] * error[k]
            strain[i] += gain[6 + i, k] * error[k]
        made[0, i] = rod[STIFFNESS + i]
        made[1, i] = rod[REST + i] + offset * rod[REST_SLOPE + i]
    _undisturbed_end(pose0, fields0, rod, offset, made, acting, memory, out)
    ahead, reached, phi, _, by_weight = out
    exp_into(six, bend)
    compose_into(pose0, ahead, begin)
    compose_into(begin, bend, pose)
    right_jacobian_into(six, matrix)
    _apply_top(matrix, six, slopes, 0, half)
    _apply_top(matrix, six, slopes, 1, half)
    adjoint_back_into(bend, matrix)
    for i in range(6):
        strain[i] += reached[i]
        for j in range(12):
            for k in range(6):
                slopes[0, i, j] += matrix[i, k] * phi[k, j]
            slopes[0, 6 + i, j] += phi[6 + i, j]
        for j in range(half - 12):
            for k in range(6):
                early, late = _by_push(rod, by_weight, k, j)
                slopes[0, i, 12 + j] += matrix[i, k] * early
                slopes[1, i, 12 + j] += matrix[i, k] * late
            early, late = _by_push(rod, by_weight, 6 + i, j)
            slopes[0, 6 + i, 12 + j] += early
            slopes[1, 6 + i, 12 + j] += late


@jit()
def _moved(pose, fields, time, half, six, turn, pose_out, fields_out):
    """Node after a `time` of its motion."""
    for i in range(6):
        six[i] = time * fields[6 + i]
        fields_out[i] = fields[i] + time * fields[12 + i]
    for i in range(half - 12):
        fields_out[18 + i] = fields[18 + i] + time * fields[21 + i]
    exp_into(six, turn)
    compose_into(pose, turn, pose_out)


@jit()
def _nudge(fields0, fields1, step):
    """Time, s, in which the nodes move by a small amount."""
    speed = 0.0
    for fields in (fields0, fields1):
        velocity = bend = 0.0
        for i in range(6):
            velocity += fields[6 + i] ** 2
        for i in range(3, 6):
            bend += fields[12 + i] ** 2
        speed += np.sqrt(velocity) + step * np.sqrt(bend)
    return NUDGE / (NUDGE + speed)


@jit()
def _motion(fields, j):
    """Rate of a node's component, in the order of a static Jacobian's columns."""
    return fields[6 + j] if j < 12 else fields[21 + j - 12]


@jit()
def _rates_into(nodes, nudge, half, slopes, matrix, six, rate, jacobian):
    """Rate (12,) of a value and Jacobian (24, 2, 2 half) of both, from static Jacobians.

    These, `slopes` (3, …), are at the nodes and at `nudge` s after and before. Motions of a pose do
    not commute, so the Jacobian by their bracket is subtracted from the change of the Jacobian.
    """
    for i in range(12):
        rate[i] = 0.0
    for end in range(2):
        fields = nodes[1] if end == 0 else nodes[3]
        for i in range(6):
            six[i] = fields[6 + i]
        ad_into(six, matrix)
        for i in range(12):
            for j in range(half):
                value = slopes[0, end, i, j]
                rate[i] += value * _motion(fields, j)
                still, moving = (j, 12 + j) if j < 12 else (12 + j, half + j)
                jacobian[i, end, still] = jacobian[12 + i, end, moving] = value
                jacobian[i, end, moving] = 0.0
                change = (slopes[1, end, i, j] - slopes[2, end, i, j]) / (2.0 * nudge)
                if j < 6:
                    for k in range(6):
                        change -= slopes[0, end, i, k] * matrix[k, j]
                jacobian[12 + i, end, still] = change


@jit()
def _work():
    """Allocate arrays for the intermediate results of the functions above."""
    out = (
        np.empty((4, 4)), np.empty(6), np.empty((12, 12)), np.empty((12, 12)), np.empty((12, 6)),
    )  # fmt: skip
    return (
        flow_memory(), out, np.empty((2, 3)), np.empty((2, 6)), np.empty(6), np.empty((4, 4)),
        np.empty((4, 4)), np.empty((6, 6)), np.empty(12), np.empty((2, 12, _HALF)),
    )  # fmt: skip


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], i8)")
def still_error(pose0, pose1, fields0, fields1, rods, half):
    """Errors (M, 12) of intervals, Jacobians (M, 12, 2, half) by both nodes."""
    m, work, slopes = len(rods), _work(), np.empty((2, 12, _HALF))
    error, jacobian = np.empty((m, 12)), np.empty((m, 12, 2, half))
    for n in range(m):
        nodes = pose0[n], fields0[n], pose1[n], fields1[n]
        _still(nodes, rods[n], half, work, error[n], slopes)
        for i in range(12):
            for end in range(2):
                for j in range(half):
                    jacobian[n, i, end, j] = slopes[end, i, j]
    return error, jacobian


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], i8)")
def interval_error(pose0, pose1, fields0, fields1, rods, half):
    """Errors [r; ṙ] (M, 24) of intervals, Jacobians (M, 24, 2, 2 half) by both nodes."""
    m, work, turn, slopes = len(rods), _work(), np.empty((4, 4)), np.empty((3, 2, 12, _HALF))
    error, aside = np.empty((m, 24)), np.empty(12)
    jacobian = np.empty((m, 24, 2, 2 * half))
    moved = np.empty((4, 4)), np.empty(24), np.empty((4, 4)), np.empty(24)
    six, matrix = work[4], work[7]
    for n in range(m):
        nodes = pose0[n], fields0[n], pose1[n], fields1[n]
        nudge = _nudge(fields0[n], fields1[n], rods[n, STEP])
        _still(nodes, rods[n], half, work, error[n, :12], slopes[0])
        for side in range(1, 3):
            time = nudge if side == 1 else -nudge
            _moved(pose0[n], fields0[n], time, half, six, turn, moved[0], moved[1])
            _moved(pose1[n], fields1[n], time, half, six, turn, moved[2], moved[3])
            _still(moved, rods[n], half, work, aside, slopes[side])
        _rates_into(nodes, nudge, half, slopes, matrix, six, error[n, 12:], jacobian[n])
    return error, jacobian


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,:,::1], i8)")
def interval_between(pose0, pose1, fields0, fields1, rods, offset, gain, half):
    """Poses, fields (M, 18) and Jacobians (M, 24, 2, 2 half) by both nodes, of points inside."""
    m, work, turn, slopes = len(rods), _work(), np.empty((4, 4)), np.empty((3, 2, 12, _HALF))
    pose, fields, rate = np.empty((m, 4, 4)), np.empty((m, 18)), np.empty(12)
    jacobian = np.empty((m, 24, 2, 2 * half))
    moved = np.empty((4, 4)), np.empty(24), np.empty((4, 4)), np.empty(24)
    aside, six, matrix = (np.empty((4, 4)), np.empty(6)), work[4], work[7]
    for n in range(m):
        nodes = pose0[n], fields0[n], pose1[n], fields1[n]
        nudge = _nudge(fields0[n], fields1[n], rods[n, STEP])
        point = pose[n], fields[n, :6]
        _still_inside(nodes, rods[n], half, offset[n], gain[n], work, point, slopes[0])
        for side in range(1, 3):
            time = nudge if side == 1 else -nudge
            _moved(pose0[n], fields0[n], time, half, six, turn, moved[0], moved[1])
            _moved(pose1[n], fields1[n], time, half, six, turn, moved[2], moved[3])
            _still_inside(moved, rods[n], half, offset[n], gain[n], work, aside, slopes[side])
        _rates_into(nodes, nudge, half, slopes, matrix, six, rate, jacobian[n])
        for i in range(12):
            fields[n, 6 + i] = rate[i]
        ad_into(rate, matrix)
        for i in range(6):
            for j in range(half):
                at = j if j < 12 else 12 + j
                for k in range(6):
                    for end in range(2):
                        jacobian[n, 12 + i, end, at] += matrix[i, k] * slopes[0, end, k, j]
    return pose, fields, jacobian
