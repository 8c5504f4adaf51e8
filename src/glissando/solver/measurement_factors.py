"""Readings placed on a grid: by block of time and by cell, shifted by what is unknown of them."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import Interpolation, Points, sort_points
from glissando.model.noise import sqrt_information
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameters import EstimatedParameters, SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, State
from glissando.twins import twin

_NUDGE = 1e-5  # by which unknowns are moved to find how readings depend on them
_FACTORS = 700  # prior factors linearised together: fewer waste calls, more outgrow the caches


def blocks_of_time(grid: Grid) -> list[slice]:
    """Runs of time nodes to linearise together, so that intermediate arrays stay small."""
    k_count, n_count = grid.shape
    size = max(1, _FACTORS // n_count)
    return [slice(k, min(k + size, k_count)) for k in range(0, k_count, size)]


@dataclass(frozen=True)
class _Part:
    """Readings that touch equally many nodes: their points, and by stream its rows of them."""

    points: Points
    readings: list[tuple[int, Index, Readings]]


class MeasurementFactors:
    """All readings, sorted by block of time and by the part of a cell they fall in.

    Readings of all sensors that touch equally many nodes are interpolated together. `values` (K, E)
    of `sensor_parameters` shift them; those that no sensor has are left out unless `keep_all`.
    Raises OutsideGridError for readings off the grid.
    """

    def __init__(
        self,
        grid: Grid,
        readings: Sequence[Readings],
        sensor_parameters: Sequence[SensorParameter] = (),
        values: Array | None = None,
        *,
        keep_all: bool = False,
    ) -> None:
        self.grid = grid
        self.blocks = blocks_of_time(grid)
        self._given = [r for r in readings if len(r)]
        used = [
            u
            for u in sensor_parameters
            if keep_all or any(r.name in u.streams for r in self._given)
        ]
        self.sensor_parameters = EstimatedParameters(grid, used)
        self.values = self.sensor_parameters.expected() if values is None else values
        self._require_inside()
        self._parts = self._placed()

    def _require_inside(self) -> None:
        place, time = (
            np.concatenate([np.zeros(0), *(getattr(r, name) for r in self._given)])
            for name in ("arclength", "time")
        )
        if not self.grid.contains(place, time).all():
            for r in self._given:
                self.grid.require(r.arclength, r.time, r.label)

    @property
    def streams(self) -> list[tuple[int, Readings]]:
        """How many readings each stream has, and the stream."""
        return [(len(r), r) for r in self._given]

    def _placed(self) -> list[list[_Part]]:
        """The parts of every block."""
        parts: list[list[_Part]] = [[] for _ in self.blocks]
        readings = [self._in_place(r) for r in self._given]
        if not readings:
            return parts
        owner = np.repeat(np.arange(len(readings)), [len(r) for r in readings])
        row = np.concatenate([np.arange(len(r)) for r in readings])
        arclength = np.concatenate([r.arclength for r in readings])
        time = np.concatenate([r.time for r in readings])
        starts = [self.grid.time[block.start] for block in self.blocks]
        block_of = np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)
        for i in range(len(self.blocks)):
            here = np.flatnonzero(block_of == i)
            for points in sort_points(self.grid, arclength[here], time[here]):
                own = here[points.rows]
                ends = np.cumsum(np.bincount(owner[own], minlength=len(readings)))
                split, first = [], 0
                for j, (r, end) in enumerate(zip(readings, ends, strict=True)):
                    if end > first:
                        at = row[own[first:end]]
                        split.append((j, at, r if at.size == len(r) else r.select(at)))
                    first = end
                parts[i].append(_Part(points, split))
        return parts

    def rows(self, block: int) -> Iterator[tuple[int, Index]]:
        """The stream, and which of its rows, of each batch that `factors` yields."""
        for part in self._parts[block]:
            for stream, rows, _ in part.readings:
                yield stream, rows

    def moved(self, step: Array) -> MeasurementFactors:
        """The readings where unknowns moved by `step` (K, E) put them."""
        if not step.any():
            return self
        there = copy.copy(self)
        there.values = self.values + step
        if any(u.moves for u in self.sensor_parameters.each):
            there._parts = there._placed()
        return there

    def _in_place(self, readings: Readings) -> Readings:
        """Readings where and when the unknowns say they were taken, as far as the grid reaches."""
        grid, stamped = self.grid, readings
        if not any(u.moves for u, _ in self._of(readings)):
            return readings
        for _ in range(2):  # as a delay is that of the true time, which the first pass finds
            now, readings = self._now(readings.time), stamped
            for unknown, at in self._of(readings):
                if unknown.moves:
                    readings = unknown.shift(readings, now[:, at])
        return readings.changed(
            arclength=np.clip(readings.arclength, grid.arclength[0], grid.arclength[-1]),
            time=np.clip(readings.time, grid.time[0], grid.time[-1]),
        )

    def _of(self, readings: Readings) -> list[tuple[SensorParameter, slice]]:
        pairs = zip(self.sensor_parameters.each, self.sensor_parameters.columns, strict=True)
        return [(u, at) for u, at in pairs if readings.name in u.streams]

    def _now(self, time: Array) -> Array:
        """The unknowns (M, E) at these times."""
        time = np.clip(time, self.grid.time[0], self.grid.time[-1])
        lower, weights, _ = self.sensor_parameters.between(time)
        upper = np.minimum(lower + 1, len(self.values) - 1)
        off = self.values - self.sensor_parameters.mean
        return self.sensor_parameters.mean + weights[:, 0] * off[lower] + weights[:, 1] * off[upper]

    def known_now(self) -> list[tuple[SensorParameter, Array]]:
        """The unknowns that are estimated with their values (K, size) at the time nodes."""
        pairs = zip(self.sensor_parameters.each, self.sensor_parameters.columns, strict=True)
        return [(u, self.values[:, at]) for u, at in pairs]

    def factors(self, prior: Prior, state: State, about: State, block: int) -> Iterator[Factors]:
        """Factors of one block's readings, covariance widened by the bridge. Source: (13)."""
        for part in self._parts[block]:
            at = prior.interpolate(self.grid, state, about, part.points)
            first = 0
            for _, _, r in part.readings:
                rows = slice(first, first + len(r))
                slopes = {}
                for way in _ways(r, [u for u, _ in self._of(r)]):
                    slopes[way] = slope(prior, self.grid, state, r, way)
                yield self._factor(r, at.take(rows), slopes)
                first += len(r)

    def _factor(self, readings: Readings, at: Interpolation, slopes: dict[str, Array]) -> Factors:
        """Factors of readings at the states `at`, whose slopes (M, 18) are given where needed."""
        mine = self._of(readings)
        now = self._now(readings.time) if mine else np.zeros((len(readings), 0))
        shifted = readings
        for unknown, columns in mine:
            if not unknown.moves:
                shifted = unknown.shift(shifted, now[:, columns])
        residual, by_state = _sound(shifted, at)
        cov = shifted.cov
        if "arclength" in slopes:
            along = np.einsum("mrd,md->mr", by_state, slopes["arclength"])
            var = np.broadcast_to(shifted.arclength_std**2, along.shape[:1])
            cov = cov + var[:, None, None] * along[:, :, None] * along[:, None, :]
        extras = None
        if mine:
            by_extras = self._by_unknowns(readings, at, by_state, slopes, now)
            _, weights, left = self.sensor_parameters.between(readings.time)
            cov = cov + (by_extras * left[:, None]) @ np.swapaxes(by_extras, -1, -2)
            extras = (by_extras[:, :, None] * weights[:, None]).reshape(*residual.shape, -1)
        by_nodes, whitener = by_nodes_of(by_state, at.jacobian, at.cov, cov)
        touched = np.flatnonzero(by_nodes.reshape(-1, at.dof).any(axis=0))
        dofs = slice(int(touched[0]), int(touched[-1]) + 1) if touched.size else slice(0, 1)
        terms = Residuals(residual, whitener, shifted.loss)
        return Factors(at.nodes, dofs, by_nodes[..., dofs], terms, extras)

    def _by_unknowns(
        self,
        readings: Readings,
        at: Interpolation,
        by_state: Array,
        slopes: dict[str, Array],
        now: Array,
    ) -> Array:
        """Jacobian (M, r, E) of residuals with respect to the unknowns at the readings' times."""
        out = np.zeros((*by_state.shape[:2], self.sensor_parameters.size))
        for unknown, columns in self._of(readings):
            if unknown.moves:
                along = unknown.kind == "arclength_offset"
                sign, way = (1.0, "arclength") if along else (-1.0, "time")
                out[..., columns.start] = sign * np.einsum("mrd,md->mr", by_state, slopes[way])
                continue
            for i, nudge in enumerate(_NUDGE * np.eye(unknown.size)):
                ends = []
                for sign in (1.0, -1.0):
                    moved = readings
                    for other, its in self._of(readings):
                        if not other.moves:
                            x = now[:, its] + (sign * nudge if other is unknown else 0.0)
                            moved = other.shift(moved, x)
                    ends.append(moved.residual(at.state))
                out[..., columns.start + i] = (ends[0] - ends[1]) / (2.0 * _NUDGE)
        return out


