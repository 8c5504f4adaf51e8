"""Prior and readings of single moments, linearised as chains along arclength."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glissando.errors import SensorError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid, Index
from glissando.model.noise import pair_sqrt_information
from glissando.model.priors.prior import by_interval, interval_strain
from glissando.model.priors.separable import SeparablePrior
from glissando.model.priors.steps import ARCLENGTH, pair_error
from glissando.model.priors.transitions import process_covariances
from glissando.model.priors.white_noise import WhiteNoisePrior
from glissando.model.state import State
from glissando.solver.measurement_factors import MeasurementFactors
from glissando.solver.normal_equations import NormalEquationsBuilder
from glissando.twins import twin

StaticPrior = WhiteNoisePrior | SeparablePrior
"""A prior that says what shapes are at a single moment."""

STILL = 12
"""Numbers of a node that holds still: pose and strain."""
_DOFS = slice(0, STILL)


@dataclass(frozen=True)
class StaticEquations:
    """S moments linearised at `state` (S, N): a chain each, system · step = right.

    `diagonal` (S, N, 12, 12), `lower` (S, N−1, 12, 12) and `right` (S, N, 12); `terms` are the
    residuals of every factor with the moments that they belong to.
    """

    state: State
    diagonal: Array
    lower: Array
    right: Array
    terms: list[tuple[Index, Residuals]]

    def costs(self, other: StaticEquations) -> Array:
        """Costs (S,) of another state's residuals under the weights of this one."""
        out = np.zeros(len(self.right))
        for (owner, mine), (_, theirs) in zip(self.terms, other.terms, strict=True):
            norm = np.linalg.norm(mine.whiten(theirs.residual), axis=-1)
            cost = 0.5 * norm**2 if mine.loss is None else mine.loss.cost(norm)
            out += np.bincount(owner, cost, minlength=out.size)
        return out


def linearize_static(
    prior: StaticPrior, placed: MeasurementFactors, state: State
) -> StaticEquations:
    """Prior and readings of every moment of the grid at `state`, weights from its own rates.

    Raises SensorError for readings of a velocity, which a moment does not have.
    """
    grid = placed.grid
    sums = NormalEquationsBuilder(grid, STILL)
    terms: list[tuple[Index, Residuals]] = []
    for batch in _all_factors(prior, placed, state):
        sums.add(batch)
        terms.append((batch.nodes[:, 0] // grid.arclength.size, batch.terms))
    return StaticEquations(state, *sums.chains(), terms)


def _all_factors(prior: StaticPrior, placed: MeasurementFactors, state: State) -> Iterator[Factors]:
    yield from static_prior_factors(prior, placed.grid, state)
    for block in range(len(placed.blocks)):
        batches = placed.factors(prior, state, state, block)
        for (stream, _), batch in zip(placed.rows(block), batches, strict=True):
            if batch.dofs.stop > STILL:
                raise SensorError(
                    f"{placed.streams[stream][1].label}: a shape that holds still has no velocity "
                    f"to read; leave these readings out."
                )
            yield batch


def static_prior_factors(prior: StaticPrior, grid: Grid, state: State) -> Iterator[Factors]:
    """What a prior says of pose and strain at single moments: intervals, then the base.

    Source: equations (2') and (5).
    """
    k_count, n_count = grid.shape
    node = np.arange(k_count * n_count).reshape(k_count, n_count)
    if n_count > 1:
        nodes = np.stack([node[:, :-1].ravel(), node[:, 1:].ravel()], axis=1)
        spread = by_interval(grid.arclength, prior.psd_strain_arclength, prior.joints, prior.jumps)
        psd, jump = (np.tile(values, (k_count, 1)) for values in spread)
        step = np.tile(np.diff(grid.arclength), k_count)
        error, jacobian, info = static_steps(state.flatten(), nodes, step, psd, jump)
        error = error - np.tile(prior.rest.interval_errors(grid.arclength), (k_count, 1))
        yield Factors(nodes, _DOFS, jacobian, Residuals(error, info))
    if prior.base is not None:
        base = state.take(np.s_[:, 0])
        xi = se3.log(se3.inverse(prior.base_pose) @ base.pose)
        error = np.concatenate([xi, base.strain - prior.rest.at(np.zeros(1))], axis=-1)
        jacobian = np.zeros((k_count, STILL, 1, STILL))
        jacobian[:, :6, 0, :6] = se3.right_jacobian_inverse(xi)
        jacobian[:, 6:, 0, 6:] = np.eye(6)
        firm = np.diag(np.concatenate([prior.base.pose, prior.base.strain]) ** -0.5)
        info = np.broadcast_to(firm, (k_count, STILL, STILL))
        yield Factors(node[:, :1], _DOFS, jacobian, Residuals(error, info))


@twin
def static_steps(
    flat: State, nodes: Index, step: Array, psd: Array, jump: Array
) -> tuple[Array, Array, Array]:
    """Errors (M, 12) of steps between `nodes` (M, 2) of a list of states that hold still.

    With Jacobian (M, 12, 2, 12) and whitener (M, 12, 12). Source: equation (2').
    """
    start, end = flat.take(nodes[:, 0]), flat.take(nodes[:, 1])
    error, j0, j1 = pair_error(ARCLENGTH, start, end, step)
    rate = interval_strain(start.strain, end.strain, step, (psd, jump))
    cov, _ = process_covariances(rate, step, psd, psd, rigid=False, jump=jump)
    jacobian = np.stack([j0[..., _DOFS], j1[..., _DOFS]], axis=2)
    return error, jacobian, pair_sqrt_information(cov)


def chosen(where: NDArray[np.bool_], one: State, other: State) -> State:
    """The state that is `one` in the moments `where` (S,) says so, and `other` in the rest."""
    pairs = zip(one.fields(), other.fields(), strict=True)
    return State(*(np.where(where.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in pairs))
