"""What is not known exactly about sensors: frames, mounts, offsets, biases; constant or drifting.

An unknown shifts the readings of its streams. It is estimated with the states: a process in time of
known spread about its value, with the memory of an Ornstein-Uhlenbeck process, or none of its own
for a constant. One that is known (`std` absent) is applied and never moves. Source: (16), (18).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from glissando.errors import SensorError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.sensors.readings import Readings

_CONSTANT = 1e6  # times the recording: the memory of a constant, long enough to count as for ever


def _frame(r: Readings, x: Array) -> Readings:
    shift = se3.exp(x)
    if r.value_shape == (4, 4):
        return r.changed(values=shift @ r.values)
    if r.value_shape == (3, 3):
        return r.changed(values=shift[:, :3, :3] @ r.values)
    turned = (shift[:, :3, :3] @ r.values[..., None])[..., 0]
    return r.changed(values=turned + shift[:, :3, 3])


def _mount(r: Readings, x: Array) -> Readings:
    return r.changed(mount=r.mount @ se3.exp(x if len(x) > 1 else x[0]))


def _bias(r: Readings, x: Array) -> Readings:
    return r.changed(values=r.values - x)


def _arclength_offset(r: Readings, x: Array) -> Readings:
    return r.changed(arclength=r.arclength + x[:, 0])


def _time_offset(r: Readings, x: Array) -> Readings:
    return r.changed(time=r.time - x[:, 0])


_SHIFTS: dict[str, Callable[[Readings, Array], Readings]] = {
    "frame": _frame,
    "mount": _mount,
    "bias": _bias,
    "arclength_offset": _arclength_offset,
    "time_offset": _time_offset,
}
SIZES = {"frame": 6, "mount": 6, "bias": 3, "arclength_offset": 1, "time_offset": 1}
"""Kinds of unknown and how many numbers each has."""

_FOR = {"frame": ((4, 4), (3, 3), (3,)), "bias": ((3,),)}  # kinds of value each is made for


@dataclass(frozen=True)
class SensorParameter:
    """Something about the sensors `streams` that is not known exactly.

    `kind` is world (the transform (6,) from their frame to the world, as a logarithm), mount (a
    further transform (6,) of the sensor in the cross-section), bias (3,) of a gyroscope or a
    position, slide (an offset (1,) of the arclength, m) or delay (how late (1,) their stamps are,
    s). `value` is what is expected and `std` how far it may be off; a `std` of zeros says it is
    known. It holds still, or wanders with `correlation_time` seconds. Raises SensorError when the
    kind is not known or the sizes do not fit.
    """

    name: str
    kind: str
    streams: tuple[str, ...]
    value: Array
    std: Array
    correlation_time: float = np.inf

    def __post_init__(self) -> None:
        if self.kind not in SIZES:
            kinds = ", ".join(SIZES)
            raise SensorError(f"Unknown {self.name!r} is a {self.kind!r}; choose one of {kinds}.")
        for part in ("value", "std"):
            given = np.asarray(getattr(self, part), dtype=float)
            object.__setattr__(self, part, given)
            if given.shape != (self.size,) or not np.all(np.isfinite(given)):
                raise SensorError(
                    f"Unknown {self.name!r}: {part} is {given}; give {self.size} numbers."
                )
        if np.any(self.std < 0.0) or not self.correlation_time > 0.0:
            raise SensorError(
                f"Unknown {self.name!r}: std {self.std} and correlation time "
                f"{self.correlation_time:g} s must not be negative."
            )

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return SIZES[self.kind]

    @property
    def known(self) -> bool:
        """Whether it is as given and not estimated."""
        return not np.any(self.std > 0.0)

    @property
    def moves(self) -> bool:
        """Whether it changes where or when readings were taken."""
        return self.kind in ("arclength_offset", "time_offset")

    def shift(self, readings: Readings, x: Array) -> Readings:
        """The readings put right, were the unknown `x` (M, size), or (size,) for all of them."""
        fits = _FOR.get(self.kind)
        if fits is not None and readings.value_shape not in fits:
            raise SensorError(
                f"Unknown {self.name!r}: a {type(readings).__name__} has no {self.kind}."
            )
        return _SHIFTS[self.kind](readings, np.atleast_2d(x))


def corrected(readings: Readings, sensor_parameters: Sequence[SensorParameter]) -> Readings:
    """The readings with every unknown of theirs at its expected value."""
    for unknown in sensor_parameters:
        if readings.name in unknown.streams and np.any(unknown.value != 0.0):
            readings = unknown.shift(readings, unknown.value)
    return readings


class EstimatedParameters:
    """Those unknowns that are estimated, side by side as E numbers a time node."""

    def __init__(self, grid: Grid, sensor_parameters: Sequence[SensorParameter]) -> None:
        self.each = tuple(u for u in sensor_parameters if not u.known)
        self.grid = grid
        ends = np.cumsum([0, *(u.size for u in self.each)])
        self.columns = [slice(a, b) for a, b in pairwise(ends)]
        self.size = int(ends[-1])
        span = max(float(grid.time[-1] - grid.time[0]), 1.0)
        memory = [np.full(u.size, min(u.correlation_time, _CONSTANT * span)) for u in self.each]
        self.memory = np.concatenate([np.zeros(0), *memory])
        self.mean = np.concatenate([np.zeros(0), *(u.value for u in self.each)])
        self.std = np.concatenate([np.zeros(0), *(np.maximum(u.std, 1e-12) for u in self.each)])

    def expected(self) -> Array:
        """Every unknown at its expected value (K, E)."""
        return np.tile(self.mean, (self.grid.time.size, 1))

    def chain(self) -> tuple[Array, Array]:
        """What of an unknown is left a time step on (K−1, E), and the spread (K, E) of the rest.

        The first spread is that of the first time.
        """
        a = np.diff(self.grid.time)[:, None] / self.memory
        rest = self.std * np.sqrt(-np.expm1(-2.0 * a))
        return np.exp(-a), np.concatenate([self.std[None], rest])

    def between(self, time: Array) -> tuple[Array, Array, Array]:
        """Lower time node (M,), weights (M, 2, E) of it and the next, and leftover variance (M, E).

        An Ornstein-Uhlenbeck bridge; a single time node is its own.
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
        ends = np.sinh(whole - near), np.sinh(near)
        weights = np.stack(ends, axis=1) / np.sinh(whole)[:, None]
        left = 2.0 * self.std**2 * ends[0] * ends[1] / np.sinh(whole)
        return lower, weights, left
