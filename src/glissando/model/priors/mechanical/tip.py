"""What the tip of a rod carries beside its tool, and how that changes."""

from __future__ import annotations

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.mechanics import Mechanics
from glissando.model.priors.intervals import RATED, strain_rate_of
from glissando.model.state import STRAIN, STRAIN_RATE, State

_PARTS = slice(0, 3), slice(3, 6)


def tip_error(mechanics: Mechanics, rest: Array, at: State) -> tuple[Array, Array]:
    """Wrench at the tip less its tool's weight, and its rate (…, 12); Jacobian (…, 12, 24).

    Args:
        mechanics: What the rod and its tool are made of.
        rest: The tip's strain (6,) without loads.
        at: The tip (…).
    """
    stiffness = mechanics.stiffness[-1]
    rotation, turning = at.pose[..., :3, :3], at.velocity[..., 3:]
    by_turn = mechanics.tip_slope(rotation)
    error = np.zeros((*turning.shape[:-1], 12))
    error[..., :6] = stiffness * (at.strain - rest) - mechanics.tip_wrench(rotation)
    error[..., 6:] = stiffness * strain_rate_of(at)
    error[..., 6:] -= np.einsum("...ij,...j->...i", by_turn, turning)
    jacobian = np.zeros((*turning.shape[:-1], 12, RATED))
    jacobian[..., :6, 3:6] = jacobian[..., 6:, 15:18] = -by_turn
    jacobian[..., :6, STRAIN] = jacobian[..., 6:, STRAIN_RATE] = np.diag(stiffness)
    lever, spin = se3.hat3(mechanics.tip_center), se3.hat3(turning) @ by_turn[..., :3, :]
    jacobian[..., 6:9, 3:6], jacobian[..., 9:, 3:6] = spin, lever @ spin
    return error, jacobian


def pushed(mechanics: Mechanics, at: State, error: Array, jacobian: Array) -> tuple[Array, Array]:
    """Error and Jacobian (…, 12, 30) of a tip whose tool resists acceleration. Source: (32).

    The tool counts as a point where the tip is.
    """
    assert at.inertia is not None
    back = np.swapaxes(at.pose[..., :3, :3], -1, -2)
    push, rate = (mechanics.tip_mass * _turned(back, at.inertia[..., p]) for p in _PARTS)
    turning = at.velocity[..., 3:]
    wide = np.concatenate([jacobian, np.zeros((*jacobian.shape[:-1], 6))], axis=-1)
    error = error.copy()
    error[..., :3] += push
    error[..., 6:9] += rate - np.cross(turning, push)
    wide[..., :3, 3:6] += se3.hat3(push)
    wide[..., 6:9, 3:6] += se3.hat3(rate) - se3.hat3(turning) @ se3.hat3(push)
    wide[..., 6:9, 15:18] += se3.hat3(push)
    wide[..., :3, 24:27] = wide[..., 6:9, 27:30] = mechanics.tip_mass * back
    wide[..., 6:9, 24:27] = -se3.hat3(turning) @ (mechanics.tip_mass * back)
    return error, wide


def _turned(rotation: Array, vector: Array) -> Array:
    return np.einsum("...ij,...j->...i", rotation, vector)
