"""The wrench at the tip of a rod beyond its tool's weight, and its rate."""

from __future__ import annotations

import numpy as np

from glissando._kernels import rod_tip as kernels
from glissando._kernels.arrays import items, unflatten, whole
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.mechanics import Mechanics
from glissando.model.state import State

_PARTS = slice(0, 3), slice(3, 6)


def tip_error(mechanics: Mechanics, rest: Array, at: State) -> tuple[Array, Array]:
    """Wrench at the tip less its tool's weight, and its rate (…, 12); Jacobian (…, 12, 24).

    Args:
        mechanics: Mechanics of the rod and its tool.
        rest: Strain (6,) of the tip without loads.
        at: State (…) of the tip; without a strain rate that is zero.
    """
    lead = at.strain.shape[:-1]
    rate = np.zeros_like(at.strain) if at.strain_rate is None else at.strain_rate
    fields = np.concatenate([at.strain, at.velocity, rate], axis=-1).reshape(-1, 18)
    weight = items(mechanics.tip_mass * mechanics.gravity, lead, 3)
    error, jacobian = unflatten(
        lead,
        *kernels.tip_error(
            items(at.pose, lead, 4, 4), fields, whole(mechanics.stiffness[-1]), whole(rest),
            weight, whole(mechanics.tip_center),
        ),
    )  # fmt: skip
    return error, jacobian


def with_tool_inertia(
    mechanics: Mechanics, at: State, error: Array, jacobian: Array
) -> tuple[Array, Array]:
    """Error and Jacobian (…, 12, 30) of a tip with the inertial force of its tool. Source: (32).

    The tool counts as a point mass at the tip.
    """
    assert at.inertia is not None
    back = np.swapaxes(at.pose[..., :3, :3], -1, -2)
    push, rate = (mechanics.tip_mass * se3.rotate(back, at.inertia[..., p]) for p in _PARTS)
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
