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
"""Information of a delay that is held, s⁻²."""
_CONSTANT = 1e6  # times the recording: the memory of a constant, long enough to count as for ever
_FIRM = 0.01  # m, rad, s, rad/s: a constant that is broader drifts no more than one of this std
_HOLDS = 100.0  # s in the place of that where it is not known; more would cost digits


class EstimatedParameters:
    """Sensor parameters that are estimated, side by side as E numbers a time node.

    Attributes:
        each: The parameters.
        columns: Which of the E numbers are each one's.
        mean: Expected values (E,).
        std: Standard deviations (E,).
    """

    def __init__(self, grid: Grid, sensor_parameters: Sequence[SensorParameter]) -> None:
        self.each = tuple(u for u in sensor_parameters if not u.known)
        self.grid = grid
        ends = np.cumsum([0, *(u.size for u in self.each)])
        self.columns = [slice(a, b) for a, b in pairwise(ends)]
        self.size = int(ends[-1])
        whole = grid.time.size > 1 and grid.before is None  # not what a window sees of it
        span = max(np.ptp(grid.time), 1.0) if whole else _HOLDS
        forever = [_CONSTANT * span * np.maximum(1.0, (u.std / _FIRM) ** 2) for u in self.each]
        pairs = zip(self.each, forever, strict=True)
        memory = [np.minimum(u.correlation_time, longest) for u, longest in pairs]
        self.memory = np.concatenate([np.zeros(0), *memory])
        self.mean = np.concatenate([np.zeros(0), *(u.value for u in self.each)])
        self.std = np.concatenate([np.zeros(0), *(np.maximum(u.std, 1e-12) for u in self.each)])

    @property
    def delay_columns(self) -> list[int]:
        """Which of the E numbers are delays."""
        pairs = zip(self.each, self.columns, strict=True)
        return [columns.start for parameter, columns in pairs if parameter.kind == "time_offset"]

    def expected(self) -> Array:
        """Every parameter at its expected value (K, E)."""
        return np.tile(self.mean, (self.grid.time.size, 1))

    def drift(self, values: Array) -> tuple[Array, Array, Array]:
        """The process that ties the values of one time node to those of the next.

        Args:
            values: Values (K, E) at the time nodes.

        Returns:
            What is left (K−1, E) of a deviation at the next node, standard deviations (K, E) of the
            innovations, and the innovations (K, E). The first is the deviation from what is
            expected; on a grid that continues another its standard deviation is infinite.
        """
        a = np.diff(self.grid.time)[:, None] / self.memory
        first = self.std if self.grid.before is None else np.full(self.size, np.inf)
        std = np.concatenate([first[None], self.std * np.sqrt(-np.expm1(-2.0 * a))])
        decay, off = np.exp(-a), values - self.mean
        return decay, std, np.concatenate([off[:1], off[1:] - decay * off[:-1]])

    def faded(self, lasts: float, values: Array, cov: Array) -> tuple[Array, Array]:
        """What values (E,) and covariance (E, E) at a time say of one that `lasts` s from it.

        The processes are stationary, so that they fade alike to times before and after.
        """
        fade = np.exp(-abs(lasts) / self.memory)
        spread = fade[:, None] * cov * fade + np.diag(self.std**2 * (1.0 - fade**2))
        return self.mean + fade * (values - self.mean), spread

    def between(self, time: Array) -> tuple[Array, Array, Array]:
        """What the time nodes say of times (M,): an Ornstein-Uhlenbeck bridge.

        Returns:
            Lower time node (M,), weights (M, 2, E) of it and of the next, leftover variance (M, E).
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
        none, early, late = (-np.expm1(-2.0 * a) for a in (whole, far, near))  # sinh overflows
        weights = np.stack([np.exp(-near) * early, np.exp(-far) * late], axis=1) / none[:, None]
        return lower, weights, self.std**2 * early * late / none


@dataclass(frozen=True)
class ParameterValues:
    """Values of estimated sensor parameters at the time nodes.

    Attributes:
        process: The parameters.
        values: Their values (K, E).
    """

    process: EstimatedParameters
    values: Array

    def of(self, readings: Readings) -> list[tuple[SensorParameter, slice]]:
        """The parameters of a stream, and which of the E numbers are theirs."""
        pairs = zip(self.process.each, self.process.columns, strict=True)
        return [(u, at) for u, at in pairs if readings.name in u.streams]

    def between(self, time: Array) -> tuple[Array, Array, Array]:
        """Values (M, E) at times (M,), weights (M, 2, E) of nodes, leftover variance (M, E)."""
        lower, weights, left = self.process.between(time)
        upper = np.minimum(lower + 1, len(self.values) - 1)
        off = self.values - self.process.mean
        values = self.process.mean + weights[:, 0] * off[lower] + weights[:, 1] * off[upper]
        return values, weights, left

    def at(self, time: Array) -> Array:
        """Values (M, E) at times (M,), held beyond the ends."""
        nodes = self.process.grid.time
        return self.between(np.clip(time, nodes[0], nodes[-1]))[0]

    def displaced(self, readings: Readings) -> Readings:
        """Readings where and when the parameters say they were taken, also off the grid."""
        moving = [(u, c) for u, c in self.of(readings) if u.moves]
        stamped = readings
        for _ in range(2 if moving else 0):  # a time offset is that of the true time
            now, readings = self.at(readings.time), stamped
            for parameter, columns in moving:
                readings = parameter.shift(readings, now[:, columns])
        return readings

    def corrected(self, readings: Readings, now: Array) -> Readings:
        """Readings corrected for the parameters that leave them in place, valued `now` (M, E)."""
        for parameter, columns in self.of(readings):
            if not parameter.moves:
                readings = parameter.shift(readings, now[:, columns])
        return readings

    def by_name(self) -> list[tuple[SensorParameter, Array]]:
        """The parameters with their values (K, size)."""
        pairs = zip(self.process.each, self.process.columns, strict=True)
        return [(parameter, self.values[:, at]) for parameter, at in pairs]
