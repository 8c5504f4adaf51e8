"""A force that may act at a place at any time: what the readings of a posterior say of it.

A force on a node makes the error of the interval that ends there larger, at every time. With this
prior in the place of the one that a posterior has, its linear system is solved again. Source: (29).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.estimation.loads import require_mechanics
from glissando.estimation.posterior import Posterior
from glissando.estimation.transported import transported
from glissando.geometry.se3 import Array
from glissando.model.grid import SAME, Index
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.solver.block_tridiagonal import BlockTridiagonal, factor
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate

_OWN = 2.0  # time scales that a window has to last, for its own readings to outweigh those before
_System = tuple[Array, Array, Array]  # diagonal, lower, and right side


def nearest_nodes(arclength: Array, places: Array) -> Index:
    """Numbers (C,) of the nodes (N,), but the base's, that are nearest to places (C,)."""
    return 1 + np.abs(arclength[1:] - places[:, None]).argmin(axis=1)


def knows_forces(posterior: Posterior) -> bool:
    """Whether the readings of a posterior alone say what force acts at its end.

    What came before its first time was summed up as if nothing touched the robot, which lasts as
    loads do; and the modes of a rod with inertia depend on where forces act.
    """
    prior, grid = require_mechanics(posterior.prior), posterior.grid
    lasts = float(grid.time[-1] - grid.time[0])
    return prior.inertia is None and (grid.before is None or lasts >= _OWN * prior.time_scale)


def with_force(posterior: Posterior, node: int, variance: Array) -> Posterior:
    """The posterior if a force may act on a node, or half an interval beside it, at any time.

    It lasts as the prior's loads do. The posterior is linear about where its own was linearised.

    Args:
        posterior: A posterior of a mechanical prior, which knows where it was linearised.
        node: Number of the arclength node, not the base's.
        variance: Prior variance (3,) of the force, N².
    """
    before = require_mechanics(posterior.prior)
    prior = _with_point(before, posterior.grid.arclength, node, variance)
    diagonal, lower, rhs = _system_of(posterior)
    own, other = (_prior_alone(posterior, each) for each in (before, prior))
    count = own[2].shape[1]
    diagonal[:, :count, :count] += other[0] - own[0]
    lower[:, :count, :count] += other[1] - own[1]
    rhs[:, :count] += other[2] - own[2]
    system = BlockTridiagonal(diagonal, lower)
    cholesky = factor(system)
    start = posterior.linearization_point
    step = cholesky.solve(rhs)[:, :count].reshape(*start.pose.shape[:2], start.dof)
    state = start.retract(step)
    marginals = transported(start, state, cholesky.marginals())  # (35)
    return replace(posterior, prior=prior, state=state, system=system, marginals=marginals)


def force_at(posterior: Posterior, node: int, variance: Array, rows: Index) -> tuple[Array, Array]:
    """Forces (K, 3) that act on a node at time nodes `rows` (K,), world frame, and covariances.

    Args:
        posterior: As of `with_force`.
        node: Number of the arclength node, not the base's.
        variance: Prior variance (3,) of the force, N².
        rows: Numbers of the time nodes.
    """
    grid = posterior.grid
    touched = with_force(posterior, node, variance)
    load = touched.load(grid.arclength[node], grid.time[rows], frame="world")
    return load.force, load.cov[..., :3, :3]


def _with_point(
    prior: MechanicalPrior, arclength: Array, node: int, variance: Array
) -> MechanicalPrior:
    """The prior with a load of this variance on a node, besides what is expected there."""
    lever = 0.5 * float(np.diff(arclength)[node - 1 : node + 1].max())
    more = np.concatenate([variance, np.full(3, lever**2 * variance.max())])
    place = float(arclength[node])
    if node == arclength.size - 1:
        return replace(prior, var_tip=prior.var_tip + more)
    points, var_points = prior.points, prior.var_points
    known = np.abs(points - place) < SAME
    if known.any():
        return replace(prior, var_points=var_points + known[:, None] * more)
    at = int(np.searchsorted(points, place))
    return replace(
        prior,
        points=np.insert(points, at, place),
        var_points=np.insert(var_points, at, more, axis=0),
    )


def _system_of(posterior: Posterior) -> _System:
    """A posterior's system about where it was linearised, to be changed."""
    system, start = posterior.system, posterior.linearization_point
    count = posterior.grid.time.size
    step = np.zeros(system.diagonal.shape[:2])
    step[:, : start.numbers] = posterior.state.difference(start).reshape(count, -1)
    rhs = np.einsum("kij,kj->ki", system.diagonal, step)
    rhs[1:] += np.einsum("kij,kj->ki", system.lower, step[:-1])
    rhs[:-1] += np.einsum("kji,kj->ki", system.lower, step[1:])
    return system.diagonal.copy(), system.lower.copy(), rhs


def _prior_alone(posterior: Posterior, prior: MechanicalPrior) -> _System:
    """The system of a prior alone where a posterior was linearised."""
    states = posterior.linearized or (posterior.state, posterior.state)
    alone = linearize(prior, locate(posterior.grid, []), *states)
    return alone.system.diagonal, alone.system.lower, alone.rhs
