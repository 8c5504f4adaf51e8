"""Estimated sensor parameters as processes in time, and their values on a grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings

HELD = 1e14
"""Information that holds a delay fixed, s⁻²."""
_CONSTANT = 1e6  # correlation time of a constant over the length of the recording
_FIRM = 0.01  # m, rad, s, rad/s: constants of larger std drift no more than one of this
_UNKNOWN_LENGTH = 100.0  # s, in place of an unknown length of recording; more would cost digits


class EstimatedParameters:
    """The estimated sensor parameters, concatenated to E numbers a time node.

    Attributes:
        each: The parameters.
        columns: Slice of the E numbers for each parameter.
        mean: Expected values (E,).
        std: Standard deviations (E,).
    """

    def __init__(self, grid: Grid, sensor_parameters: Sequence[SensorParameter]) -> None:
        self.each = tuple(u for u in sensor_parameters if not u.known)
        self.grid = grid
        ends = np.cumsum([0, *(u.size for u in self.each)])
        self.columns = [slice(a, b) for a, b in pairwise(ends)]
        self.size = int(ends[-1])
        whole = grid.time.size > 1 and grid.before is None  # not a window of it
        span = max(np.ptp(grid.time), 1.0) if whole else _UNKNOWN_LENGTH
        limits = [_CONSTANT * span * np.maximum(1.0, (u.std / _FIRM) ** 2) for u in self.each]
        pairs = zip(self.each, limits, strict=True)
        memory = [np.minimum(u.correlation_time, longest) for u, longest in pairs]
        self.memory = np.concatenate([np.zeros(0), *memory])
        self.mean = np.concatenate([np.zeros(0), *(u.value for u in self.each)])
        self.std = np.concatenate([np.zeros(0), *(np.maximum(u.std, 1e-12) for u in self.each)])

    @property
    def delay_columns(self) -> list[int]:
        """Indices of the delays among the E numbers."""
        pairs = zip(self.each, self.columns, strict=True)
        return [columns.start for parameter, columns in pairs if parameter.kind == "time_offset"]

    def expected(self) -> Array:
        """Expected values (K, E) of the parameters at the time nodes."""
        return np.tile(self.mean, (self.grid.time.size, 1))

    def drift(self, values: Array) -> tuple[Array, Array, Array]:
        """Ornstein-Uhlenbeck process between the values of successive time nodes.

        Args:
            values: Values (K, E) at the time nodes.

        Returns:
            Decay (K−1, E) of a deviation to the next node, standard deviations (K, E) of the
            innovations, and the innovations (K, E). The first one is the deviation from the
            expected value; on a grid that continues another its standard deviation is infinite.
        """
        a = np.diff(self.grid.time)[:, None] / self.memory
        first = self.std if self.grid.before is None else np.full(self.size, np.inf)
        std = np.concatenate([first[None], self.std * np.sqrt(-np.expm1(-2.0 * a))])
        decay, deviation = np.exp(-a), values - self.mean
        return decay, std, np.concatenate([deviation[:1], deviation[1:] - decay * deviation[:-1]])

    def faded(self, lasts: float, values: Array, cov: Array) -> tuple[Array, Array]:
        """Predict values (E,) and their covariance (E, E) over `lasts` s.

        The processes are stationary, so that predictions forwards and backwards are the same.
        """
        fade = np.exp(-abs(lasts) / self.memory)
        spread = fade[:, None] * cov * fade + np.diag(self.std**2 * (1.0 - fade**2))
        return self.mean + fade * (values - self.mean), spread

    def between(self, time: Array) -> tuple[Array, Array, Array]:
        """Interpolate at times (M,) between the time nodes: an Ornstein-Uhlenbeck bridge.

        Returns:
            Lower time node (M,), weights (M, 2, E) of it and of the next, bridge variance (M, E).
        """
        count = self.grid.time.size
        if count == 1:
            weights = np.zeros((time.size, 2, self.size))
            weights[:, 0] = 1.0
            return np.zeros(time.size, dtype=np.intp), weights, np.zeros((time.size, self.size))
        cells = self.grid.locate(np.full_like(time, self.grid.arclength[0]), time)[1]
        lower = np.minimum(cells.lower + (cells.offset >= cells.step), count - 2)
        step, offset = np.diff(self.grid.time)[lower], time - self.grid.time[lower]
        whole, near = step[:, None] / self.memory, np.clip(offset, 0.0, step)[:, None] / self.memory
        far = whole - near
        norm, early, late = (-np.expm1(-2.0 * a) for a in (whole, far, near))  # sinh overflows
        weights = np.stack([np.exp(-near) * early, np.exp(-far) * late], axis=1) / norm[:, None]
        return lower, weights, self.std**2 * early * late / norm


@dataclass(frozen=True)
class ParameterValues:
    """Values of estimated sensor parameters at the time nodes.

    Attributes:
        process: The estimated parameters.
        values: Values (K, E) of the parameters.
    """

    process: EstimatedParameters
    values: Array

    def of(self, readings: Readings) -> list[tuple[SensorParameter, slice]]:
        """Parameters of a stream, each with its slice of the E numbers."""
        pairs = zip(self.process.each, self.process.columns, strict=True)
        return [(u, at) for u, at in pairs if readings.name in u.streams]

    def between(self, time: Array) -> tuple[Array, Array, Array]:
        """Values (M, E) at times (M,), weights (M, 2, E) of nodes, bridge variance (M, E)."""
        lower, weights, left = self.process.between(time)
        upper = np.minimum(lower + 1, len(self.values) - 1)
        off = self.values - self.process.mean
        values = self.process.mean + weights[:, 0] * off[lower] + weights[:, 1] * off[upper]
        return values, weights, left

    def at(self, time: Array) -> Array:
        """Values (M, E) at times (M,), constant beyond the ends of the grid."""
        nodes = self.process.grid.time
        return self.between(np.clip(time, nodes[0], nodes[-1]))[0]

    def displaced(self, readings: Readings) -> Readings:
        """Readings at arclengths and times corrected by the parameters, also off the grid."""
        moving = [(u, c) for u, c in self.of(readings) if u.moves]
        stamped = readings
        for _ in range(2 if moving else 0):  # time offsets are functions of the true time
            now, readings = self.at(readings.time), stamped
            for parameter, columns in moving:
                readings = parameter.shift(readings, now[:, columns])
        return readings

    def corrected(self, readings: Readings, now: Array) -> Readings:
        """Readings corrected for parameters that do not move them, of values `now` (M, E)."""
        for parameter, columns in self.of(readings):
            if not parameter.moves:
                readings = parameter.shift(readings, now[:, columns])
        return readings

    def by_name(self) -> list[tuple[SensorParameter, Array]]:
        """Parameters, each with its values (K, size)."""
        pairs = zip(self.process.each, self.process.columns, strict=True)
        return [(parameter, self.values[:, at]) for parameter, at in pairs]
