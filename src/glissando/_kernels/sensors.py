"""Residuals of built-in sensors, and Jacobians by the state. Source: equations (14) to (17).

Sensors are numbered; the values of a reading are a row of up to sixteen numbers.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import (
    adjoint_back_into,
    ahead_into,
    compose_into,
    log_into,
    right_jacobian_inverse_into,
    times_into,
)
from glissando._kernels.rolls import roll_into, roll_of
from glissando._kernels.scratch import matrix, vector

POSE, COIL, POSITION, ORIENTATION, GYRO, STRAIN = range(6)
ROWS = (6, 5, 3, 3, 3, 6)
"""Number of residuals of a reading of each sensor."""


@jit()
def _pose_into(values, sensor_pose, rolls, back, error):
    """Error (6,) of a measured pose. A sensor that `rolls` is first rotated to the measured roll.

    This rotates its axes, and with them `back` (6, 6), the map from motions of the body to those of
    the sensor: the error is then in the measured axes, whatever the roll of the robot.
    """
    measured, apart = matrix(4, 4), matrix(4, 4)
    for i in range(16):
        measured[i // 4, i % 4] = values[i]
    ahead_into(measured, sensor_pose, apart)
    if rolls:
        roll = roll_of(apart)
        roll_into(apart, -roll)
        c, s = cos(roll), sin(roll)
        for i in (0, 3):
            for j in range(6):
                x, y = back[i, j], back[i + 1, j]
                back[i, j], back[i + 1, j] = c * x - s * y, c * y + s * x
    log_into(apart, error)


@jit()
def _pose_slopes(error, back, rolls, by_state):
    """Jacobian of that error by the pose; if it `rolls`, with the roll eliminated."""
    spread, whole = matrix(6, 6), matrix(6, 6)
    right_jacobian_inverse_into(error, spread)
    times_into(spread, back, whole)
    for i in range(5 if rolls else 6):
        follow = spread[i, 5] / spread[5, 5] if rolls else 0.0
        for j in range(6):
            by_state[i, j] = whole[i, j] - follow * whole[5, j]


@jit()
def _orientation_into(values, sensor_pose, back, residual, by_state):
    """Rotation vector from the measured orientation to that of a pose, and its Jacobian."""
    turn, error, spread = np.eye(4), vector(6), matrix(6, 6)
    for i in range(3):
        for j in range(3):
            turn[i, j] = 0.0
            for k in range(3):
                turn[i, j] += values[3 * k + i] * sensor_pose[k, j]
    log_into(turn, error)
    error[0] = error[1] = error[2] = 0.0
    right_jacobian_inverse_into(error, spread)
    for i in range(3):
        residual[i] = error[3 + i]
        for j in range(6):
            for k in range(6):
                by_state[i, j] += spread[3 + i, k] * back[k, j] if k >= 3 else 0.0


@jit()
def sense_into(kind, values, mount, pose, strain, velocity, residual, by_state):
    """Residual of a reading (6,) and its Jacobian (6, 18) by the state, both into zeros."""
    sensor_pose, back = matrix(4, 4), matrix(6, 6)
    if kind == STRAIN:
        for i in range(6):
            residual[i], by_state[i, 6 + i] = strain[i] - values[i], 1.0
        return
    if kind == GYRO:
        for i in range(3):
            residual[i] = -values[i]
            for j in range(3):
                residual[i] += velocity[3 + j] * mount[j, i]
                by_state[i, 15 + j] = mount[j, i]
        return
    compose_into(pose, mount, sensor_pose)
    adjoint_back_into(mount, back)
    if kind == POSITION:
        for i in range(3):
            residual[i] = sensor_pose[i, 3] - values[i]
            for j in range(6):
                for k in range(3):
                    by_state[i, j] += sensor_pose[i, k] * back[k, j]
    elif kind == ORIENTATION:
        _orientation_into(values, sensor_pose, back, residual, by_state)
    else:
        _pose_into(values, sensor_pose, kind == COIL, back, residual)
        _pose_slopes(residual, back, kind == COIL, by_state)
        if kind == COIL:
            residual[5] = 0.0


@jit("(i8, f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1])")
def sense(kind, values, mount, pose, strain, velocity):
    """Residuals (M, 6) of readings at states, Jacobians (M, 6, 18); unused rows are zeros."""
    residual, by_state = np.zeros((len(values), 6)), np.zeros((len(values), 6, 18))
    for n in range(len(values)):
        sense_into(
            kind, values[n], mount[n], pose[n], strain[n], velocity[n], residual[n], by_state[n]
        )
    return residual, by_state
