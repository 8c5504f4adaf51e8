"""What readings are off by themselves: by their noise, and by not knowing where they were taken."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from glissando.estimation.state_estimate import StateEstimate
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings
from glissando.model.state import POSE, State

_NUDGE = 1e-5  # m along the robot, for a difference


class StateSource(Protocol):
    """What can be asked for states: a posterior or a smoother."""

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """State and covariance at points (M,)."""


def reading_covariance(
    estimate: StateSource, readings: Readings, at: State, by_state: Array
) -> Array:
    """Covariance of what readings are off by themselves. Source: equation (16).

    Args:
        estimate: Where states are asked for.
        readings: M readings.
        at: The states (M,) where they were taken.
        by_state: Slope (M, r, 18) of their residuals by the state.

    Returns:
        Covariances (M, r, r), or whatever broadcasts to them.
    """
    std = np.broadcast_to(readings.arclength_std, (len(readings),))
    if not std.any():
        return readings.cov
    step = np.where(readings.arclength > _NUDGE, -_NUDGE, _NUDGE)
    beside = estimate.at(readings.arclength + step, readings.time)
    rise = State(beside.pose, beside.strain, beside.velocity).rise_from(at) / step[:, None]
    if readings.winding is not None:
        rise[:, POSE] += readings.winding
    along = std[:, None] * np.einsum("mrd,md->mr", by_state, rise)
    return np.asarray(readings.cov + along[:, :, None] * along[:, None, :])
