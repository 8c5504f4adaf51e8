"""Poses, velocities and accelerations along a rod whose strain changes.

Places are the G Gauss points of a mesh and then the ends of its E elements; vectors are in the
world's axes. Source: docs/dynamics.md, "Equations of motion".
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import compose_into, exp_into


@jit()
def crossed(ax, ay, az, bx, by, bz):
    """Cross product of two three-vectors."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@jit()
def turned(turn, g, x, y, z):
    """Rotate a vector from body to world axes at place g."""
    return (
        turn[g, 0, 0] * x + turn[g, 0, 1] * y + turn[g, 0, 2] * z,
        turn[g, 1, 0] * x + turn[g, 1, 1] * y + turn[g, 1, 2] * z,
        turn[g, 2, 0] * x + turn[g, 2, 1] * y + turn[g, 2, 2] * z,
    )


@jit()
def turned_back(turn, g, x, y, z):
    """Rotate a vector from world to body axes at place g."""
    return (
        turn[g, 0, 0] * x + turn[g, 1, 0] * y + turn[g, 2, 0] * z,
        turn[g, 0, 1] * x + turn[g, 1, 1] * y + turn[g, 2, 1] * z,
        turn[g, 0, 2] * x + turn[g, 1, 2] * y + turn[g, 2, 2] * z,
    )


@jit()
def integrate_into(matrix, values, out, k):
    """Add the integral of values (G, 3), at every row of the matrix (S, G), to out[k] (S, 3)."""
    for s in range(matrix.shape[0]):
        x = y = z = 0.0
        for g in range(matrix.shape[1]):
            m = matrix[s, g]
            x += m * values[g, 0]
            y += m * values[g, 1]
            z += m * values[g, 2]
        out[k, s, 0] += x
        out[k, s, 1] += y
        out[k, s, 2] += z


@jit()
def _bracket_into(x, i, y, j, out, k):
    """Lie bracket of two rows for T′ = T ε^, for which products have the reverse order."""
    a, b, c = crossed(y[j, 3], y[j, 4], y[j, 5], x[i, 3], x[i, 4], x[i, 5])
    d, e, f = crossed(y[j, 0], y[j, 1], y[j, 2], x[i, 3], x[i, 4], x[i, 5])
    u, v, w = crossed(y[j, 3], y[j, 4], y[j, 5], x[i, 0], x[i, 1], x[i, 2])
    out[k, 0], out[k, 1], out[k, 2] = d + u, e + v, f + w
    out[k, 3], out[k, 4], out[k, 5] = a, b, c


@jit()
def _magnus_into(inner, step, work, twist):
    """Twist (6,) of a step with strain (3, 6) at its Gauss points, as by `mesh.magnus`."""
    root = sqrt(15.0) / 3.0 * step
    for i in range(6):
        first, middle, last = inner[0, i], inner[1, i], inner[2, i]
        work[0, i] = step * middle
        work[1, i] = root * (last - first)
        work[2, i] = step * 10.0 / 3.0 * (last - 2.0 * middle + first)
    _bracket_into(work, 0, work, 1, work, 3)
    for i in range(6):
        work[4, i] = 2.0 * work[2, i] + work[3, i]
    _bracket_into(work, 0, work, 4, work, 5)
    for i in range(6):
        work[3, i] += -20.0 * work[0, i] - work[2, i]
        work[1, i] -= work[5, i] / 60.0
    _bracket_into(work, 3, work, 1, work, 4)
    for i in range(6):
        twist[i] = work[0, i] + work[2, i] / 12.0 + work[4, i] / 240.0


