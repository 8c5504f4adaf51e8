"""Sensors whose residuals a kernel computes, and their readings as rows that it takes together."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from glissando._kernels import sensors as kernels
from glissando._kernels import white_noise
from glissando._kernels.arrays import items
from glissando.geometry.se3 import Array
from glissando.model.noise import GemanMcClure, Huber
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, State

_LOSSES = {type(None): 0.0, Huber: white_noise.HUBER, GemanMcClure: white_noise.GEMAN_MCCLURE}


class CompiledReadings(Readings):
    """What sensors share whose residuals a kernel computes: the `sensor` of that number."""

    sensor: ClassVar[int]

    def _sensed(self, at: State) -> tuple[Array, Array]:
        """Residuals (…, rows) and their slopes (…, rows, 18) at states."""
        lead, width = at.pose.shape[:-2], math.prod(self.values.shape[1:])
        values = items(self.values.reshape(len(self), width), lead, width)
        poses = items(self.mount, lead, 4, 4), items(at.pose, lead, 4, 4)
        fields = items(at.strain, lead, 6), items(at.velocity, lead, 6)
        residual, slopes = kernels.sense(self.sensor, values, *poses, *fields)
        rows = kernels.ROWS[self.sensor]
        return residual[:, :rows].reshape(*lead, rows), slopes[:, :rows].reshape(*lead, rows, DOF)

    def residual(self, at: State) -> Array:
        """Expected minus measured (M, rows), see `_kernels.sensors`."""
        return self._sensed(at)[0]

    def jacobian(self, at: State) -> Array:
        """Slopes (M, rows, 18) of the residual by the state."""
        return self._sensed(at)[1]


def reading_rows(readings: Readings) -> tuple[Array, Array, Array] | None:
    """Rows (M, 21), mounts and covariances, see `_kernels.white_noise.readings`.

    None for a sensor with a residual of its own, or where it is uncertain where it read.
    """
    kind = type(readings)
    if not (
        isinstance(readings, CompiledReadings)
        and kind.residual is CompiledReadings.residual
        and kind.jacobian is CompiledReadings.jacobian
        and type(readings.loss) in _LOSSES
        and readings.beside is None
        and not np.any(readings.arclength_std)
    ):
        return None
    m, r = len(readings), kernels.ROWS[readings.sensor]
    rows, covs = np.zeros((m, white_noise.WIDTH)), np.empty((m, 6, 6))
    rows[:, 0], rows[:, 1], rows[:, 2] = readings.time, readings.arclength, readings.sensor
    rows[:, 3] = _LOSSES[type(readings.loss)]
    rows[:, 4] = getattr(readings.loss, "threshold", 1.0)
    values = readings.values.reshape(m, -1)
    rows[:, 5 : 5 + values.shape[1]] = values
    covs[:] = np.eye(6)
    covs[:, :r, :r] = readings.cov
    return rows, np.broadcast_to(readings.mount, (m, 4, 4)), covs
