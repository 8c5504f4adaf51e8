"""Prediction at full size: prior and belief on a grid, linearised at the expected motion.

Everything is computed by the estimator's own code: the prior's factors, a reading's Jacobian with
the noise of its bridge, the interpolation between nodes. The covariance predicted for a path is
therefore the one that the estimator will report, provided the robot moves as expected.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import sort_points
from glissando.model.priors.prior import Prior, load_kernels
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.planning.sliding_sensor import SlidingSensor
from glissando.solver.block_tridiagonal import BlockTridiagonal, Marginals, factor
from glissando.solver.located_readings import LocatedReadings, locate, time_blocks
from glissando.solver.measurement_factors import measurement_factors, states_at
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder


@dataclass(frozen=True)
class Rows:
    """M Jacobians of r rows each, with respect to the nodes at the corners of one grid cell.

    `cell` (M,) is the index of the time interval and `lower` (M,) that of the arclength node below;
    the columns of `jacobian` (M, r, q) are those of `PredictedInformation.corners(lower)`.
    """

    cell: Index
    lower: Index
    jacobian: Array


@dataclass(frozen=True)
class PredictedInformation:
    """Information over the planning horizon: matrix `system`, and `marginals` of its inverse.

    The `grid` has two time nodes or more. All factors are linearised at `mean`.
    """

    prior: Prior
    grid: Grid
    mean: State
    sensor_parameters: EstimatedParameters
    system: BlockTridiagonal
    marginals: Marginals

    @cached_property
    def still(self) -> bool:
        """Whether the robot is expected to hold its shape."""
        return all(bool(np.all(field == field[:1])) for field in self.mean.fields())

    @property
    def size(self) -> int:
        """Number of variables of a time node: its arclength nodes', then the sensor parameters'."""
        return self.grid.shape[1] * self.mean.dof + self.sensor_parameters.size

    def corners(self, lower: int) -> Index:
        """Columns (q,) of two neighbouring time nodes for cells above arclength node `lower`."""
        dof, n_count = self.mean.dof, self.grid.shape[1]
        nodes = np.arange(lower, min(lower + 2, n_count))
        own = (nodes[:, None] * dof + np.arange(dof)).ravel()
        own = np.append(own, np.arange(n_count * dof, self.size))
        return np.append(own, own + self.size)

    def seen(self, sensor: SlidingSensor, arclength: Array, time: Array) -> Rows:
        """Whitened rows of readings of one coil at arclengths (M,), m, and times (M,), s."""
        return self._rows(self._located(sensor, arclength, time))

    def rows_of(self, readings: Readings) -> Rows:
        """Whitened rows of readings, linearised at the expected motion."""
        return self._rows(locate(self.grid, [readings], self.sensor_parameters.each, keep_all=True))

    def _rows(self, located: LocatedReadings) -> Rows:
        rows = self._empty_rows(len(located.streams[0]), located.streams[0].row_count)
        batches = measurement_factors(self.prior, located, self.mean, self.mean)
        for _, at, batch in batches:
            whitened = batch.whitened()[1]
            count, d = batch.nodes.shape[1], batch.jacobian.shape[-1]
            jacobian = np.zeros((*whitened.shape[:2], count, self.mean.dof))
            jacobian[..., batch.dofs] = whitened[..., : count * d].reshape(
                *whitened.shape[:2], count, d
            )
            self._fill(rows, at, batch.nodes, jacobian, whitened[..., count * d :])
        return rows

    def points(self, arclength: Array, time: Array) -> tuple[Rows, Array]:
        """Rows (M, 6) of poses at points, and their covariances (M, 6, 6) given the nodes."""
        rows, bridge_cov = self._empty_rows(arclength.size, 6), np.empty((arclength.size, 6, 6))
        for points in sort_points(self.grid, arclength, time):
            at = self.prior.interpolate(self.grid, self.mean, self.mean, points)
            self._fill(rows, points.rows, at.nodes, at.jacobian[:, :6], None)
            bridge_cov[points.rows] = at.cov[:, :6, :6]
        return rows, bridge_cov

    def _located(self, sensor: SlidingSensor, arclength: Array, time: Array) -> LocatedReadings:
        place, when, inverse = arclength, time, np.arange(time.size)
        if self.still and time.size:
            place, inverse = np.unique(arclength, return_inverse=True)
            when = np.full(place.size, time[0])
        pose = states_at(self.prior, self.grid, self.mean, place, when).pose[inverse]
        readings: list[Readings] = [sensor.readings(pose, arclength, time)]
        return locate(self.grid, readings, self.sensor_parameters.each, keep_all=True)

    def _empty_rows(self, count: int, rows: int) -> Rows:
        cell, lower = np.empty((2, count), dtype=np.intp)
        return Rows(cell, lower, np.zeros((count, rows, self.corners(0).size)))

    def _fill(
        self, rows: Rows, at: Index, nodes: Index, jacobian: Array, extras: Array | None
    ) -> None:
        """Write Jacobians (M, r, c, dof) of nodes (M, c) to the columns of the cells' corners.

        Jacobians by the sensor parameters, `extras`, are empty for a sensor without any.
        """
        (k_count, n_count), dof, e = self.grid.shape, self.mean.dof, self.sensor_parameters.size
        k, n = np.divmod(nodes, n_count)
        rows.cell[at] = np.minimum(k[:, 0], k_count - 2)
        rows.lower[at] = np.minimum(n[:, 0], max(n_count - 2, 0))
        half = rows.jacobian.shape[-1] // 2
        first = (k - rows.cell[at, None]) * half + (n - rows.lower[at, None]) * dof
        for corner in range(nodes.shape[1]):
            columns = first[:, corner, None] + np.arange(dof)
            for row in range(jacobian.shape[1]):
                rows.jacobian[at[:, None], row, columns] = jacobian[:, row, corner]
        if extras is not None and extras.size:
            own = np.append(np.arange(half - e, half), np.arange(2 * half - e, 2 * half))
            rows.jacobian[at[:, None], :, own] = np.swapaxes(extras, -1, -2)

    def pairs(self, rows: Rows) -> Array:
        """Covariances (M, q, q) of the cell corners of each row."""
        out = np.empty((rows.cell.size, *2 * rows.jacobian.shape[-1:]))
        cov, cross = self.marginals.cov, self.marginals.cross
        half = out.shape[1] // 2
        early, late = slice(0, half), slice(half, None)
        for lower in np.unique(rows.lower):
            at = np.flatnonzero(rows.lower == lower)
            own = self.corners(int(lower))[:half]
            first, then = (_square(rows.cell[at] + i, own) for i in (0, 1))
            out[at, early, early], out[at, late, late] = cov[first], cov[then]
            out[at, early, late] = cross[first]
            out[at, late, early] = np.swapaxes(out[at, early, late], -1, -2)
        return out

    def cov_pose(self, arclength: Array, time: Array) -> Array:
        """Covariances (M, 6, 6) of the pose at arclengths and times (M,), in the body frame."""
        rows, bridge_cov = self.points(arclength, time)
        return rows.jacobian @ self.pairs(rows) @ np.swapaxes(rows.jacobian, -1, -2) + bridge_cov

    def after(self, sensor: SlidingSensor, arclength: Array, time: Array) -> PredictedInformation:
        """Add the information of readings of all coils; the first is at `arclength` (M,), m.

        The readings are at times `time` (M,), s.
        """
        builder = _builder(self.grid, self.mean, self.sensor_parameters)
        place = np.add.outer(-sensor.behind, arclength).ravel()
        located = self._located(sensor, place, np.tile(time, sensor.coils))
        for _, _, batch in measurement_factors(self.prior, located, self.mean, self.mean):
            builder.accumulate(batch)
        added = builder.system()
        system = BlockTridiagonal(
            self.system.diagonal + added.diagonal, self.system.lower + added.lower
        )
        return replace(self, system=system, marginals=factor(system).marginals(consume=True))


def _square(k: Index, own: Index) -> tuple[Any, ...]:
    """Index that selects (M, q, q) from blocks (K, D, D); contiguous columns as a faster slice."""
    if own[-1] - own[0] == own.size - 1:
        return k, *2 * (slice(own[0], own[-1] + 1),)
    return np.ix_(k, own, own)


def look_ahead(
    prior: Prior,
    grid: Grid,
    mean: State,
    sensor_parameters: EstimatedParameters,
    belief: Array | None,
) -> PredictedInformation:
    """Predict the information over a horizon before any reading in it.

    `belief` (D, D) is the information about the first time node from before the horizon, or None.
    Raises UnobservableError when prior and belief leave a direction undetermined.
    """
    load_kernels(prior)
    system = prior_information(prior, grid, mean, sensor_parameters)
    if belief is not None:
        system.diagonal[0] += belief
    marginals = factor(system).marginals(consume=True)
    return PredictedInformation(prior, grid, mean, sensor_parameters, system, marginals)


def prior_information(
    prior: Prior, grid: Grid, mean: State, sensor_parameters: EstimatedParameters
) -> BlockTridiagonal:
    """Information matrix on a grid of a prior and of the processes of sensor parameters.

    If the grid continues an earlier one, only the information added by the continuation counts.
    """
    builder = _builder(grid, mean, sensor_parameters)
    for times in time_blocks(grid):
        for batch in prior.factors(grid, mean, mean, times):
            builder.accumulate(batch)
    if sensor_parameters.size:
        builder.accumulate_drift(*sensor_parameters.drift(sensor_parameters.expected()))
    return builder.system()


def _builder(
    grid: Grid, mean: State, sensor_parameters: EstimatedParameters
) -> NormalEquationsBuilder:
    layout = Layout(grid.shape[1], mean.dof, sensor_parameters.size)
    return NormalEquationsBuilder.joined(layout, grid.shape[0])
