"""Prior and readings of static shapes, linearised: a slab per arclength node, shapes uncoupled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from glissando.errors import SensorError, UnobservableError
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Index
from glissando.model.priors.prior import Prior
from glissando.model.priors.static import STATIC_DOF
from glissando.model.state import State
from glissando.solver.block_tridiagonal import BlockTridiagonal, Cholesky, factor
from glissando.solver.damping import RESCUES, saying_why
from glissando.solver.located_readings import LocatedReadings
from glissando.solver.measurement_factors import measurement_factors
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder

_UNDETERMINED = (
    "Prior and readings leave a direction of a shape undetermined. Give the robot a [base], or "
    "every shape a pose, or coils or positions at several places."
)


@dataclass(frozen=True)
class StaticEquations:
    """S shapes of N nodes linearised at a state: system · step = rhs.

    Attributes:
        state: Nodes (S, N).
        system: Slabs (S · N) of 12 unknowns; the last node of a shape and the first of the next
            are not coupled.
        rhs: −Jᵀr (S, N, 12).
        terms: For each batch of factors, the shapes that they belong to and their residuals.
        determined: Whether the prior alone determines every unknown.
    """

    state: State
    system: BlockTridiagonal
    rhs: Array
    terms: list[tuple[Index, Residuals]]
    determined: bool

    def costs(self, other: StaticEquations) -> Array:
        """Costs (S,) of the residuals at another state under the weights of this one."""
        out = np.zeros(len(self.rhs))
        for (owner, own), (_, theirs) in zip(self.terms, other.terms, strict=True):
            norm = np.linalg.norm(own.whiten(theirs.residual), axis=-1)
            cost = 0.5 * norm**2 if own.loss is None else own.loss.cost(norm)
            out += np.bincount(owner, cost, minlength=out.size)
        return out

    @property
    def cholesky(self) -> Cholesky:
        """Cholesky factor of the system, with shapes damped that are singular by rounding.

        Raises:
            UnobservableError: Prior and readings leave a direction of a shape undetermined.
        """
        return self._factored[0]

    @property
    def damped(self) -> NDArray[np.bool_]:
        """Mask (S,) of the shapes that are damped, as they are singular by rounding."""
        return self._factored[1]

    @cached_property
    def _factored(self) -> tuple[Cholesky, NDArray[np.bool_]]:
        with suppress(UnobservableError):
            return factor(self.system), np.zeros(len(self.rhs), dtype=bool)
        added = self._damping()
        damped: NDArray[np.bool_] = np.any(added.reshape(len(self.rhs), -1), axis=1)
        return factor(self.system.add_to_diagonal(added)), damped

    def _damping(self) -> Array:
        """Damping (S · N, 12) to add to the diagonal; zero for shapes that factor without it."""
        count, n_count, size = self.rhs.shape
        added = np.zeros((count * n_count, size))
        for first in range(0, count * n_count, n_count):
            slabs, between = np.s_[first : first + n_count], np.s_[first : first + n_count - 1]
            shape = BlockTridiagonal(self.system.diagonal[slabs], self.system.lower[between])
            scale = np.einsum("nii->ni", shape.diagonal)
            for damping in (0.0, *RESCUES) if self.determined else (0.0,):
                added[slabs] = damping * scale
                with suppress(UnobservableError):
                    factor(shape.add_to_diagonal(added[slabs]))
                    break
            else:
                with saying_why(determined=self.determined):
                    raise UnobservableError(_UNDETERMINED)
        return added


def linearize_static(
    prior: Prior, located: LocatedReadings, state: State, noise: Sequence[Array] = ()
) -> StaticEquations:
    """Linearise prior and readings of every shape at a state, with weights from its strains.

    Args:
        prior: The prior.
        located: Readings on a grid whose times are the numbers of the shapes.
        state: Nodes (S, N) to linearise at.
        noise: Noise to add to the whitened residuals (M, r), for each batch of factors.

    Raises:
        SensorError: A sensor reads a velocity, which static shapes lack, or the whole robot.
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
    return StaticEquations(state, builder.system(), rhs, terms, prior.fixes_base)


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
    yield from located.factor_prior(prior).static_factors(located.grid, state)
    for stream, _, batch in measurement_factors(prior, located, state, state):
        if batch.jacobian[..., STATIC_DOF:].any():
            raise SensorError(
                f"{located.streams[stream].label}: a shape that holds still has no velocity "
                f"to read; leave these readings out."
            )
        yield batch
