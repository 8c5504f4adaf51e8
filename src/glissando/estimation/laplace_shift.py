"""Shift of the estimate of a rod under loads from the mode of its posterior to the mean.

Many loads explain the same readings, and how many depends on the force along the rod: the more
readily the rod bends at that force, the more closely the readings determine its loads. The mode is
where a single motion is likeliest and neglects how many others lie beside it, so that it prefers a
rod that bends readily, by standard deviations where loads are comparable with those that buckle the
rod. Laplace's approximation has the volume of these motions in half the log-determinant of the
information. Source: equation (37).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.errors import UnobservableError
from glissando.estimation.log_det_slope import log_det_slope
from glissando.estimation.posterior import Posterior
from glissando.estimation.transported import transported
from glissando.geometry.se3 import Array
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.solver.block_tridiagonal import BlockTridiagonal, Cholesky, Marginals, factor
from glissando.solver.linearize import NormalEquations, linearize
from glissando.solver.located_readings import LocatedReadings, locate
from glissando.solver.normal_equations import system_shape

_NEGLIGIBLE = 0.2  # standard deviations: shift below which the mode is the mean
_MOST = 2.0  # largest ratio of loads to those expected for which the shift grows with them
_SHRINKING = 0.5  # largest ratio of the second step to the first


def at_mean(posterior: Posterior, located: LocatedReadings) -> Posterior:
    """Posterior about its mean, linearised there, of one about its mode.

    Posteriors of other priors than the mechanical one, of rods with inertia, and those whose mode
    and mean differ negligibly are returned unchanged.

    Args:
        posterior: Posterior about the mode.
        located: Its readings, with the estimated sensor parameters.
    """
    prior = posterior.prior
    if not isinstance(prior, MechanicalPrior) or prior.inertia is not None:
        return posterior
    if not posterior.solve.converged or posterior.grid.arclength.size < 2:
        return posterior
    try:
        with one_thread():
            return _shifted(prior, posterior, located)
    except (np.linalg.LinAlgError, UnobservableError):  # the prior alone cannot be factored
        return posterior


def _shifted(prior: MechanicalPrior, posterior: Posterior, located: LocatedReadings) -> Posterior:
    """Posterior about its mean: a Newton step of (37), and another that makes up for its length."""
    workspace = np.empty(system_shape(*posterior.system.diagonal.shape[:2]))
    here = linearize(prior, located, posterior.state, posterior.state, workspace)
    cholesky = factor(here.system)
    slope, std = _volume_slope(prior, here, cholesky)
    cholesky = factor(here.system, cholesky)
    if np.all(np.abs(cholesky.solve(slope)) <= _NEGLIGIBLE * std):
        return posterior
    first = cholesky.solve(here.rhs - slope)
    here = _after(prior, here, first, workspace)
    cholesky = factor(here.system, cholesky)
    second = cholesky.solve(here.rhs - slope)
    if not np.max(np.abs(second) / std) < _SHRINKING * np.max(np.abs(first) / std):
        return posterior  # (37) holds near the mode only
    of_nodes, of_parameters = here.split(second)
    state = here.state.retract(of_nodes)
    return replace(
        posterior,
        state=state,
        system=here.system,
        marginals=transported(here.state, state, cholesky.marginals(consume=True)),
        sensor_parameters=here.located.moved(of_parameters).parameters.by_name(),
        linearized=(here.state, here.noise_state),
    )


def _after(
    prior: MechanicalPrior, here: NormalEquations, step: Array, workspace: Array
) -> NormalEquations:
    """Normal equations after a step (K, D), in the memory of those before."""
    of_nodes, of_parameters = here.split(step)
    state = here.state.retract(of_nodes)
    return linearize(prior, here.located.moved(of_parameters), state, state, workspace)


def _volume_slope(
    prior: MechanicalPrior, here: NormalEquations, cholesky: Cholesky
) -> tuple[Array, Array]:
    """Slope (K, D) of the volume that is added to that of the cost, and deviations (K, D).

    The factor of the normal equations is overwritten.
    """
    grid, state = here.located.grid, here.state
    alone = linearize(prior, locate(grid, []), state, state)  # where the other is, as both cancel
    spread = cholesky.marginals(consume=True)
    std = np.sqrt(np.einsum("kii->ki", spread.cov))
    size = state.numbers
    of_nodes = Marginals(spread.cov[:, :size, :size], spread.cross[:, :size, :size])
    determined = len(std) * size - _trace(alone.system, of_nodes)
    added = factor(alone.system).marginals(consume=True)  # that of the prior, as yet
    for own, before in ((of_nodes.cov, added.cov), (of_nodes.cross, added.cross)):
        np.subtract(own, before, out=before)
    slope = np.zeros_like(std)
    slope[:, :size] = log_det_slope(prior, grid, state, added).reshape(len(std), -1)
    loads = 2.0 * sum(terms.cost(terms.residual) for terms in here.prior_terms())
    return slope * min(loads / max(determined, 1.0), _MOST), std


def _trace(system: BlockTridiagonal, inverse: Marginals) -> float:
    """Trace of the product of a block-tridiagonal matrix with a matrix of these blocks."""
    beside = np.vdot(system.lower, inverse.cross.mT)
    return float(np.vdot(system.diagonal, inverse.cov) + 2.0 * beside)
