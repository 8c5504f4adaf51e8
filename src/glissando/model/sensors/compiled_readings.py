"""Sensors whose residuals kernels compute, and their readings as rows for these kernels."""

from __future__ import annotations

import math
from typing import ClassVar, TypeGuard

import numpy as np
from numpy.typing import NDArray

from glissando._kernels import sensors as kernels
from glissando._kernels import white_noise
from glissando._kernels.arrays import items, whole
from glissando.geometry.se3 import Array
from glissando.model.noise import GemanMcClure, Huber
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, State

_ROOM = 64  # rows that are allocated at first
_LOSSES: dict[type, float] = {
    type(None): 0.0,
    Huber: white_noise.HUBER,
    GemanMcClure: white_noise.GEMAN_MCCLURE,
}


class CompiledReadings(Readings):
    """Base class of sensors whose residual a kernel computes; `sensor` is its number there."""

    sensor: ClassVar[int]

    def _residual_and_jacobian(self, at: State) -> tuple[Array, Array]:
        """Residuals (…, rows) and their Jacobians (…, rows, 18) at states."""
        lead, width = at.pose.shape[:-2], math.prod(self.values.shape[1:])
        values = items(self.values.reshape(len(self), width), lead, width)
        poses = items(self.mount, lead, 4, 4), items(at.pose, lead, 4, 4)
        fields = items(at.strain, lead, 6), items(at.velocity, lead, 6)
        residual, slopes = kernels.sense(self.sensor, values, *poses, *fields)
        rows = kernels.ROWS[self.sensor]
        return residual[:, :rows].reshape(*lead, rows), slopes[:, :rows].reshape(*lead, rows, DOF)

    def residual(self, at: State) -> Array:
        """Expected minus measured (M, rows), see `_kernels.sensors`."""
        return self._residual_and_jacobian(at)[0]

    def jacobian(self, at: State) -> Array:
        """Jacobian (M, rows, 18) of the residual by the state."""
        return self._residual_and_jacobian(at)[1]


class ReadingRows:
    """Readings of all streams in arrays of rows for kernels, in order of arrival.

    Attributes:
        count: Number of rows in use.
        old: Number of these rows that precede the last arrival.
        stream: Index (·,) of each row's stream; like all arrays, longer than `count`.
    """

    def __init__(self) -> None:
        self.count = self.old = 0
        self.stream = np.empty(_ROOM, dtype=np.intp)
        self._rows, self._mounts = np.empty((_ROOM, white_noise.WIDTH)), np.empty((_ROOM, 4, 4))
        self._covs = np.empty((_ROOM, 6, 6))

    @property
    def time(self) -> Array:
        """Times (M,), s."""
        return self._rows[: self.count, 0]

    @property
    def arclength(self) -> Array:
        """Arclengths (M,), m."""
        return self._rows[: self.count, 1]

    @property
    def memory(self) -> tuple[Array, Array, Array]:
        """Rows (·, 21), mounts (·, 4, 4) and covariances (·, 6, 6) as kernels take them."""
        return self._rows, self._mounts, self._covs

    def append(self, stream: int, readings: CompiledReadings) -> None:
        """Append readings of a stream, for which `is_compiled` holds."""
        first, self.count = self.count, self.count + len(readings)
        if self.count > len(self.stream):
            self._keep(slice(0, first), room=2 * self.count)
        self.stream[first : self.count] = stream
        loss = _LOSSES[type(readings.loss)], getattr(readings.loss, "threshold", 1.0)
        fields = readings.time, readings.arclength, readings.values, readings.mount, readings.cov
        time, arclength, values, mount, cov = map(whole, fields)
        white_noise.write_rows(
            *self.memory, first, readings.sensor, *loss, time, arclength, values.reshape(-1),
            mount.reshape(-1, 4, 4), cov.reshape(-1, *cov.shape[-2:]),
        )  # fmt: skip

    def keep(self, which: NDArray[np.bool_]) -> None:
        """Keep the rows (M,) of a mask and drop all others."""
        rows = np.flatnonzero(which)
        self.old = int(np.count_nonzero(which[: self.old]))
        self.count = rows.size
        self._keep(rows, room=len(self.stream))

    def _keep(self, which: NDArray[np.intp] | slice, room: int) -> None:
        """Copy some rows to the front of newly allocated arrays."""
        for name in ("stream", "_rows", "_mounts", "_covs"):
            before = getattr(self, name)
            after, rows = np.empty((room, *before.shape[1:]), before.dtype), before[which]
            after[: len(rows)] = rows
            setattr(self, name, after)


def is_compiled(readings: Readings) -> TypeGuard[CompiledReadings]:
    """Whether a kernel computes their residual: at a certain place on the backbone only."""
    kind = type(readings)
    return (
        isinstance(readings, CompiledReadings)
        and kind.residual is CompiledReadings.residual
        and kind.jacobian is CompiledReadings.jacobian
        and type(readings.loss) in _LOSSES
        and readings.channel is None
        and readings.beside is None
        and not np.count_nonzero(readings.arclength_std)
    )
