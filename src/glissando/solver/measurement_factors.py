"""Factors of readings: residuals, and their Jacobians by grid nodes and sensor parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from glissando._kernels import normal_equations as kernels
from glissando._kernels.arrays import items, whole
from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import Interpolation, sort_points
from glissando.model.priors.acceleration import accelerated
from glissando.model.priors.prior import Prior
from glissando.model.sensors.accelerometer import AccelerometerReadings
from glissando.model.sensors.parameter_jacobians import by_parameters
from glissando.model.sensors.parameter_process import ParameterValues
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, POSE, STRAIN, State
from glissando.solver.located_readings import LocatedReadings, ReadingBatch
from glissando.solver.spanning_factors import interpolated, spanning_factor

_WAYS = ("arclength", "time")
_ROUNDED = 16.0  # least step of a finite difference, in units of the rounding of a time


def measurement_factors(
    prior: Prior, located: LocatedReadings, state: State, noise_state: State
) -> Iterator[tuple[int, Index, Factors]]:
    """Factors of readings, covariance widened by that of the interpolation. Source: (13).

    Args:
        prior: Prior that interpolates between the nodes.
        located: The readings.
        state: Nodes (K, N) to linearise at.
        noise_state: Nodes (K, N) from whose rates the interpolation's covariance is computed.

    Yields:
        Number of the stream, the rows of the readings in it, and their factors.
    """
    for batch in chain.from_iterable(located.batches):
        at = prior.interpolate(located.grid, state, noise_state, batch.points)
        first, slopes = 0, _slopes(prior, located, state, batch)
        for stream, rows, readings in batch.streams:
            own = at.take(slice(first, first + len(readings)))
            first += len(readings)
            if readings.spans:
                yield stream, rows, spanning_factor(readings, prior, located, state, noise_state)
                continue
            if isinstance(readings, AccelerometerReadings):
                place = located.grid, state, noise_state, readings.arclength, readings.time
                own = accelerated(prior, *place, float(readings.span[0]))
            at_all, beside = None, readings.beside  # on a start's coarser nodes places are fixed
            if beside is not None and beside.shape[2] == located.grid.arclength.size:
                at_all = _states_at_all_nodes(prior, located.grid, state, noise_state, readings)
            yield stream, rows, _factor(readings, own, located.parameters, slopes[stream], at_all)


def _factor(
    readings: Readings,
    at: Interpolation,
    parameters: ParameterValues,
    slopes: dict[str, Array],
    at_all: Interpolation | None = None,
) -> Factors:
    """Factors of readings at states `at`, with the states' slopes (M, 18) in arclength or time.

    The arclengths of the readings depend on the states `at_all` (M · N) at all arclength nodes, if
    these are given.
    """
    if readings.accelerates and any(p.moves for p, _ in parameters.of(readings)):
        raise SensorError(
            f"{readings.label}: where and when an accelerometer reads is not estimated; state "
            f"offsets and lags of its stream as known, without a std."
        )
    own, now, weights, residual_cov = parameters.of(readings), *np.zeros((3, len(readings), 0))
    if own:
        now, weights, residual_cov = parameters.between(readings.time)
    corrected = parameters.corrected(readings, now)
    residual, by_state = _checked(corrected, at)
    cov = corrected.cov
    if at_all is not None and corrected.beside is not None:
        by_arclength = np.einsum("mrd,md->mr", by_state, slopes["arclength"])
        travel, strain = np.moveaxis(corrected.beside, 1, 0)
        gap = at_all.state.strain.reshape(strain.shape) - strain
        residual = residual + by_arclength * np.einsum("mni,mni->m", travel, gap)[:, None]
    if "arclength" in slopes:
        along = np.einsum("mrd,md->mr", by_state, slopes["arclength"])
        var = np.broadcast_to(corrected.arclength_std**2, along.shape[:1])
        cov = cov + var[:, None, None] * along[:, :, None] * along[:, None, :]
    extras = None
    if own:
        by_extras = np.zeros((*by_state.shape[:2], parameters.process.size))
        for columns, slope in _by_parameters(readings, corrected, at, by_state, own, slopes, now):
            by_extras[..., columns] = slope
        cov = cov + (by_extras * residual_cov[:, None]) @ np.swapaxes(by_extras, -1, -2)
        extras = (by_extras[:, :, None] * weights[:, None]).reshape(*residual.shape, -1)
    m, r = residual.shape
    by_nodes, whitener = kernels.at_nodes(
        *map(whole, (by_state, at.jacobian, at.cov)), items(cov, (m,), r, r)
    )
    terms = Residuals(residual, whitener, corrected.loss)
    nodes = at.nodes
    if at_all is not None:
        nodes, by_nodes = _with_travel(nodes, by_nodes, by_arclength, travel, at_all)
    return Factors(nodes, slice(0, at.dof), by_nodes, terms, extras)


def _with_travel(
    nodes: Index, by_nodes: Array, by_arclength: Array, slope: Array, at_all: Interpolation
) -> tuple[Index, Array]:
    """Nodes and Jacobians of readings whose arclength depends on the strain along the robot.

    Args:
        nodes: Nodes (M, c) around the readings.
        by_nodes: Jacobians (M, r, c, dof) of the residuals by these nodes.
        by_arclength: Derivatives (M, r) of the residuals by the arclength.
        slope: Derivatives (M, N, 6) of the arclength by the strain at the arclength nodes.
        at_all: States at the arclength nodes at the times of the readings.

    Source: (M8).
    """
    m, n = slope.shape[:2]
    every = at_all.nodes.reshape(m, -1)
    inner = at_all.jacobian.reshape(m, n, DOF, -1, at_all.dof)[:, :, STRAIN]
    by_strain = np.einsum("mni,mnicd->mncd", slope, inner).reshape(m, every.shape[1], -1)
    wide = by_arclength[:, :, None, None] * by_strain[:, None]
    rows = np.arange(m)
    for j in range(nodes.shape[1]):
        where = (every == nodes[:, j, None]).argmax(axis=1)
        wide[rows, :, where] += by_nodes[:, :, j]
    return every, np.ascontiguousarray(wide)


def _states_at_all_nodes(
    prior: Prior, grid: Grid, state: State, noise_state: State, readings: Readings
) -> Interpolation:
    """States (M · N) at all arclength nodes at the times of readings, all on or all off nodes."""
    count = grid.arclength.size
    place = np.tile(grid.arclength, len(readings)), np.repeat(readings.time, count)
    (points,) = sort_points(grid, *place)
    return prior.interpolate(grid, state, noise_state, points)


def _by_parameters(
    readings: Readings,
    corrected: Readings,
    at: Interpolation,
    by_state: Array,
    own: Sequence[tuple[SensorParameter, slice]],
    slopes: dict[str, Array],
    now: Array,
) -> Iterator[tuple[slice, Array]]:
    """Columns and Jacobians (M, r, size) of residuals for each sensor parameter of the readings."""
    still = [(parameter, columns) for parameter, columns in own if not parameter.moves]
    values = [(parameter, now[:, columns]) for parameter, columns in still]
    slope = by_parameters(readings, corrected, at.state, by_state, values)
    yield from zip((columns for _, columns in still), slope, strict=True)
    for parameter, columns in own:
        if parameter.moves:
            slope = np.einsum("mrd,md->mr", by_state, slopes[parameter.along])
            yield columns, (slope.T * parameter.lever(readings)).T[..., None]


def _slopes(
    prior: Prior, located: LocatedReadings, state: State, batch: ReadingBatch
) -> dict[int, dict[str, Array]]:
    """Slopes (M, 18) of the state in arclength and time, as far as each stream needs them."""
    out: dict[int, dict[str, Array]] = {stream: {} for stream, _, _ in batch.streams}
    for way in _WAYS:
        moved = [(i, r) for i, _, r in batch.streams if _is_moved(r, located, way)]
        if moved:
            place, when = (np.concatenate([getattr(r, n) for _, r in moved]) for n in _WAYS)
            motion = located.motion if way == "time" and located.motion is not None else state
            slopes = state_slope(prior, located.grid, motion, place, when, way)
            parts = np.split(slopes, np.cumsum([len(r) for _, r in moved])[:-1])
            for (stream, r), part in zip(moved, parts, strict=True):
                if way == "arclength" and r.winding is not None:
                    part[:, POSE] += r.winding
                if way == "time":
                    part *= located.shares.get(r.name, 1.0)
                out[stream][way] = part
    return out


def _is_moved(readings: Readings, located: LocatedReadings, way: str) -> bool:
    """Whether the arclength or time of readings, as named by `way`, is uncertain."""
    if readings.spans or readings.accelerates:
        return False
    if way == "arclength" and (readings.beside is not None or np.any(readings.arclength_std)):
        return True
    return any(p.moves and p.along == way for p, _ in located.parameters.of(readings))


def state_slope(
    prior: Prior, grid: Grid, state: State, arclength: Array, time: Array, way: str
) -> Array:
    """Slope (M, 18) of the state along `way`, arclength or time, at points (M,) of the grid.

    The slope is zero along a direction in which the grid has a single node.
    """
    nodes, points, m = getattr(grid, way), [arclength, time], time.size
    if nodes.size == 1:
        return np.zeros((m, DOF))
    along, least = _WAYS.index(way), float(np.spacing(np.abs(nodes).max()))  # of seconds since 1970
    nudge = max(1e-6 * float(nodes[-1] - nodes[0]), _ROUNDED * least)
    ends = np.concatenate([points[along] + nudge, points[along] - nudge])
    ends = np.clip(ends, nodes[0], nodes[-1])
    points[along], points[1 - along] = ends, np.tile(points[1 - along], 2)
    at = states_at(prior, grid, state, *points)
    rise = at.take(slice(m)).rise_from(at.take(slice(m, None)))
    return np.asarray(rise / (ends[:m] - ends[m:])[:, None])


def states_at(prior: Prior, grid: Grid, state: State, arclength: Array, time: Array) -> State:
    """Mean at points (M,) of the grid, interpolated between nodes (K, N)."""
    return interpolated(prior, grid, state, state, arclength, time)[0]


def _checked(readings: Readings, at: Interpolation) -> tuple[Array, Array]:
    """Residual (M, r), checked to be finite, and its Jacobian (M, r, 18); shapes are checked."""
    m = at.nodes.shape[0]
    residual = readings.residual(at.state)
    dof = at.jacobian.shape[1]
    if np.shape(residual) != (m, readings.row_count):
        raise SensorError(
            f"{readings.label}: residual(at) returns shape {np.shape(residual)}; return "
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
    if np.shape(by_state) != (m, readings.row_count, dof):
        raise SensorError(
            f"{readings.label}: jacobian(at) returns shape {np.shape(by_state)}; return "
            f"{(m, readings.row_count, dof)}, or leave it out."
        )
    return residual, by_state
