"""Acceleration of a rod's bending modes at nodes and between them. Source: equation (33)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.linalg
from numpy.polynomial.legendre import leggauss

from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.interpolation import Interpolation
from glissando.model.priors.acceleration import accelerated_in_world
from glissando.model.priors.mechanical.inertia import (
    PINNED,
    ModalMotion,
    bridge_covariance,
    cubic,
    driven_mode,
    modal_slopes,
    modal_values,
)
from glissando.model.state import State

_POINTS = 12  # for quadrature


def modal_acceleration(
    motion: ModalMotion, grid: Grid, state: State, at: Interpolation, arclength: Array, time: Array
) -> Interpolation:
    """States with acceleration (M, 24) at points, all on time nodes or all between them.

    Args:
        motion: Damped bending modes.
        grid: Grid of the nodes.
        state: States (K, N) of the nodes.
        at: Interpolated state at the points.
        arclength: Arclengths (M,) of the points, m.
        time: Times (M,) of the points, s.
    """
    cells = grid.locate(arclength, time)[1]
    between = bool(np.all((cells.offset > 0.0) & (cells.offset < cells.step)))
    first = cells.lower if between else cells.nearest
    ends = [first, first + 1] if between else [first]
    times, which = np.unique(np.concatenate(ends), return_inverse=True)
    which = which.reshape(len(ends), -1)
    values = modal_values(motion.modes, state.take(times))
    slopes = modal_slopes(motion.modes, state.take(times))
    if between:
        functionals = [_within(motion, s, o) for s, o in zip(cells.step, cells.offset, strict=True)]
        weights, spread = (np.stack(each) for each in zip(*functionals, strict=True))
    else:
        count = motion.modes.rate.size
        one = np.zeros((1, count, 4))
        one[0, :, 1], one[0, :, 2] = -motion.damping, 1.0
        weights = np.broadcast_to(one, (time.size, *one.shape))
        spread = np.zeros((time.size, count, count))
    world, by_nodes = [], []
    shape, along = motion.modes.at(arclength)
    for mode in (shape, along):
        scaled = mode[:, None, :, None] * weights  # (M, ends, m, 4)
        pairs = [(scaled[:, e], which[e]) for e in range(len(ends))]
        world.append(sum(np.einsum("mjq,mqjx->mx", w, values[rows]) for w, rows in pairs))
        parts = [np.einsum("mjq,mqjxnd->mxnd", w, slopes[rows]) for w, rows in pairs]
        by_nodes.append(np.concatenate(parts, axis=2))
    left = np.einsum("mi,mij,mj->m", shape, spread, shape) + PINNED**2
    n_count = grid.arclength.size
    nodes = np.concatenate([(k * n_count)[:, None] + np.arange(n_count) for k in ends], axis=1)
    variance = left[:, None, None] * np.eye(3)
    return accelerated_in_world(at, nodes, (*world, variance), (by_nodes[0], by_nodes[1]))


def _within(motion: ModalMotion, step: float, offset: float) -> tuple[Array, Array]:
    """Weights (2, m, 4) of [y, ẏ, β, β̇] at both ends in ÿ inside a step, covariance (m, m)."""
    weights, cov = _functional(
        tuple(motion.modes.rate),
        tuple(motion.damping),
        round(step, 12),
        round(offset, 9),
        motion.time_scale,
    )
    return weights, cov * motion.modes.load


@lru_cache(maxsize=4096)
def _functional(
    rate: tuple[float, ...],
    damping: tuple[float, ...],
    step: float,
    offset: float,
    time_scale: float,
) -> tuple[Array, Array]:
    """Weights (2, m, 4) and covariance (m, m) for loads of unit variance.

    ÿ = D − c ẏ − ω² y; y and ẏ follow from the beginning, D is a cubic through both ends.
    """
    x, w = leggauss(_POINTS)
    points, weight = 0.5 * offset * (x + 1.0), 0.5 * offset * w
    coefficients, derivatives = cubic(step)
    u = offset / step
    now = np.array([1.0, u, u**2, u**3]) @ coefficients  # D by [D, Ḋ] of both ends
    out, pull = np.zeros((2, len(rate), 4)), np.zeros((len(rate), _POINTS + 1))
    for j, (omega, c) in enumerate(zip(rate, damping, strict=True)):
        own, chain = driven_mode(omega, c, step)
        exponential = scipy.linalg.expm(u * chain)
        back = own[1]
        free = back @ exponential[:2, :2]
        forced = now + back @ exponential[:2, 2:] @ derivatives
        for end in (0, 1):
            own_forced = forced[2 * end : 2 * end + 2]
            out[end, j] = np.concatenate([-back[0] * own_forced, own_forced])
        out[0, j, :2] += free
        green = scipy.linalg.expm((offset - points)[:, None, None] * own)[:, :, 1]
        pull[j] = np.append(weight * (green @ back), 1.0)
    cov = bridge_covariance(step, time_scale, np.append(points, offset))
    return out, pull @ cov @ pull.T
