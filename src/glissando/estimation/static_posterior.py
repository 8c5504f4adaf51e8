"""Posterior of static shapes: pose, strain and wrenches at any arclength of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glissando.errors import OutsideGridError
from glissando.estimation.loads import (
    WrenchEstimate,
    internal_wrench,
    point_loads,
    require_mechanics,
)
from glissando.estimation.state_estimate import StateEstimate, state_at
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index, points_of
from glissando.model.priors.prior import Prior
from glissando.model.priors.static import STATIC_DOF
from glissando.model.priors.transitions import symmetrize
from glissando.model.short_repr import ShortRepr
from glissando.model.state import DOF, State
from glissando.solver.outcome import Outcome

_DOFS = slice(0, STATIC_DOF)


@dataclass(frozen=True)
class StaticPosterior(ShortRepr):
    """Posterior of S static shapes: pose and strain at any arclength.

    Attributes:
        prior: The prior of the shapes.
        grid: Arclength nodes (N,); its times are the shapes' numbers.
        state: Mean (S, N) at the nodes.
        cov: Covariances (S, N, 12, 12) of nodes.
        cross: Covariances (S, N−1, 12, 12) of neighbouring nodes.
        outcomes: Outcome of the solver for each shape.
        refused: Rows of each stream that were not used, as the other readings refute them.
        others: Probability of shapes far from the estimate, by the number of the shape; shapes
            without such others are not listed.
    """

    prior: Prior
    grid: Grid
    state: State
    cov: Array
    cross: Array
    outcomes: tuple[Outcome, ...]
    refused: Mapping[str, list[int]] = field(default_factory=dict)
    others: Mapping[int, float] = field(default_factory=dict)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Mask (S,) of the shapes that converged."""
        return np.array([outcome.sound for outcome in self.outcomes])

    def at(self, arclength: ArrayLike, shape: ArrayLike) -> StateEstimate:
        """State with covariance at points; velocity and its covariance are zero.

        Args:
            arclength: Metres; broadcast with `shape`.
            shape: Numbers of shapes.

        Raises:
            OutsideGridError: A point is off the grid.
        """
        s, k = self._queried(arclength, shape)
        return state_at(self.prior, self.grid, self.state, self._spread_of_states, s, k)

    def wrench(
        self, arclength: ArrayLike, shape: ArrayLike, *, frame: str = "body"
    ) -> WrenchEstimate:
        """Internal wrench at points of shapes, see `Posterior.wrench`."""
        prior = require_mechanics(self.prior, frame)
        return internal_wrench(prior, arclength, self.at(arclength, shape), frame)

    def load(
        self, arclength: ArrayLike, shape: ArrayLike, *, frame: str = "body"
    ) -> WrenchEstimate:
        """External wrench at the tip or at one of the prior's `points`, see `Posterior.load`."""
        s, k = self._queried(arclength, shape)
        which = k.astype(np.intp)
        return point_loads(self.prior, self.grid, self.state, self._spread, s, which, frame)

    def _queried(self, arclength: ArrayLike, shape: ArrayLike) -> tuple[Array, Array]:
        """Arclengths and shape numbers of a query, broadcast and checked to be on the grid."""
        s, k = points_of(arclength, shape)
        require_whole(k.ravel(), "Query", self.grid.time.size)
        self.grid.require(s.ravel(), k.ravel(), "Query")
        return s, k

    def _spread_of_states(self, nodes: Index, slopes: Array, left: Array) -> Array:
        """Covariance (M, 18, 18) of states, with that of velocity zero."""
        cov = np.zeros((len(nodes), DOF, DOF))
        cov[:, _DOFS, _DOFS] = self._spread(nodes, slopes[:, _DOFS], left[:, _DOFS, _DOFS])
        return cov

    def _spread(self, nodes: Index, slopes: Array, left: Array) -> Array:
        """Covariance (M, r, r) from Jacobians (M, r, c, ·) by one node or two neighbours (M, c)."""
        k, n = np.divmod(nodes[:, 0], self.grid.arclength.size)
        own = slopes[..., :STATIC_DOF].reshape(*slopes.shape[:2], -1)
        joint = self.cov[k, n]
        if nodes.shape[1] == 2:
            cross = self.cross[k, n]
            back = np.swapaxes(cross, -1, -2)
            joint = np.block([[joint, cross], [back, self.cov[k, n + 1]]])
        return symmetrize(own @ joint @ np.swapaxes(own, -1, -2) + left)


def require_whole(number: Array, what: str, count: int | None = None) -> None:
    """Raise OutsideGridError unless all shape numbers are whole, at least 0 and below `count`."""
    wrong = np.flatnonzero((number != np.round(number)) | (number < 0.0))
    if wrong.size:
        raise OutsideGridError(
            f"{what}: row {wrong[0]} is of shape {number[wrong[0]]:g}; shapes are numbered 0, 1, "
            f"2, … in place of times."
        )
    if count is not None and np.any(beyond := number >= count):
        raise OutsideGridError(
            f"{what}: row {np.flatnonzero(beyond)[0]} is of shape {number[beyond][0]:g}; there are "
            f"{count}, numbered from 0."
        )
