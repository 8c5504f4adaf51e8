"""Grids over arclength × time, the span that each node represents, and cells of points."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glissando.errors import OutsideGridError
from glissando.geometry.se3 import Array
from glissando.model.field_checks import is_number
from glissando.model.seconds import seconds
from glissando.model.short_repr import ShortRepr

Index = NDArray[np.intp]

SAME = 1e-9
"""Distance in metres up to which arclengths count as equal, since decimals are rounded."""
_MOST_NODES = 1e7  # time nodes of a grid; more mean a wrong unit

_LEAST_SPACING = 0.05  # of an interval: a reading closer to a node gets no node of its own
_ASKED = "Query", "Contact", "Export"  # of an estimate: points that are not those of readings
_TOLERANCE = 1e-9  # relative: of a step, to lie on a node; of the length, to lie inside the grid


def _spans(nodes: Array, lone: float = 1.0) -> Array:
    """Span of each node: half of the adjacent intervals; `lone` for a single node."""
    if nodes.size == 1:
        return np.array([lone])
    spans, halves = np.zeros(nodes.size), 0.5 * (nodes[1:] - nodes[:-1])
    spans[:-1] += halves
    spans[1:] += halves
    return spans


@dataclass(frozen=True)
class Cells:
    """Cells of points along one direction: lower node, interval length and offset in it.

    `lower` (M,) index of the node below, `step` (M,) interval length, `offset` (M,) distance
    from that node (0 ≤ offset ≤ step). A grid of one node has step and offset zero.
    """

    lower: Index
    step: Array
    offset: Array

    @property
    def share(self) -> Array:
        """Relative position (M,) in the interval, from 0 to 1."""
        return np.asarray(self.offset / np.where(self.step > 0.0, self.step, 1.0))

    @property
    def nearest(self) -> Index:
        """Index (M,) of the node at each point, for points that lie on nodes."""
        return np.asarray(self.lower + ((self.offset >= self.step) & (self.step > 0.0)))

    def take(self, rows: Index) -> Cells:
        """Cells of the points with the given indices."""
        return Cells(self.lower[rows], self.step[rows], self.offset[rows])


def _locate(nodes: Array, values: Array) -> Cells:
    if nodes.size == 1:
        zero = np.zeros(values.shape)
        return Cells(np.zeros(values.shape, dtype=np.intp), zero, zero)
    lower = np.searchsorted(nodes[1:-1], values, side="right")
    below = nodes[lower]
    step = nodes[lower + 1] - below
    offset = np.minimum(np.maximum(values - below, 0.0), step)
    offset = np.where(offset < _TOLERANCE * step, 0.0, offset)
    offset = np.where(step - offset < _TOLERANCE * step, step, offset)
    return Cells(lower, step, offset)


def reads_from(node: float, before: float | None) -> float:
    """Time, s, from which readings belong to the intervals that begin at a node.

    A reading within rounding before the node, relative to the step from `before`, lies on it.
    """
    return node if before is None else node - _TOLERANCE * (node - before)


def node_at(arclength: Array, place: float, what: str) -> int:
    """Index of the node at a place, m. Raises OutsideGridError, naming `what`, without one."""
    at = int(np.argmin(np.abs(arclength - place)))
    if abs(arclength[at] - place) > SAME:
        raise OutsideGridError(
            f"{what} at {place:g} m, which is not an arclength node of the grid (the nearest is "
            f"{arclength[at]:g} m); add it to the nodes."
        )
    return at


def points_of(arclength: ArrayLike, time: ArrayLike) -> tuple[Array, Array]:
    """Broadcast arclengths and times to arrays of one shape.

    Raises:
        OutsideGridError: They are not numbers, or their shapes do not broadcast.
    """
    try:
        given = np.asarray(arclength), np.asarray(time)
        if any(values.dtype.kind in "mMc" for values in given):
            raise TypeError(f"they are {given[0].dtype} and {given[1].dtype}")
        place, when = np.broadcast_arrays(*(values.astype(float, copy=False) for values in given))
    except (TypeError, ValueError) as problem:
        raise OutsideGridError(
            f"Places and times are numbers, m and s, whose shapes fit together ({problem})."
        ) from None
    return place, when


def segment_at(joints: Array, arclength: Array) -> Index:
    """Index (M,) of the segment at arclengths (M,); at a joint that of the segment beyond."""
    return np.searchsorted(joints, arclength + SAME, side="right")


def with_places(nodes: Array, places: Array) -> Array:
    """Arclength nodes and the given places, which replace nodes within 1e-9 m of them."""
    distance = np.abs(nodes[:, None] - places).min(axis=1, initial=np.inf)
    return np.union1d(nodes[distance > SAME], places)


@dataclass(frozen=True)
class Grid(ShortRepr):
    """Nodes over arclength (N,) in metres and time (K,) in seconds, both increasing.

    A node (k, n) represents the time span `time_spans[k]` and the arclength span
    `arclength_spans[n]`; prior densities are divided by them. The only time node (of a static
    shape) or arclength node of a grid has a span of 1. In a grid that continues another, `before`
    is the time node that precedes its first.

    >>> Grid([0.0, 0.5, 1.0], [0.0, 0.1]).arclength_spans
    array([0.25, 0.5 , 0.25])
    """

    arclength: Array
    time: Array
    before: float | None = None
    arclength_spans: Array = field(init=False, repr=False)
    time_spans: Array = field(init=False, repr=False)

    def __init__(self, arclength: ArrayLike, time: ArrayLike, before: float | None = None) -> None:
        for name, given in (("arclength", arclength), ("time", time)):
            try:
                nodes = np.atleast_1d(np.array(given, dtype=float))
            except (TypeError, ValueError):
                nodes = np.zeros(0)
            if nodes.ndim != 1 or nodes.size == 0 or not np.isfinite(nodes).all():
                raise OutsideGridError(f"Grid {name} must be a list of finite numbers: {given!r}.")
            repeated = np.diff(nodes) <= (SAME if name == "arclength" else 0.0)
            if repeated.any():
                at = int(np.argmax(repeated))
                raise OutsideGridError(
                    f"Grid {name} must increase, but node {at + 1} ({nodes[at + 1]:g}) does not "
                    f"exceed node {at} ({nodes[at]:g}). Sort the nodes and drop repeats, also "
                    f"those that differ by rounding."
                )
            object.__setattr__(self, name, nodes)
            object.__setattr__(self, f"{name}_spans", _spans(nodes))
        object.__setattr__(self, "before", before)
        if before is not None:
            if not is_number(before) or not before < self.time[0]:
                raise OutsideGridError(
                    f"The node before the grid, {before!r} s, must lie before {self.time[0]:g} s."
                )
            vars(self).update(vars(self.at_times(self.time, before)))

    @staticmethod
    def apart(arclength: ArrayLike, count: int) -> Grid:
        """Grid of `count` independent static shapes, with a time span of 1 each.

        Their times are their indices.
        """
        grid = Grid(arclength, np.arange(count))
        object.__setattr__(grid, "time_spans", np.ones(count))
        return grid

    def at_times(self, time: Array, before: float | None = None, lone: float = 1.0) -> Grid:
        """Grid with the same arclength nodes and other time nodes (K,), which are not checked.

        Args:
            time: Time nodes, increasing, s.
            before: The time node that precedes the first, s, if there is one.
            lone: Span of a single time node that no node precedes, s.
        """
        nodes = time if before is None else np.concatenate([[before], time])
        spans = _spans(nodes, lone)[nodes.size - time.size :]
        out = object.__new__(Grid)
        out.__dict__.update(self.__dict__, time=time, before=before, time_spans=spans)
        return out

    def with_nodes_at(self, time: ArrayLike) -> Grid:
        """Grid with further time nodes at the readings of intervals that contain several.

        Readings in one interval share its interpolation error (13), although this is treated as
        independent from reading to reading. At time nodes of their own it vanishes.

        Args:
            time: Times (M,) of the readings, s; a single one in an interval gets no node.

        >>> Grid([0.0, 0.5], [0.0, 1.0, 2.0]).with_nodes_at([0.2, 0.6, 1.5]).time
        array([0. , 0.2, 0.6, 1. , 2. ])
        """
        if self.time.size < 2:
            return self
        read = np.unique(np.asarray(time, dtype=float))
        read = read[(read > self.time[0]) & (read < self.time[-1])]
        lower = np.searchsorted(self.time, read, side="right") - 1
        nodes = self.time.tolist()
        for k, number in zip(*np.unique(lower, return_counts=True), strict=True):
            if number < 2:
                continue
            end = float(self.time[k + 1])
            latest, least = float(self.time[k]), _LEAST_SPACING * (end - float(self.time[k]))
            for at in read[lower == k].tolist():
                if min(at - latest, end - at) > least:
                    nodes.append(at)
                    latest = at
        return self.at_times(np.sort(nodes), self.before)

    @property
    def shape(self) -> tuple[int, int]:
        """(K, N): time nodes, arclength nodes."""
        return self.time.size, self.arclength.size

    def contains(self, arclength: Array, time: Array) -> NDArray[np.bool_]:
        """Mask (M,) of the points that lie on the grid, ends included."""
        inside = np.ones(np.broadcast(arclength, time).shape, dtype=bool)
        for nodes, values in ((self.arclength, arclength), (self.time, time)):
            slack = _TOLERANCE * max(1.0, float(nodes[-1] - nodes[0]))
            inside &= (values >= nodes[0] - slack) & (values <= nodes[-1] + slack)
        return inside

    def require(self, arclength: Array, time: Array, what: str) -> None:
        """Raise OutsideGridError, naming up to three rows, unless all points are inside."""
        outside = np.flatnonzero(~self.contains(arclength, time))
        if outside.size == 0:
            return
        first = outside[:3]
        s = np.broadcast_to(arclength, np.broadcast(arclength, time).shape)
        t = np.broadcast_to(time, s.shape)
        in_length = self.contains(s, np.full_like(s, self.time[0]))
        if np.all(in_length[outside]):
            name, values, nodes, unit = "time", t, self.time, "s"
        else:
            first = outside[~in_length[outside]][:3]
            name, values, nodes, unit = "arclength", s, self.arclength, "m"
        form = seconds if name == "time" else "{:.4g}".format
        shown = ", ".join(form(values[i]) for i in first)
        cure = "Correct them, widen the grid, or drop them (readings.inside(grid) does)."
        cure = "Ask for what lies inside." if what in _ASKED else cure
        rows = f"row {first[0]} has" if first.size == 1 else f"rows {_listed(first)} have"
        excess = np.maximum(values[outside] - nodes[-1], nodes[0] - values[outside]).max()
        far = f"up to {excess:.3g} {unit} outside" if np.isfinite(excess) else "not inside"
        raise OutsideGridError(
            f"{what}: {outside.size} of {s.size} rows lie outside the grid; {rows} {name} {shown} "
            f"{unit}, {far} [{form(nodes[0])}, {form(nodes[-1])}] {unit}. {cure}"
        )

    def locate(self, arclength: Array, time: Array) -> tuple[Cells, Cells]:
        """Cells of the points (M,) along arclength and along time."""
        return _locate(self.arclength, arclength), _locate(self.time, time)


def _listed(rows: Index) -> str:
    return ", ".join(map(str, rows))


def uniform_grid(length: float, nodes: int, start: float, stop: float, rate: float) -> Grid:
    """Evenly spaced grid: `nodes` over [0, length] m, about `rate` per s over [start, stop] s."""
    given = length, nodes, start, stop, rate
    if (
        not all(is_number(each) and np.isfinite(each) for each in given)
        or min(length, nodes, rate) <= 0.0
        or nodes != int(nodes)
        or not 0.0 <= (stop - start) * rate < _MOST_NODES
    ):
        raise OutsideGridError(
            f"No grid has {nodes!r} nodes over {length!r} m and {rate!r} a second from {start!r} "
            f"to {stop!r} s; give positive numbers, and whole ones of nodes."
        )
    count = max(2, round((stop - start) * rate) + 1)
    return Grid(np.linspace(0.0, length, int(nodes)), np.linspace(start, stop, count))
