"""Jacobians of sensors that define none, by differences of their residual."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.state import DOF, State


class Sensor(Protocol):
    """Readings of any sensor."""

    @property
    def label(self) -> str:
        """Name for messages."""

    def residual(self, at: State) -> Array:
        """Expected minus measured (M, rows) at states (M,)."""


def numerical_jacobian(sensor: Sensor, at: State) -> Array:
    """Central differences of a sensor's residual (M, rows, 18), checked at two step sizes.

    A piecewise constant residual has no useful slope; give such a sensor a smooth one.

    Raises:
        SensorError: The two results differ, so the residual is not smooth there.
    """
    jacobians = []
    for step in (1e-5, 4e-5):
        columns = []
        for move in step * np.eye(DOF):
            ahead = sensor.residual(at.retract(move))
            columns.append((ahead - sensor.residual(at.retract(-move))) / (2.0 * step))
        jacobians.append(np.stack(columns, axis=-1))
    gap = np.abs(jacobians[0] - jacobians[1])
    scale = 1.0 + np.abs(jacobians[0]).max(axis=(-1, -2), keepdims=True)
    if not np.all(gap <= 1e-5 * scale):
        row = int(np.unravel_index(np.argmax(gap / scale), gap.shape)[0])
        raise SensorError(
            f"{sensor.label}: the residual of row {row} is not smooth where it was taken "
            f"(difference quotients differ by {gap[row].max():.2g}). Write jacobian(at), or a "
            f"residual without jumps (wrap angles with a logarithm)."
        )
    return jacobians[0]
