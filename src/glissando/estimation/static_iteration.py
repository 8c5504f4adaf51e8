"""Gauss–Newton iteration of many static shapes together. Source: equations (2'), (20), (21)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from glissando.estimation.misfit import implausible
from glissando.estimation.transported import has_rolled
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.priors.static import STATIC_DOF
from glissando.model.state import State
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.located_readings import LocatedReadings
from glissando.solver.static_equations import StaticEquations, linearize_static
from glissando.solver.step_search import ROUNDING, WORTHWHILE

_DOFS = slice(0, STATIC_DOF)
_SHARES = (1.0, 0.3, 0.1)  # parts of a bent step, tried in turn
_MOST = 2.0 * np.pi  # rad between nodes, beyond which readings there may have no weights

Solved = tuple[State, tuple[Array, Array], NDArray[np.bool_]]
"""States (S, N), covariances of nodes and of neighbours, and the mask of shapes not solved."""


def iterate(
    prior: Prior,
    located: LocatedReadings,
    start: State,
    options: SolverOptions,
    noise: Sequence[Array] = (),
) -> Solved:
    """Iterate Gauss–Newton steps of all shapes, straight or bent.

    A shape whose cost neither kind of step lowers is reset to rest and marked as not solved, for a
    solver that damps steps and tries other starts. Shapes with an implausible cost, or a system
    that is singular by rounding at the end, are marked as well.

    Args:
        prior: The prior.
        located: Readings on a grid whose times are the numbers of the shapes.
        start: Shapes (S, N) to start from.
        options: Stopping criteria.
        noise: Noise to add to whitened residuals, see `linearize_static`.

    Raises:
        UnobservableError: Prior and readings leave a direction of a shape undetermined (or numpy's
            LinAlgError: a shape is too far off for weights to exist).
    """
    grid = located.grid
    here = linearize_static(prior, located, _limited(grid, start, prior.rest_state(grid)), noise)
    active, unsolved = np.ones(len(here.rhs), dtype=bool), np.zeros(len(here.rhs), dtype=bool)
    for _ in range(options.max_iterations):
        solved = here.cholesky.solve(here.rhs.reshape(-1, STATIC_DOF)).reshape(here.rhs.shape)
        step = np.zeros((*grid.shape, start.dof))
        step[..., _DOFS] = solved * active[:, None, None]
        predicted = np.sum(step[..., _DOFS] * here.rhs, axis=(1, 2))
        last = active & (np.sqrt(np.maximum(predicted, 0.0)) < options.tolerance)
        active &= ~last
        straight = here.state.retract(step)
        if not np.any(active):
            break
        stepped = linearize_static(prior, located, _limited(grid, straight, here.state), noise)
        refused = active & ~_worthwhile(here, stepped, predicted)
        for share in _SHARES:
            if not np.any(refused):
                break
            bent = _limited(grid, prior.retract_strains(grid, here.state, share * step), here.state)
            stepped = linearize_static(prior, located, _select(refused, bent, stepped.state), noise)
            refused &= ~_worthwhile(here, stepped, share * predicted)
        if np.any(refused):
            unsolved, active = unsolved | refused, active & ~refused
            state = _select(refused, prior.rest_state(grid), stepped.state)
            stepped = linearize_static(prior, located, state, noise)
        here = stepped
    unsolved |= active | here.damped | implausible(prior, here.costs(here), _numbers_read(located))
    end = here.state if np.any(active) else straight
    return end, node_covariances(here, end), unsolved


def _numbers_read(located: LocatedReadings) -> NDArray[np.intp]:
    """Number of scalar readings of each shape (S,)."""
    out = np.zeros(located.grid.time.size, dtype=np.intp)
    for r in located.streams:
        out += r.row_count * np.bincount(r.time.astype(np.intp), minlength=out.size)
    return out


def node_covariances(here: StaticEquations, end: State) -> tuple[Array, Array]:
    """Covariances of nodes (S, N, 12, 12), and of neighbours (S, N−1, 12, 12).

    Args:
        here: Linearised shapes, whose factor is overwritten.
        end: States after the last step, in whose axes the covariances are.
    """
    marginals, (count, n_count) = here.cholesky.marginals(consume=True), here.rhs.shape[:2]
    cov = marginals.cov.reshape(count, n_count, STATIC_DOF, STATIC_DOF)
    cross = np.concatenate([marginals.cross, np.zeros((1, STATIC_DOF, STATIC_DOF))])
    cross = cross.reshape(cov.shape)[:, :-1].copy()
    if not has_rolled(here.state, end):
        return cov, cross
    slopes = here.state.slope_to(end)[..., _DOFS, _DOFS]  # (35)
    turned = slopes.swapaxes(-1, -2)
    return slopes @ cov @ turned, slopes[:, :-1] @ cross @ turned[:, 1:]


def _worthwhile(
    here: StaticEquations, stepped: StaticEquations, predicted: Array
) -> NDArray[np.bool_]:
    """Mask (S,) of costs that fell by a share of `predicted` / 2, or can fall only by rounding."""
    cost = here.costs(here)
    gain = cost - here.costs(stepped)
    nothing = 0.5 * predicted < ROUNDING * (1.0 + cost)
    return nothing | (gain > WORTHWHILE * 0.5 * predicted)


def _limited(grid: Grid, state: State, before: State) -> State:
    """The shapes (S, N), with those that turn too far between two nodes replaced by `before`."""
    widest = np.max(np.diff(grid.arclength), initial=0.0)
    turn = widest * np.max(np.linalg.norm(state.strain[..., 3:], axis=-1), axis=1)
    return _select(~(turn < _MOST), before, state)  # also if it is NaN


def _select(where: NDArray[np.bool_], one: State, other: State) -> State:
    """State with `one` in the shapes of the mask `where` (S,), and `other` in the rest."""
    pairs = zip(one.fields(), other.fields(), strict=True)
    return State(*(np.where(where.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in pairs))