@twin
def by_nodes_of(by_state: Array, jacobian: Array, left: Array, cov: Array) -> tuple[Array, Array]:
    """Slopes (M, r, c, d) of residuals by nodes, and what whitens them (M, r, r).

    `by_state` (M, r, 18) is their slope by the state between the nodes, which has slopes `jacobian`
    (M, 18, c, d) and what nodes `left` uncertain (M, 18, 18), added to `cov`, (r, r) or (M, r, r).
    """
    (m, dof, c, d), r = jacobian.shape, by_state.shape[1]
    whitener = sqrt_information(cov + by_state @ left @ np.swapaxes(by_state, -1, -2))
    return (by_state @ jacobian.reshape(m, dof, c * d)).reshape(m, r, c, d), whitener


def _ways(readings: Readings, sensor_parameters: Sequence[SensorParameter]) -> list[str]:
    """Which slopes of the state readings need: along arclength, along time."""
    kinds = {u.kind for u in sensor_parameters}
    ways = ["arclength"] if "arclength_offset" in kinds or np.any(readings.arclength_std) else []
    return ways + ["time"] * ("time_offset" in kinds)


def slope(prior: Prior, grid: Grid, state: State, readings: Readings, way: str) -> Array:
    """Slope (M, 18) of the state along arclength or time where readings were taken."""
    nodes = getattr(grid, way)
    nudge = 1e-6 * float(nodes[-1] - nodes[0])
    here, ends = getattr(readings, way), []
    for sign in (1.0, -1.0):
        there = np.clip(here + sign * nudge, nodes[0], nodes[-1])
        moved = readings.changed(**{way: there})
        ends.append((there, states_at(prior, grid, state, moved.arclength, moved.time)))
    (ahead, high), (behind, low) = ends
    out: Array = high.difference(low) / (ahead - behind)[:, None]
    return out


