"""Linearisation of prior and readings at a state, summed into normal equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.priors.prior import Prior
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.block_tridiagonal import BlockTridiagonal
from glissando.solver.located_readings import LocatedReadings
from glissando.solver.measurement_factors import measurement_factors
from glissando.solver.normal_equations import Gradient, Layout, NormalEquationsBuilder


@dataclass(frozen=True)
class NormalEquations:
    """The problem linearised at a state: system · step = rhs. Source: equation (19).

    Attributes:
        state: Nodes (K, N) at which it is linearised.
        located: Readings, located with the sensor parameters.
        noise_state: Nodes (K, N) from which the weights are computed.
        system: JᵀJ; the D unknowns of a slab are N · dof of the nodes, then E sensor parameters.
        rhs: −Jᵀr (K, D).
        terms: Residuals of every factor, always in the same order.
    """

    state: State
    located: LocatedReadings
    noise_state: State
    system: BlockTridiagonal
    rhs: Array
    terms: list[Residuals]

    def cost_of(self, other: NormalEquations) -> float:
        """Cost of the residuals at another state under the weights of this one."""
        return sum(
            own.cost(theirs.residual) for own, theirs in zip(self.terms, other.terms, strict=True)
        )

    @property
    def log_det_noise(self) -> float:
        """Log determinant of the covariance of all residuals."""
        return sum(terms.log_det_cov() for terms in self.terms)

    def reading_terms(self) -> list[Residuals]:
        """Residuals of the readings alone, those of each stream in the order of its rows."""
        streams, extra = len(self.located.streams), self.located.parameters.process.size > 0
        end = len(self.terms) - extra
        return self.terms[end - streams : end]

    def prior_terms(self) -> list[Residuals]:
        """Residuals of the prior of the states."""
        extra = self.located.parameters.process.size > 0
        return self.terms[: len(self.terms) - extra - len(self.located.streams)]

    @property
    def scale(self) -> Array:
        """Scale (K, D) of the damping: the system's diagonal without the drift of parameters.

        A sensor parameter that hardly drifts is coupled so strongly between time nodes that any
        damping relative to the whole diagonal would stop it. Its drift is left out, as such a
        parameter moves by the same step at all times.
        """
        scale = np.einsum("kii->ki", self.system.diagonal).copy()
        process = self.located.parameters.process
        if process.size:
            decay = process.drift(self.located.parameters.values)[0]
            tied = np.einsum("kee->ke", self.terms[-1].sqrt_info) ** 2
            own = scale[:, -process.size :]
            own -= tied
            own[:-1] -= decay**2 * tied[1:]
            np.maximum(own, process.std**-2.0 / len(own), out=own)
        return scale

    def split(self, step: Array) -> tuple[Array, Array]:
        """Split a step (K, D) into those of the nodes (K, N, dof) and of the parameters (K, E)."""
        k_count, n_count = self.located.grid.shape
        of_nodes = n_count * self.state.dof
        return step[:, :of_nodes].reshape(k_count, n_count, -1), step[:, of_nodes:]


def linearize(
    prior: Prior,
    located: LocatedReadings,
    state: State,
    noise_state: State,
    workspace: Array | None = None,
    fixed_weights: Sequence[Residuals] | None = None,
) -> NormalEquations:
    """Normal equations of prior and readings at a state.

    Args:
        prior: The prior.
        located: The readings.
        state: Nodes (K, N) to linearise at.
        noise_state: Nodes (K, N) from whose rates the weights are computed, as constants.
        workspace: Memory of `system_shape` for the system, the largest array, which is
            overwritten; allocated if None.
        fixed_weights: Terms of an earlier linearisation whose weights are used unchanged.
    """
    layout = layout_of(located, state)
    builder = NormalEquationsBuilder.joined(layout, located.grid.time.size, workspace)
    terms = _accumulate(builder, prior, located, (state, noise_state), fixed_weights)
    return NormalEquations(state, located, noise_state, builder.system(), builder.rhs_begin, terms)


def gradient(
    prior: Prior,
    located: LocatedReadings,
    state: State,
    noise_state: State,
    fixed_weights: Sequence[Residuals] | None = None,
) -> Array:
    """Right-hand side −Jᵀr (K, D) of `linearize`, without the system."""
    sums = Gradient(layout_of(located, state), located.grid.time.size)
    _accumulate(sums, prior, located, (state, noise_state), fixed_weights)
    return sums.rhs


def layout_of(located: LocatedReadings, state: State) -> Layout:
    """Layout of the unknowns of a slab: those of its nodes, then sensor parameters."""
    return Layout(located.grid.arclength.size, state.dof, located.parameters.process.size)


def _accumulate(
    builder: NormalEquationsBuilder | Gradient,
    prior: Prior,
    located: LocatedReadings,
    states: tuple[State, State],
    fixed_weights: Sequence[Residuals] | None,
) -> list[Residuals]:
    """Sum all factors at the first state, weights from the second; return the residuals."""
    grid, terms = located.grid, list[Residuals]()
    prior = located.factor_prior(prior)
    for times in located.blocks:
        for batch in prior.factors(grid, *states, times):
            whiteners = None if fixed_weights is None else fixed_weights[len(terms)].sqrt_info
            batch = _with_weights(batch, whiteners)
            builder.accumulate(batch)
            terms.append(batch.terms)
    first = len(terms)
    terms += [_empty_terms(stream) for stream in located.streams]
    for stream, rows, batch in measurement_factors(prior, located, *states):
        fixed = None if fixed_weights is None else fixed_weights[first + stream]
        batch = _with_weights(batch, None if fixed is None else fixed.sqrt_info[rows])
        builder.accumulate(batch)
        terms[first + stream].residual[rows] = batch.terms.residual
        terms[first + stream].sqrt_info[rows] = batch.terms.sqrt_info
    if size := located.parameters.process.size:
        decay, std, residual = located.parameters.process.drift(located.parameters.values)
        if fixed_weights is not None:
            std = 1.0 / np.einsum("kee->ke", fixed_weights[-1].sqrt_info)
        builder.accumulate_drift(decay, std, residual)
        terms.append(Residuals(residual, (1.0 / std)[:, :, None] * np.eye(size)))
    return terms


def _with_weights(batch: Factors, sqrt_info: Array | None) -> Factors:
    """The batch, with these whiteners if given."""
    if sqrt_info is None:
        return batch
    return replace(batch, terms=replace(batch.terms, sqrt_info=sqrt_info))


def _empty_terms(stream: Readings) -> Residuals:
    """Memory for the residuals of a whole stream, in the order of its rows."""
    count, r = len(stream), stream.row_count
    return Residuals(np.empty((count, r)), np.empty((count, r, r)), stream.loss)
