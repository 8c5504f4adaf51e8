"""A batch of factors, linearised: the one form in which everything reaches the solver."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glissando.geometry.se3 import Array
from glissando.model.noise import Loss


@dataclass(frozen=True)
class Residuals:
    """Residuals of M factors of the same kind with the weights to judge them by.

    `residual` (M, r), `sqrt_info` (M, r, r) whitens it, `loss` forgives outliers where given.
    """

    residual: Array
    sqrt_info: Array
    loss: Loss | None = None

    def whiten(self, residual: Array) -> Array:
        """Whitened residual (M, r), robust weights left out."""
        return np.einsum("mij,mj->mi", self.sqrt_info, residual)

    @np.errstate(over="ignore")
    def cost(self, residual: Array) -> float:
        """½ |whitened residual|² summed, or its robust loss, with these weights held fixed.

        A state that a step threw far off costs infinitely much, which refuses the step.
        """
        white = self.whiten(residual)
        if self.loss is None:
            return 0.5 * float(np.sum(white**2))
        return float(np.sum(self.loss.cost(np.linalg.norm(white, axis=-1))))

    def robust_weights(self) -> Array:
        """Weight (M,) of each factor under its loss, 1 where none is given."""
        if self.loss is None:
            return np.ones(self.residual.shape[0])
        return self.loss.weight(np.linalg.norm(self.whiten(self.residual), axis=-1))

    def log_det_cov(self) -> float:
        """Sum of the log-determinants of the factors' covariances."""
        diagonal = np.einsum("mii->mi", self.sqrt_info)
        return -2.0 * float(np.sum(np.log(diagonal)))


@dataclass(frozen=True)
class Factors:
    """M factors of the same kind, linearised at one state.

    On a grid a node is its index k·N + n. `nodes` (M, c) are the nodes a factor touches, in the
    same pattern for all, `dofs` the d components of those nodes it depends on, `jacobian`
    (M, r, c, d) of the residual. `extras` (M, r, 2 E), where given, is the Jacobian with respect to
    E numbers that belong to no node, at the time node at or before the factor and at the next.
    """

    nodes: NDArray[np.intp]
    dofs: slice
    jacobian: Array
    terms: Residuals
    extras: Array | None = None

    def take(self, rows: NDArray[np.bool_]) -> Factors:
        """Those of the factors."""
        terms = replace(
            self.terms, residual=self.terms.residual[rows], sqrt_info=self.terms.sqrt_info[rows]
        )
        extras = None if self.extras is None else self.extras[rows]
        return Factors(self.nodes[rows], self.dofs, self.jacobian[rows], terms, extras)

    def whitened(self) -> tuple[Array, Array]:
        """Residual (M, r) and Jacobian (M, r, c·d + 2 E), whitened, robust weights left out."""
        m, r, c, d = self.jacobian.shape
        residual = self.terms.whiten(self.terms.residual)
        jacobian = self.jacobian.reshape(m, r, c * d)
        if self.extras is not None:
            jacobian = np.concatenate([jacobian, self.extras], axis=-1)
        return residual, self.terms.sqrt_info @ jacobian
