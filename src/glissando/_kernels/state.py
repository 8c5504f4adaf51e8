"""Steps of states, for which a roll of the body about its z is an exact symmetry.

A point (pose, fields of the body frame) that rolls by φ is the same point of the same curve, with
fields rotated by −φ. A step with an angle φ about z leads there, however large the angle is; to
first order it is a plain step. Source: equation (35).
"""

from __future__ import annotations

from math import cos, sin

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.lie import ahead_into, compose_into, exp_into, log_into
from glissando._kernels.rolls import roll_into, roll_of
from glissando._kernels.scratch import matrix, vector


@jit("(f8[:,:,::1], f8[:,::1])")
def retract(pose, step):
    """Poses (M, 4, 4) perturbed on the right by steps (M, ·), by their rolls last."""
    out, rest, move = np.empty((len(pose), 4, 4)), vector(6), matrix(4, 4)
    for n in range(len(pose)):
        for i in range(5):
            rest[i] = step[n, i]
        rest[5] = 0.0
        exp_into(rest, move)
        compose_into(pose[n], move, out[n])
        roll_into(out[n], step[n, 5])
    return out


@jit("(f8[:,:,::1], f8[:,:,::1])")
def difference(pose, moved):
    """Steps (M, 6) from poses (M, 4, 4) to poses `moved`."""
    out, apart = np.empty((len(pose), 6)), matrix(4, 4)
    for n in range(len(pose)):
        ahead_into(pose[n], moved[n], apart)
        roll = roll_of(apart)
        roll_into(apart, -roll)
        log_into(apart, out[n])
        out[n, 5] = roll
    return out


@jit("(f8[:,::1], f8[:,::1], i8)")
def carry(field, step, at):
    """Body-frame fields (M, 6) after steps (M, ·), whose own components begin at column `at`.

    They become R(−φ) (field + step − field × φ) where a body rolls by φ.
    """
    out = np.empty((len(field), 6))
    for n in range(len(field)):
        roll = step[n, 5]
        c, s = cos(roll), sin(roll)
        for i in (0, 3):
            a, b = field[n, i], field[n, i + 1]
            x, y = a + step[n, at + i] - roll * b, b + step[n, at + i + 1] + roll * a
            out[n, i], out[n, i + 1] = c * x + s * y, c * y - s * x
            out[n, i + 2] = field[n, i + 2] + step[n, at + i + 2]
    return out


@jit("(f8[:,::1], f8[:,::1], f8[:,::1])")
def change(field, step, moved):
    """Steps (M, 6) from body-frame fields (M, 6) to fields `moved`, given steps of poses."""
    out = np.empty((len(field), 6))
    for n in range(len(field)):
        roll = step[n, 5]
        c, s = cos(roll), sin(roll)
        for i in (0, 3):
            a, b, x, y = field[n, i], field[n, i + 1], moved[n, i], moved[n, i + 1]
            out[n, i] = c * x - s * y - a + roll * b
            out[n, i + 1] = c * y + s * x - b - roll * a
            out[n, i + 2] = moved[n, i + 2] - field[n, i + 2]
    return out
