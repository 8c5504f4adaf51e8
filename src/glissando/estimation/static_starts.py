"""Motions to start from where a robot is widely bent: static shapes, followed over time.

From rest, the search for the motion of a widely bent robot takes many steps, and may end in a
motion with a turn more or less. Static shapes of one moment cost far less: they are sought from
rest and from shapes drawn from the prior, and those that are probable are followed to the other
moments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from glissando.errors import UnobservableError
from glissando.estimation.bent_starts import shows_shape
from glissando.estimation.other_shapes import likely_shapes
from glissando.estimation.starting_point import between_shapes
from glissando.estimation.static_iteration import iterate
from glissando.geometry.se3 import Array
from glissando.model.evenly import evenly_chosen
from glissando.model.grid import Grid, Index
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior, load_kernels
from glissando.model.sensors.compiled_readings import CompiledReadings
from glissando.model.sensors.readings import Readings
from glissando.model.state import State, concatenate
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.located_readings import locate

_MOMENTS = 12  # time nodes at which static shapes are sought
_SLACK = 0.2  # share by which a wide bend makes the way between two read places shorter
_LOST = 0.1  # share of moments at which a shape may not be found when it is followed
_OPTIONS = SolverOptions(30, tolerance=1.0)


@dataclass(frozen=True)
class WideBend:
    """A robot that is widely bent between two read places.

    Attributes:
        prior: The prior.
        grid: The nodes.
        time: Moments (M,) with readings, s.
        readings: Readings of each stream nearest to the moments, their `time` a moment's number.
        widest: Number of the moment of the widest bend.
        shape: A static shape (1, N) of that moment.
    """

    prior: Prior
    grid: Grid
    time: Array
    readings: Sequence[Readings]
    widest: int
    shape: State

    def starts(self) -> list[State]:
        """States (K, N) to start from, likeliest first."""
        prior, grid = self.prior, self.grid
        near = [r.select(r.time == self.widest) for r in self.readings]
        likely = likely_shapes(prior, grid.arclength, near, self.shape)
        if not len(likely.pose):
            return []
        rest, time = prior.rest_state(grid), self.time
        followed = [each.with_fields_of(rest) for each in self._followed(likely)]
        if time.size == 1:
            return [each.take(np.zeros(grid.time.size, dtype=int)) for each in followed]
        inside = np.clip(grid.time, time[0], time[-1])
        return [between_shapes(each, time, inside) for each in followed]

    def _followed(self, start: State) -> list[State]:
        """Shapes (M, N) at all moments, followed from shapes (C, N) at the widest bend."""
        every, moments = range(len(start.pose)), self.time.size
        known, lost = {self.widest: start}, np.zeros(len(every), dtype=int)
        for ahead, end in ((1, moments), (-1, -1)):
            here = start
            for m in range(self.widest + ahead, end, ahead):
                given = self.prior, self.grid.arclength, self.readings, here
                found, failed = _found(*given, np.full(len(every), m))
                here = concatenate(*((here if failed[c] else found).take([c]) for c in every))
                known[m], lost = here, lost + failed
        kept = np.flatnonzero(lost <= _LOST * moments)
        return [concatenate(*(known[m].take([c]) for m in range(moments))) for c in kept]


def wide_bend(prior: Prior, grid: Grid, readings: Sequence[Readings]) -> WideBend | None:
    """The widest bend of the robot between places that are read, if any is wide.

    Args:
        prior: The prior. With a mechanical prior, or without a base, none is sought.
        grid: The nodes.
        readings: Readings to explain, inside the grid.
    """
    if isinstance(prior, MechanicalPrior) or not prior.fixes_base or grid.arclength.size < 2:
        return None
    near, time = _nearest(grid.time[evenly_chosen(grid.time.size, _MOMENTS)], readings)
    if not near:
        return None
    load_kernels(prior, "static_steps")
    rest, every = prior.rest_state(Grid.apart(grid.arclength, time.size)), np.arange(time.size)
    start, _ = _found(prior.with_soft_shear(), grid.arclength, near, rest, every)
    shapes, failed = _found(prior, grid.arclength, near, start, every)
    slack = _slack(grid.arclength, shapes, near)
    slack[failed] = np.inf if 2 * np.sum(failed) > failed.size else 0.0
    widest = int(np.argmax(slack))
    if not slack[widest] > _SLACK:
        return None
    return WideBend(prior, grid, time, near, widest, shapes.take([widest]))


def _nearest(moments: Array, readings: Sequence[Readings]) -> tuple[list[Readings], Array]:
    """Readings nearest to the moments, their `time` a moment's number, and the moments read."""
    between, out = 0.5 * (moments[1:] + moments[:-1]), list[Readings]()
    for r in readings:
        if not (len(r) and isinstance(r, CompiledReadings) and shows_shape(r)):
            continue  # a user's own sensor may cost much, and is checked by the estimate
        number = np.searchsorted(between, r.time)
        order = np.lexsort((np.abs(r.time - moments[number]), number))
        rows = order[np.unique(number[order], return_index=True)[1]]
        out.append(r.select(rows).changed(time=number[rows].astype(float)))
    read = np.unique(np.concatenate([np.zeros(0), *(r.time for r in out)]))
    out = [r.changed(time=np.searchsorted(read, r.time).astype(float)) for r in out]
    return out, moments[read.astype(np.intp)]


def _found(
    prior: Prior, arclength: Array, readings: Sequence[Readings], start: State, numbers: Index
) -> tuple[State, NDArray[np.bool_]]:
    """Static shapes (S, N) from a start, and the mask (S,) of those not found, which stay there.

    Args:
        prior: Prior of the shapes.
        arclength: Nodes (N,), m.
        readings: Readings nearest to the moments, their `time` a moment's number.
        start: Shapes (S, N) to start from.
        numbers: Number (S,) of the moment of each shape.
    """
    copied = []
    for r in readings:
        rows = [np.flatnonzero(r.time == k) for k in numbers]
        shape = np.repeat(np.arange(float(len(rows))), [own.size for own in rows])
        copied.append(r.select(np.concatenate(rows)).changed(time=shape))
    located = locate(Grid.apart(arclength, numbers.size), [r for r in copied if len(r)])
    try:
        shapes, _, failed = iterate(prior, located, start, _OPTIONS)
    except (UnobservableError, np.linalg.LinAlgError):
        return start, np.ones(numbers.size, dtype=bool)
    return shapes, failed


def _slack(arclength: Array, shapes: State, readings: Sequence[Readings]) -> Array:
    """Largest share (M,) by which the way between neighbouring read places is shorter than the arc.

    Places are the base and the nodes nearest to the readings of each moment.
    """
    stretch = np.linalg.norm(shapes.strain[..., :3], axis=-1)
    along = cumulative_trapezoid(stretch, arclength, axis=1, initial=0.0)
    out = np.zeros(len(along))
    for m in range(out.size):
        read = np.concatenate([r.arclength[r.time == m] for r in readings])
        nodes = np.unique(np.append(np.abs(arclength[:, None] - read).argmin(axis=0), 0))
        way = np.linalg.norm(np.diff(shapes.pose[m, nodes, :3, 3], axis=0), axis=-1)
        out[m] = np.max(1.0 - way / np.diff(along[m, nodes]), initial=0.0)
    return out
