"""Bent shapes to start from where rest is too far off: arcs, fitted to the readings of one time.

If a robot is bent by more than half a turn, shapes with one turn less are local minima, in which a
search from rest ends. Hundreds of arcs, each segment bent in its own direction, are solved as
static shapes in the time of a few steps of a whole estimate, and those that converge are tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from glissando.errors import UnobservableError
from glissando.estimation.static_iteration import iterate
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.model.sensors.readings import Readings
from glissando.model.state import VELOCITY, State, concatenate
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.located_readings import locate
from glissando.solver.static_equations import linearize_static

_TURN, _WAYS = np.pi, 8  # rad by which arcs turn; number of directions
_STRIDES = (1, 1, 2)  # stride between the directions tried, for one, two or three parts
_OFF = 10.0  # factor on the variance of the readings of one time, for mounts and drifts
_FIT_OPTIONS = SolverOptions(30, tolerance=1.0)
_APART = 0.5  # rad over the robot's length by which distinct shapes differ
_TRIED = 8


def bent_starts(prior: Prior, grid: Grid, readings: Sequence[Readings]) -> Iterator[State]:
    """States (K, N) to start from, at most sixteen: fitted shapes, and arcs of half a turn.

    Args:
        prior: The prior.
        grid: The nodes.
        readings: Readings to explain, inside the grid.
    """
    if grid.arclength.size < 2:
        return
    rest, half = prior.rest_state(grid), [(way,) for way in range(_WAYS)]
    kinds = [partial(_fitted, prior, grid, readings), partial(_arcs, prior, grid.arclength, half)]
    if isinstance(prior, MechanicalPrior):  # fitting one shape takes as long as trying all arcs
        kinds.reverse()
    for shapes in (kind() for kind in kinds):
        for pose, strain in zip(shapes.pose, shapes.strain, strict=True):
            along = np.broadcast_to(strain, rest.strain.shape).copy()
            yield replace(rest, pose=np.broadcast_to(pose, rest.pose.shape).copy(), strain=along)


def _arcs(prior: Prior, arclength: Array, ways: Sequence[tuple[int, ...]]) -> State:
    """Shapes (S, N) of arcs of half a turn, whose parts bend in the directions `ways`."""
    rest = prior.rest_state(Grid.apart(arclength, len(ways)))
    lengths, parts = np.diff(arclength), len(ways[0])
    segments, part = prior.joints.size + 1, np.arange(arclength.size)
    part = np.searchsorted(prior.joints, arclength, side="right") * parts // segments
    shares = np.bincount(part[:-1], lengths, minlength=parts)
    angle = 2.0 * np.pi / _WAYS * np.array(ways)[:, part]
    bend, pose = np.zeros_like(rest.strain), rest.pose.copy()
    bend[..., 3] = _TURN / shares[part] * np.cos(angle)
    bend[..., 4] = _TURN / shares[part] * np.sin(angle)
    apart = se3.log(se3.inverse(rest.pose[:, :-1]) @ rest.pose[:, 1:])
    steps = se3.exp(apart + lengths[:, None] * bend[:, :-1])
    for n in range(lengths.size):
        pose[:, n + 1] = pose[:, n] @ steps[:, n]
    return replace(rest, pose=pose, strain=rest.strain + bend)


def _fitted(prior: Prior, grid: Grid, readings: Sequence[Readings]) -> State:
    """Distinct shapes (S, N) fitted to readings in the middle of the grid, lowest cost first."""
    moment, arclength = grid.time[grid.time.size // 2], grid.arclength
    nearest = [r.time[np.abs(r.time - moment).argmin()] for r in readings if len(r)]
    near = [r.select(r.time == t) for r, t in zip(filter(len, readings), nearest, strict=True)]
    near = [r for r in near if shows_shape(r)]
    parts = min(prior.joints.size + 1, len(_STRIDES))
    ways = range(0, _WAYS, _STRIDES[parts - 1])
    arcs = _arcs(prior, arclength, list(product(ways, repeat=parts)))
    if not near:
        return arcs.take(slice(0))
    shapes, costs = _fit_shapes(prior.with_soft_shear(), arclength, near, arcs)
    different: list[int] = []
    for i in np.argsort(costs, kind="stable"):
        bends = shapes.strain[[i, *different], :, 3:5]
        gaps = np.abs(bends[1:] - bends[0]).max(axis=(1, 2), initial=0.0) * arclength[-1]
        if len(different) < _TRIED and np.isfinite(costs[i]) and np.all(gaps > _APART):
            different.append(int(i))
    return shapes.take(different)


def shows_shape(readings: Readings) -> bool:
    """Whether readings are of pose or strain at their places, and not of velocity."""
    if readings.spans or readings.accelerates:
        return False
    still = State(np.eye(4)[None], STRAIGHT[None], np.zeros((1, 6)))
    every = still.take(np.zeros(len(readings), dtype=int))
    return not readings.jacobian(every)[..., VELOCITY].any()


def _fit_shapes(
    prior: Prior, arclength: Array, readings: Sequence[Readings], start: State
) -> tuple[State, Array]:
    """Shapes (S, N), each fitted to the same readings, and costs (S,), infinite if not solved."""
    count = len(start.pose)
    rough = [r.changed(cov=_OFF * r.cov, loss=None) for r in readings]
    copies = [r.select(np.tile(np.arange(len(r)), count)) for r in rough]
    copies = [r.changed(time=np.arange(float(len(r))) // (len(r) // count)) for r in copies]
    located = locate(Grid.apart(arclength, count), copies)
    try:
        shapes, _, failed = iterate(prior, located, start, _FIT_OPTIONS)
        here = linearize_static(prior, located, shapes)
    except UnobservableError:
        return start, np.full(count, np.inf)
    except np.linalg.LinAlgError:  # one of them is too far off for weights to exist
        if count == 1:
            return start, np.array([np.inf])
        halves = start.take(slice(count // 2)), start.take(slice(count // 2, None))
        parts = [_fit_shapes(prior, arclength, readings, half) for half in halves]
        return concatenate(*(f[0] for f in parts)), np.concatenate([f[1] for f in parts])
    return shapes, np.where(failed, np.inf, here.costs(here))
