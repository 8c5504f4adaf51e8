"""The state between the nodes of the white-noise prior, in numpy."""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import Interpolation, Points
from glissando.model.priors.prior import interval_strain
from glissando.model.priors.steps import ARCLENGTH, TIME
from glissando.model.priors.white_noise import WhiteNoisePrior
from glissando.model.state import DOF, State
from oracles.steps import bridged


def interpolate(
    prior: WhiteNoisePrior, grid: Grid, state: State, noise_state: State, points: Points
) -> Interpolation:
    """State at points between the nodes, conditional on the nodes. Source: (10) to (12)."""
    s, t = points.along, points.through
    flat, n_count = state.flatten(), grid.arclength.size
    if not points.inside_time:
        if points.inside_arclength:
            return _along_arclength(prior, grid, flat, noise_state, points, t.nearest)
        node = t.nearest * n_count + s.nearest
        eye, none = np.zeros((2, node.size, DOF, DOF))
        np.einsum("mii->mi", eye)[...] = 1.0
        return Interpolation(flat.take(node), node[:, None], eye[:, :, None], none)
    if not points.inside_arclength:  # both ends are nodes
        nodes = (t.lower * n_count + s.nearest)[:, None] + np.array([0, n_count])
        start, end = flat.take(nodes[:, 0]), flat.take(nodes[:, 1])
        at, j0, j1, cov = _between_times(prior, grid, noise_state, points, start, end)
        return Interpolation(at, nodes, np.stack([j0, j1], axis=2), cov)
    early, late = (
        _along_arclength(prior, grid, flat, noise_state, points, k) for k in (t.lower, t.lower + 1)
    )
    at, j0, j1, cov = _between_times(prior, grid, noise_state, points, early.state, late.state)
    for jacobian, corner in ((j0, early), (j1, late)):
        cov = cov + jacobian @ corner.cov @ np.swapaxes(jacobian, -1, -2)
    j0, j1 = chained(j0, early.jacobian), chained(j1, late.jacobian)
    nodes = np.concatenate([early.nodes, late.nodes], axis=1)
    return Interpolation(at, nodes, np.concatenate([j0, j1], axis=2), cov)


def _along_arclength(
    prior: WhiteNoisePrior, grid: Grid, flat: State, noise_state: State, points: Points, k: Index
) -> Interpolation:
    """Between two nodes of the times `k` (M,)."""
    s = points.along
    nodes = (k * grid.arclength.size + s.lower)[:, None] + np.arange(2)
    start, end = flat.take(nodes[:, 0]), flat.take(nodes[:, 1])
    psd, carried, jump = prior.along_arclength(grid.arclength, s.lower)
    ends = noise_state.strain[k, s.lower], noise_state.strain[k, s.lower + 1]
    rate = interval_strain(*ends, s.step, (psd, jump))
    weight = grid.time_spans[k, None]
    densities = psd / weight, carried / weight, jump / weight
    at, j0, j1, cov = bridged(ARCLENGTH, start, end, s.step, s.offset, rate, densities)
    return Interpolation(at, nodes, np.stack([j0, j1], axis=2), cov)


def _between_times(
    prior: WhiteNoisePrior, grid: Grid, noise_state: State, points: Points, start: State, end: State
) -> tuple[State, Array, Array, Array]:
    """Between two states at the times of nodes: what `bridged` gives."""
    s, t = points.along, points.through
    velocity, later = noise_state.velocity, t.lower + 1
    if points.inside_arclength:
        mean = 0.5 * (velocity[t.lower] + velocity[later])
        rows, share = np.arange(s.lower.size), s.share[:, None]
        rate = (1.0 - share) * mean[rows, s.lower] + share * mean[rows, s.lower + 1]
        span = np.interp(points.arclength, grid.arclength, grid.arclength_spans)[:, None]
    else:
        rate = 0.5 * (velocity[t.lower, s.nearest] + velocity[later, s.nearest])
        span = grid.arclength_spans[s.nearest, None]
    psd, carried, jump = prior.along_time(grid.time[t.lower] + 0.5 * t.step)
    return bridged(TIME, start, end, t.step, t.offset, rate, (psd / span, carried / span, jump))


def chained(outer, inner):
    """Jacobians (M, r, c, d) by c nodes, of slopes (M, r, s) by a state of slopes (M, s, c, d)."""
    return np.einsum("mrs,mscd->mrcd", outer, inner)
