"""Jacobians of residuals by the sensor parameters that do not move readings.

A frame or a mount acts as a motion of the cross-section does, so that its Jacobian follows from
that by the pose. Other sensors are differentiated numerically.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import (
    AccelerometerReadings,
    CoilReadings,
    GyroReadings,
    OrientationReadings,
    PoseReadings,
    PositionReadings,
)
from glissando.model.state import POSE, State

_NUDGE = 1e-5  # step of difference quotients by a parameter


def by_frame(readings: Readings, at: State, by_state: Array) -> Array | None:
    """Jacobian (M, r, 6) of residuals by a left motion exp(ξ) of the values in the world frame.

    Args:
        readings: M readings, corrected.
        at: States (M,) at the readings.
        by_state: Jacobian (M, r, 18) of the residuals by the state.

    Returns:
        The Jacobian, or None for a sensor to be differentiated numerically.
    """
    if isinstance(readings, PoseReadings | CoilReadings | OrientationReadings):
        return -by_state[..., POSE] @ se3.adjoint(se3.inverse(at.pose))
    if isinstance(readings, PositionReadings):
        still = np.broadcast_to(np.eye(3), (len(readings), 3, 3))
        return np.concatenate([-still, se3.hat3(readings.values)], axis=-1)
    return None


def by_mount(readings: Readings, at: State, by_state: Array) -> Array | None:
    """Jacobian (M, r, 6) of residuals by a motion exp(ξ) of the sensor in its own frame."""
    if isinstance(readings, PoseReadings | CoilReadings | OrientationReadings | PositionReadings):
        return by_state[..., POSE] @ se3.adjoint(readings.mount)
    if isinstance(readings, GyroReadings):
        rotation = readings.mount[..., :3, :3]
        own = np.einsum("...i,...ij->...j", at.velocity[..., 3:], rotation)
        return np.concatenate([np.zeros((len(readings), 3, 3)), se3.hat3(own)], axis=-1)
    return None


def by_bias(readings: Readings) -> Array | None:
    """Jacobian (M, r, 3) of residuals by a bias that is subtracted from the values."""
    if isinstance(readings, AccelerometerReadings | GyroReadings | PositionReadings):
        return np.broadcast_to(np.eye(3), (len(readings), 3, 3))
    return None


def by_parameters(
    readings: Readings,
    corrected: Readings,
    at: State,
    by_state: Array,
    parameters: Sequence[tuple[SensorParameter, Array]],
) -> list[Array]:
    """Jacobians of residuals by the parameters that do not move readings.

    Args:
        readings: M readings before correction.
        corrected: The same readings with every parameter applied.
        at: States (M,) at the readings.
        by_state: Jacobian (M, r, 18) of the residuals by the state.
        parameters: The parameters with their values (M, size) at the times of the readings.

    Returns:
        A Jacobian (M, r, size) for each parameter.
    """
    kinds = {parameter.kind for parameter, _ in parameters}
    after = dict.fromkeys(kinds, np.eye(4))  # motions of a kind, applied after a parameter's
    slopes: list[Array] = []
    for i, (parameter, x) in reversed(list(enumerate(parameters))):
        slope = None
        if not {"frame", "bias"} <= kinds:
            slope = _slope(parameter.kind, corrected, at, by_state, x, after)
        slopes.append(_differences(readings, at, parameters, i) if slope is None else slope)
    return slopes[::-1]


def _slope(
    kind: str, readings: Readings, at: State, by_state: Array, x: Array, after: dict[str, Array]
) -> Array | None:
    """Jacobian (M, r, size) by one parameter, whose own motion is added to `after`."""
    if kind == "bias":
        return by_bias(readings)
    later, own = after[kind], se3.exp(x)
    if kind == "frame":
        moved, inner = by_frame(readings, at, by_state), se3.left_jacobian(x)
        after[kind] = later @ own
    else:
        moved, inner = by_mount(readings, at, by_state), se3.right_jacobian(x)
        after[kind], later = own @ later, se3.inverse(later)
    return None if moved is None else moved @ se3.adjoint(later) @ inner


def _differences(
    readings: Readings, at: State, parameters: Sequence[tuple[SensorParameter, Array]], which: int
) -> Array:
    """Central differences (M, r, size) by one of the parameters."""
    columns = []
    for nudge in _NUDGE * np.eye(parameters[which][0].size):
        ends = []
        for sign in (1.0, -1.0):
            moved = readings
            for i, (parameter, x) in enumerate(parameters):
                moved = parameter.shift(moved, x + sign * nudge if i == which else x)
            ends.append(moved.residual(at))
        columns.append((ends[0] - ends[1]) / (2.0 * _NUDGE))
    return np.stack(columns, axis=-1)
