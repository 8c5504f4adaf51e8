"""From readings and prior to one block-tridiagonal system."""

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
from glissando.solver.measurement_factors import MeasurementFactors
from glissando.solver.normal_equations import NormalEquationsBuilder


@dataclass(frozen=True)
class NormalEquations:
    """The problem linearised at `state` and readings `placed`: system · step = right.

    A slab of the system (K, D, D) holds N · dof numbers of the nodes, then E of unknowns. Weights
    come from the state `about`; `terms` are the residuals of every factor, in one order always.
    """

    state: State
    placed: MeasurementFactors
    about: State
    system: BlockTridiagonal
    right: Array
    terms: list[Residuals]

    def cost_of(self, other: NormalEquations) -> float:
        """Cost of another state's residuals under the weights of this one."""
        return sum(
            mine.cost(theirs.residual) for mine, theirs in zip(self.terms, other.terms, strict=True)
        )

    def split(self, step: Array) -> tuple[Array, Array]:
        """A step (K, D) as that of the nodes (K, N, dof) and that of the unknowns (K, E)."""
        k_count, n_count = self.placed.grid.shape
        of_nodes = n_count * self.state.dof
        return step[:, :of_nodes].reshape(k_count, n_count, -1), step[:, of_nodes:]


def linearize(
    prior: Prior,
    placed: MeasurementFactors,
    state: State,
    about: State,
    room: Array,
    held: Sequence[Residuals] | None = None,
) -> NormalEquations:
    """Normal equations of prior and readings at `state`; the system lives in `room`.

    Weights come from the rates of `about` and count as constants; with `held`, the terms of an
    earlier linearisation, they are the very weights used there.

    `room` is an array of `slab_shape(grid, dof, extras)`, to be used again: it is the largest.
    """
    extras = placed.sensor_parameters.size
    sums = NormalEquationsBuilder(placed.grid, state.dof, extras)
    terms: list[Residuals] = []
    for times in placed.blocks:
        for batch in prior.factors(placed.grid, state, about, times):
            batch = _held(batch, None if held is None else held[len(terms)].sqrt_info)
            sums.add(batch)
            terms.append(batch.terms)
    first = len(terms)
    terms += [_room_for(*stream) for stream in placed.streams]
    for i in range(len(placed.blocks)):
        batches = zip(placed.rows(i), placed.factors(prior, state, about, i), strict=True)
        for (stream, rows), batch in batches:
            whole = terms[first + stream]
            batch = _held(batch, None if held is None else held[first + stream].sqrt_info[rows])
            sums.add(batch)
            whole.residual[rows] = batch.terms.residual
            whole.sqrt_info[rows] = batch.terms.sqrt_info
    if extras:
        decay, spread = placed.sensor_parameters.chain()
        off = placed.values - placed.sensor_parameters.mean
        residual = np.concatenate([off[:1], off[1:] - decay * off[:-1]])
        sums.add_chain(decay, spread, residual)
        terms.append(Residuals(residual, (1.0 / spread)[:, :, None] * np.eye(extras)))
    return NormalEquations(state, placed, about, sums.slabs(room), sums.right, terms)


def _held(batch: Factors, sqrt_info: Array | None) -> Factors:
    """The batch with weights held as they were, if they are given."""
    if sqrt_info is None:
        return batch
    return replace(batch, terms=replace(batch.terms, sqrt_info=sqrt_info))


def _room_for(count: int, stream: Readings) -> Residuals:
    """Room for the residuals of a whole stream, in the order of its rows."""
    r = stream.row_count
    return Residuals(np.empty((count, r)), np.empty((count, r, r)), stream.loss)