@jit()
def roll_out_into(state, base, steps, widths, turn, place):
    """Rotations (S, 3, 3) and positions (S, 3) at the places of strains state[0] (G, 6).

    `steps` (P, 3, C) maps the strains of an element to the inner points of its P intervals, whose
    `widths` (E, P) are in metres; the last interval ends at the element's end.
    """
    elements, intervals, count = widths.shape[0], widths.shape[1], steps.shape[2]
    inner, work, twist = np.empty((3, 6)), np.empty((6, 6)), np.empty(6)
    pose, move, fresh = np.empty((4, 4)), np.empty((4, 4)), base
    for n in range(elements * intervals):
        e, p = n // intervals, n % intervals
        for i in range(3):
            for c in range(6):
                value = 0.0
                for k in range(count):
                    value += steps[p, i, k] * state[0, e * count + k, c]
                inner[i, c] = value
        _magnus_into(inner, widths[e, p], work, twist)
        exp_into(twist, move)
        compose_into(fresh, move, pose)
        fresh, pose = pose, np.empty((4, 4)) if n == 0 else fresh
        at = e * count + p if p < count else elements * count + e
        for i in range(3):
            place[at, i] = fresh[i, 3]
            for j in range(3):
                turn[at, i, j] = fresh[i, j]


@jit()
def rates_into(state, base_rates, before, turn, along, rates):
    """Velocity, angular velocity, acceleration and angular acceleration (4, S, 3) of the places.

    `state` (3, G, 6) is strain with its first and second derivative by time, `base_rates` (4, 3)
    the same four vectors at the base, `along` (G, 3) is set to ∂p/∂s.
    """
    points = state.shape[1]
    value, grow = np.empty((points, 3)), np.empty((points, 3))
    for k in range(4):
        for s in range(before.shape[0]):
            for i in range(3):
                rates[k, s, i] = base_rates[k, i]
    for g in range(points):
        x, y, z = turned(turn, g, state[0, g, 0], state[0, g, 1], state[0, g, 2])
        along[g, 0], along[g, 1], along[g, 2] = x, y, z
        x, y, z = turned(turn, g, state[1, g, 3], state[1, g, 4], state[1, g, 5])
        value[g, 0], value[g, 1], value[g, 2] = x, y, z
    integrate_into(before, value, rates, 1)
    for g in range(points):  # ω × R u̇ + R ü, and ω × p′ + R ν̇
        wx, wy, wz = rates[1, g, 0], rates[1, g, 1], rates[1, g, 2]
        u, v, w = crossed(wx, wy, wz, value[g, 0], value[g, 1], value[g, 2])
        x, y, z = turned(turn, g, state[2, g, 3], state[2, g, 4], state[2, g, 5])
        value[g, 0], value[g, 1], value[g, 2] = x + u, y + v, z + w
        u, v, w = crossed(wx, wy, wz, along[g, 0], along[g, 1], along[g, 2])
        x, y, z = turned(turn, g, state[1, g, 0], state[1, g, 1], state[1, g, 2])
        grow[g, 0], grow[g, 1], grow[g, 2] = x + u, y + v, z + w
    integrate_into(before, value, rates, 3)
    integrate_into(before, grow, rates, 0)
    for g in range(points):  # α × p′ + ω × (ω × p′ + 2 R ν̇) + R ν̈
        wx, wy, wz = rates[1, g, 0], rates[1, g, 1], rates[1, g, 2]
        x, y, z = turned(turn, g, state[1, g, 0], state[1, g, 1], state[1, g, 2])
        u, v, w = crossed(wx, wy, wz, grow[g, 0] + x, grow[g, 1] + y, grow[g, 2] + z)
        x, y, z = turned(turn, g, state[2, g, 0], state[2, g, 1], state[2, g, 2])
        value[g, 0], value[g, 1], value[g, 2] = x + u, y + v, z + w
        wx, wy, wz = rates[3, g, 0], rates[3, g, 1], rates[3, g, 2]
        u, v, w = crossed(wx, wy, wz, along[g, 0], along[g, 1], along[g, 2])
        value[g, 0] += u
        value[g, 1] += v
        value[g, 2] += w
    integrate_into(before, value, rates, 2)
