"""What the tip of a rod carries beside its tool, and how that changes."""

from __future__ import annotations

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.mechanics import Mechanics
from glissando.model.priors.intervals import RATED, strain_rate_of
from glissando.model.state import STRAIN, STRAIN_RATE, State


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
