"""Prior and readings of static shapes, linearised: one slab an arclength node, shapes apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from glissando.errors import SensorError, UnobservableError
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Index
from glissando.model.priors.prior import Prior
from glissando.model.priors.static import STATIC_DOF
from glissando.model.state import State
from glissando.solver.block_tridiagonal import BlockTridiagonal, Cholesky, factor
from glissando.solver.located_readings import LocatedReadings
from glissando.solver.measurement_factors import measurement_factors
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder


@dataclass(frozen=True)
class StaticEquations:
    """S shapes of N nodes linearised at a state: system · step = rhs.

    Attributes:
        state: Nodes (S, N).
        system: Slabs (S · N) of 12 numbers; the last node of a shape and the first of the next are
            not coupled.
        rhs: −Jᵀr (S, N, 12).
        terms: Residuals of every factor with the shapes that they belong to.
    """

    state: State
    system: BlockTridiagonal
    rhs: Array
    terms: list[tuple[Index, Residuals]]

    def costs(self, other: StaticEquations) -> Array:
        """Costs (S,) of another state's residuals under the weights of this one."""
        out = np.zeros(len(self.rhs))
        for (owner, own), (_, theirs) in zip(self.terms, other.terms, strict=True):
            norm = np.linalg.norm(own.whiten(theirs.residual), axis=-1)
            cost = 0.5 * norm**2 if own.loss is None else own.loss.cost(norm)
            out += np.bincount(owner, cost, minlength=out.size)
        return out

    @cached_property
    def cholesky(self) -> Cholesky:
        """The factor of the system.

        Raises:
            UnobservableError: Prior and readings leave a direction of a shape undetermined.
        """
        try:
            return factor(self.system)
        except UnobservableError:
            raise UnobservableError(
                "Prior and readings leave a direction of a shape undetermined. Give the robot a "
                "[base], or every shape a pose, or coils or positions at several places."
            ) from None


def linearize_static(
    prior: Prior, located: LocatedReadings, state: State, noise: Sequence[Array] = ()
) -> StaticEquations:
    """Prior and readings of every shape at a state, weights from its own strains.

    Args:
        prior: The prior.
        located: Readings on a grid whose times are the numbers of the shapes.
        state: Nodes (S, N) to linearise at.
        noise: What is added to the whitened residuals (M, r) of each batch of factors.

    Raises:
        SensorError: A sensor reads a velocity, which a shape does not have, or the whole robot.
    """
    for readings in located.streams:
        if readings.spans:
            raise SensorError(
                f"{readings.label}: a batch of static shapes has no readings of the whole robot at "
                f"once; use estimate, with a time for each shape."
            )
    n_count = located.grid.arclength.size
    builder = NormalEquationsBuilder.joined(Layout(1, STATIC_DOF), state.strain[..., 0].size)
    terms: list[tuple[Index, Residuals]] = []
    for i, batch in enumerate(static_factors(prior, located, state)):
        if noise:
            batch = _with_noise(batch, noise[i])
        builder.accumulate(batch)
        terms.append((batch.nodes[:, 0] // n_count, batch.terms))
    rhs = builder.rhs_begin.reshape(*state.strain.shape[:2], STATIC_DOF)
    return StaticEquations(state, builder.system(), rhs, terms)


def _with_noise(batch: Factors, white: Array) -> Factors:
    """The batch with noise (M, r) added to its whitened residuals."""
    terms = batch.terms
    added = np.linalg.solve(terms.sqrt_info, white[..., None])[..., 0]
    return replace(batch, terms=replace(terms, residual=terms.residual + added))


def static_factors(prior: Prior, located: LocatedReadings, state: State) -> Iterator[Factors]:
    """Factors of prior and readings of every shape at nodes (S, N), always in the same order.

    Raises:
        SensorError: A sensor reads a velocity.
    """
    yield from prior.static_factors(located.grid, state)
    for stream, _, batch in measurement_factors(prior, located, state, state):
        if batch.jacobian[..., STATIC_DOF:].any():
            raise SensorError(
                f"{located.streams[stream].label}: a shape that holds still has no velocity "
                f"to read; leave these readings out."
            )
        yield batch