def states_at(prior: Prior, grid: Grid, state: State, arclength: Array, time: Array) -> State:
    """The mean at points (M,) of the grid."""
    out = State(np.empty((time.size, 4, 4)), *np.empty((2, time.size, 6)))
    for points in sort_points(grid, arclength, time):
        found = prior.interpolate(grid, state, state, points).state
        out.pose[points.rows], out.strain[points.rows] = found.pose, found.strain
        out.velocity[points.rows] = found.velocity
    return out


def _sound(readings: Readings, at: Interpolation) -> tuple[Array, Array]:
    """Residual (M, r) and its Jacobian (M, r, 18), refused unless of that shape and finite."""
    m = at.nodes.shape[0]
    residual = readings.residual(at.state)
    if residual.shape != (m, readings.row_count):
        raise SensorError(
            f"{readings.label}: residual(at) returns shape {residual.shape}; return "
            f"{(m, readings.row_count)}, a row for each reading."
        )
    if not np.isfinite(residual).all():
        if not np.all(np.isfinite(at.state.pose)):
            raise np.linalg.LinAlgError("the state is not finite")
        row = int(np.argwhere(~np.isfinite(residual))[0, 0])
        raise SensorError(
            f"{readings.label}: the residual of row {row} is not finite; give every reading and "
            f"every state a finite one."
        )
    by_state = readings.jacobian(at.state)
    if by_state.shape != (m, readings.row_count, DOF):
        raise SensorError(
            f"{readings.label}: jacobian(at) returns shape {by_state.shape}; return "
            f"{(m, readings.row_count, DOF)}, or leave it out."
        )
    return residual, by_state
