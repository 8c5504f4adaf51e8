"""Readings located on a grid: by block of time nodes, and on a node, a grid line or in a cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index, reads_from
from glissando.model.interpolation import Points, sort_points
from glissando.model.priors.prior import Prior, without_roll_transport
from glissando.model.sensors.parameter_process import EstimatedParameters, ParameterValues
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import State

_FACTORS = 700  # prior factors linearised together: fewer cost more calls, more exceed the caches


def time_blocks(grid: Grid) -> list[slice]:
    """Runs of time nodes to linearise together, so that intermediate arrays stay small."""
    k_count, n_count = grid.shape
    size = max(1, _FACTORS // n_count)
    return [slice(k, min(k + size, k_count)) for k in range(0, k_count, size)]


@dataclass(frozen=True)
class ReadingBatch:
    """Readings that depend on equally many nodes.

    Attributes:
        points: Places and times of the readings, stream after stream.
        streams: For each stream its number, the rows of its readings, and these readings.
    """

    points: Points
    streams: list[tuple[int, Index, Readings]]


@dataclass(frozen=True)
class LocatedReadings:
    """All readings with the grid cells that contain them.

    Attributes:
        grid: The nodes.
        streams: Readings of each sensor, before sensor parameters displace them.
        parameters: Values of the sensor parameters that are estimated.
        blocks: Runs of time nodes that are linearised together.
        batches: Readings of each block: on a node, on a grid line, or inside a cell.
        motion: Nodes (K, N) whose motion gives derivatives by delays; those linearised at if None.
        shares: Factor on these derivatives by name of the stream; 1 for streams not listed.
    """

    grid: Grid
    streams: list[Readings]
    parameters: ParameterValues
    blocks: list[slice]
    batches: list[list[ReadingBatch]]
    motion: State | None = None
    shares: Mapping[str, float] = field(default_factory=dict)

    @property
    def moves(self) -> bool:
        """Whether sensor parameters shift the arclengths or times of readings."""
        return any(parameter.moves for parameter in self.parameters.process.each)

    @property
    def weighted(self) -> bool:
        """Whether a robust loss weights any reading by its residual."""
        return any(stream.loss is not None for stream in self.streams)

    def factor_prior(self, prior: Prior) -> Prior:
        """The prior, without transport by roll if any of the readings resolve the body's axes."""
        resolving = any(stream.resolves_axes for stream in self.streams)
        return without_roll_transport(prior) if resolving else prior

    def moved(self, step: Array) -> LocatedReadings:
        """The readings after a step (K, E) of the sensor parameters, located again if shifted."""
        if not step.any():
            return self
        parameters = replace(self.parameters, values=self.parameters.values + step)
        batches = self.batches
        if self.moves:
            batches = _batches(self.grid, self.streams, parameters, self.blocks)
        return replace(self, parameters=parameters, batches=batches)


def locate(
    grid: Grid,
    readings: Sequence[Readings],
    sensor_parameters: Sequence[SensorParameter] = (),
    values: Array | None = None,
    *,
    keep_all: bool = False,
) -> LocatedReadings:
    """Find the grid cells that contain the readings.

    Args:
        grid: The nodes.
        readings: The readings of each sensor.
        sensor_parameters: Parameters of the sensors; those that are known are left out.
        values: Values (K, E) of the estimated parameters; their expected values if None.
        keep_all: Keep also parameters of sensors that have no readings.

    Raises:
        OutsideGridError: A reading lies outside the grid.
        SensorError: A sensor slides in a channel and its arclengths have not been computed.
    """
    streams = [r for r in readings if len(r)]
    for r in streams:
        if r.channel is not None:
            raise SensorError(
                f"{r.label} slides in a channel off the axis, so where it is depends on the shape: "
                f"estimate a recording with it, or place it by `place_in_channel` first."
            )
    named = {r.name for r in streams}
    estimated = [p for p in sensor_parameters if keep_all or named.intersection(p.streams)]
    process = EstimatedParameters(grid, estimated)
    parameters = ParameterValues(process, process.expected() if values is None else values)
    arclength, time = _joined(streams)
    if not grid.contains(arclength, time).all():
        for r in streams:
            grid.require(r.arclength, r.time, r.label)
    blocks = time_blocks(grid)
    return LocatedReadings(
        grid, streams, parameters, blocks, _batches(grid, streams, parameters, blocks)
    )


def _joined(streams: Sequence[Readings]) -> tuple[Array, Array]:
    """Arclengths and times of all readings."""
    names = ("arclength", "time")
    first, second = (
        np.concatenate([np.zeros(0), *(getattr(r, n) for r in streams)]) for n in names
    )
    return first, second


def _batches(
    grid: Grid, streams: Sequence[Readings], parameters: ParameterValues, blocks: Sequence[slice]
) -> list[list[ReadingBatch]]:
    """Readings of every block: on a node, on a grid line or in a cell; then by stream.

    Readings that parameters shift off the grid are clamped to its ends. On a grid that continues
    another, readings before its start are left out: they were used on the earlier grid.
    """
    if not streams:
        return [[] for _ in blocks]
    begins = np.cumsum([0, *map(len, streams)])
    displaced = [parameters.displaced(r) for r in streams]
    used_before = _joined(displaced)[1] < reads_from(float(grid.time[0]), grid.before)
    used_before &= grid.before is not None
    streams = [
        r if moved is r else _clamped_to(grid, moved)
        for r, moved in zip(streams, displaced, strict=True)
    ]
    arclength, time = _joined(streams)
    starts = [grid.time[block.start] for block in blocks]
    block_of = np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)
    batches: list[list[ReadingBatch]] = []
    for i in range(len(blocks)):
        in_block = np.flatnonzero((block_of == i) & ~used_before)
        batches.append([])
        for points in sort_points(grid, arclength[in_block], time[in_block]):
            own = in_block[points.rows]
            ends = np.searchsorted(own, begins)
            parts = (
                own[a:b] - begin for (a, b), begin in zip(pairwise(ends), begins, strict=False)
            )
            split = [
                (j, at, r if at.size == len(r) else r.select(at))
                for j, (r, at) in enumerate(zip(streams, parts, strict=True))
                if at.size
            ]
            batches[-1].append(ReadingBatch(points, split))
    return batches


def _clamped_to(grid: Grid, readings: Readings) -> Readings:
    """Readings with arclengths and times clamped to the grid."""
    return readings.changed(
        arclength=np.clip(readings.arclength, grid.arclength[0], grid.arclength[-1]),
        time=np.clip(readings.time, grid.time[0], grid.time[-1]),
    )
