"""Covariance of readings by themselves: from their noise and their uncertain arclength."""

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
    """Source of states: a posterior or a smoother."""

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """State and covariance at points (M,)."""


def reading_covariance(
    estimate: StateSource, readings: Readings, at: State, by_state: Array
) -> Array:
    """Covariance of readings from noise and uncertain arclength. Source: equation (16).

    Args:
        estimate: Source of the states beside the readings.
        readings: M readings.
        at: States (M,) at the readings.
        by_state: Jacobians (M, r, 18) of their residuals by the state.

    Returns:
        Covariances (M, r, r), or an array that broadcasts to this shape.
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
