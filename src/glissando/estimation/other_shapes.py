"""Other shapes that explain the readings of one moment, far from the shape that was found.

A robot that bends widely and is read at few places may have had shapes far apart. Where the
posterior leaves the direction of the body open, the search for the shape is repeated from shapes
drawn from the prior. Each distinct end has a probability proportional to its evidence by Laplace's
approximation. Source: equation (22).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.errors import UnobservableError
from glissando.estimation.static_iteration import iterate
from glissando.estimation.static_samples import draw_noise, shapes_of_prior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.located_readings import LocatedReadings, locate
from glissando.solver.static_equations import StaticEquations, linearize_static

PROBABLE = 0.02
"""Probability of other shapes from which on they are reported."""

_OPEN = 0.1  # rad: standard deviation of a tangent, above which other shapes are sought
_STARTS = 12  # shapes of the prior from which they are sought
_OPTIONS = SolverOptions(20, tolerance=1.0)
_APART = 4.0  # standard deviations of position by which two shapes are distinct
_MARGIN, _MOST = 4.0, 3  # log evidence by which likely shapes may differ; most of them
_GAP = 0.05  # distance over the length by which they are distinct
_TOGETHER = 50  # shapes for which others are sought in one batch


@dataclass(frozen=True)
class OtherShapes:
    """Shapes other than the likeliest that explain the readings of one shape.

    Attributes:
        number: Number of the shape.
        probability: Their probability together.
        distance: Largest distance of the likeliest of them from the likeliest shape, m.
        arclength: Place of that distance, m.
        likeliest: The likeliest shape (N,), if it is not the one that was found.
    """

    number: int
    probability: float
    distance: float
    arclength: float
    likeliest: State | None


def other_shapes(
    prior: Prior, arclength: Array, readings: Sequence[Readings], found: State, cov: Array
) -> list[OtherShapes]:
    """Seek other shapes for those whose readings leave the body's direction open.

    Args:
        prior: Prior of the shapes. With a mechanical prior, or without a base, none are sought.
        arclength: Nodes (N,), m.
        readings: Readings used, their `time` the number of the shape.
        found: Shapes (S, N) that were found.
        cov: Covariances (S, N, 12, 12) of their nodes.

    Returns:
        An entry for each shape of which others are probable, or another is likelier.
    """
    if isinstance(prior, MechanicalPrior) or not prior.fixes_base:
        return []
    is_open = np.flatnonzero(_swing(found, cov) > _OPEN)
    out: list[OtherShapes] = []
    for first in range(0, is_open.size, _TOGETHER):
        numbers = is_open[first : first + _TOGETHER]
        own, located = found.take(numbers), _copies(arclength, readings, numbers)
        try:
            each, evidence = _ends(prior, located, own)
        except (UnobservableError, np.linalg.LinAlgError):
            continue
        std = np.sqrt(np.einsum("snii->sn", cov[numbers][..., :3, :3]))
        out += [
            other
            for i, k in enumerate(numbers)
            if (other := _judged(int(k), arclength, each.take(i), evidence[i], std[i]))
        ]
    return out


def likely_shapes(
    prior: Prior, arclength: Array, readings: Sequence[Readings], found: State
) -> State:
    """Distinct shapes (C, N) that explain the readings of one shape, likeliest first.

    Args:
        prior: Prior of the shapes, which fixes the base.
        arclength: Nodes (N,), m.
        readings: Readings of the shape, their `time` any number.
        found: A shape (1, N) from which to search, besides shapes drawn from the prior.
    """
    own = [r.changed(time=np.zeros(len(r))) for r in readings]
    located = _copies(arclength, own, np.zeros(1, dtype=np.intp))
    try:
        each, evidence = _ends(prior, located, found, anew=True)
    except (UnobservableError, np.linalg.LinAlgError):
        return found.take(slice(0))
    order = np.argsort(-evidence[0], kind="stable")
    kept: list[int] = []
    place = each.pose[0, ..., :3, 3]
    for k in order:
        apart = np.linalg.norm(place[kept] - place[k], axis=-1).max(axis=1, initial=0.0)
        probable = evidence[0, k] > evidence[0, order[0]] - _MARGIN
        if probable and len(kept) < _MOST and np.all(apart > _GAP * arclength[-1]):
            kept.append(int(k))
    return each.take((0, kept))


def _swing(state: State, cov: Array) -> Array:
    """Largest standard deviation (S,) of the direction of a tangent of each shape, rad."""
    tangent = state.strain[..., :3] / np.linalg.norm(state.strain[..., :3], axis=-1, keepdims=True)
    rotation = cov[..., 3:6, 3:6]
    roll = np.einsum("sni,snij,snj->sn", tangent, rotation, tangent)
    swing = np.einsum("snii->sn", rotation) - roll
    return np.sqrt(np.maximum(swing, 0.0)).max(axis=1)


def _copies(arclength: Array, readings: Sequence[Readings], numbers: Index) -> LocatedReadings:
    """Readings of the shapes with these numbers, repeated for the shape found and each start."""
    count, copied = 1 + _STARTS, []
    for r in readings:
        rows = [np.flatnonzero(r.time == k) for k in numbers]
        row = np.concatenate([np.tile(own, count) for own in rows])
        shape = [np.repeat(i * count + np.arange(count), own.size) for i, own in enumerate(rows)]
        if row.size:
            copied.append(r.select(row).changed(time=np.concatenate(shape).astype(float)))
    return locate(Grid.apart(arclength, numbers.size * count), copied)


def _ends(
    prior: Prior, located: LocatedReadings, found: State, *, anew: bool = False
) -> tuple[State, Array]:
    """Shapes (S, C, N) where searches end, that found first for each, and log evidence (S, C).

    Args:
        prior: Prior of the shapes.
        located: Readings of the shapes, repeated for each start.
        found: Shapes (S, N) that were found.
        anew: Whether these are starts as well.
    """
    noise = draw_noise(prior, located, np.random.default_rng(0))
    start, own = shapes_of_prior(prior, located.grid, noise), slice(None, None, 1 + _STARTS)
    _put(start, own, found)
    shapes, _, failed = iterate(prior, located, start, _OPTIONS)
    if not anew:
        _put(shapes, own, found)
        failed[own] = False
    evidence = _log_evidence(linearize_static(prior, located, shapes))
    evidence = np.where(failed, -np.inf, evidence).reshape(len(found.pose), -1)
    return shapes.reshape(*evidence.shape, located.grid.arclength.size), evidence


def _put(state: State, where: slice, values: State) -> None:
    """Write values into some shapes of a state, in place."""
    for field, value in zip(state.fields(), values.with_fields_of(state).fields(), strict=True):
        field[where] = value


def _log_evidence(here: StaticEquations) -> Array:
    """Log evidence (S,) of shapes, up to a constant of their readings. Source: equation (22)."""
    diagonal = np.einsum("kii->ki", here.cholesky.inverse)
    half_log_det = -np.log(diagonal).reshape(len(here.rhs), -1).sum(axis=1)
    return -here.costs(here) - half_log_det


def _judged(
    number: int, arclength: Array, ends: State, evidence: Array, std: Array
) -> OtherShapes | None:
    """Other shapes among the ends (C, N) of searches, the first of which was found."""
    place = ends.pose[..., :3, 3]
    kept = [0]
    for k in np.argsort(-evidence, kind="stable"):
        apart = np.linalg.norm(place[kept] - place[k], axis=-1)[:, 1:] / std[1:]
        if np.isfinite(evidence[k]) and np.all(apart.max(axis=1) > _APART):
            kept.append(int(k))
    order = sorted(kept, key=lambda k: -evidence[k])
    share = np.exp(evidence[order] - evidence[order[0]])
    probability = float(1.0 - 1.0 / share.sum())
    if len(kept) == 1 or (probability < PROBABLE and order[0] == 0):
        return None
    away = np.linalg.norm(place[order[1]] - place[order[0]], axis=-1)
    n = int(np.argmax(away))
    likeliest = ends.take(order[0]) if order[0] else None
    return OtherShapes(number, probability, float(away[n]), float(arclength[n]), likeliest)
