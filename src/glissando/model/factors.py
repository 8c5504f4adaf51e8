"""Batches of linearised factors, the form in which priors and readings reach the solver."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glissando.geometry.se3 import Array
from glissando.model.noise import Loss


@dataclass(frozen=True)
class Residuals:
    """Residuals of M factors of the same kind, with square-root information and robust loss.

    `residual` (M, r); `sqrt_info` (M, r, r) whitens it; `loss` is None for least squares.
    """

    residual: Array
    sqrt_info: Array
    loss: Loss | None = None

    def whiten(self, residual: Array) -> Array:
        """Whitened residual (M, r), without robust weights."""
        return np.einsum("mij,mj->mi", self.sqrt_info, residual)

    @np.errstate(over="ignore")
    def cost(self, residual: Array) -> float:
        """Sum of ½ |whitened residual|², or of its robust loss, at fixed `sqrt_info`.

        A residual (M, r) whose square overflows costs infinity, so that its step is rejected.
        """
        white = self.whiten(residual)
        if self.loss is None:
            return 0.5 * float(np.sum(white**2))
        return float(np.sum(self.loss.cost(np.linalg.norm(white, axis=-1))))

    def robust_weights(self) -> Array:
        """Weights (M,) of the factors under their robust loss; 1 without a loss."""
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

    On a grid a node is its index k·N + n. `nodes` (M, c) are the nodes on which a factor depends,
    in the same pattern for all; `dofs` are the d components of these nodes on which it depends;
    `jacobian` (M, r, c, d) is that of the residual. `extras` (M, r, 2 E), or None, is the Jacobian
    by E parameters that belong to no node, at the time node at or before the factor and the next.
    """

    nodes: NDArray[np.intp]
    dofs: slice
    jacobian: Array
    terms: Residuals
    extras: Array | None = None

    def take(self, rows: NDArray[np.bool_]) -> Factors:
        """Factors of the rows (M,) that a mask selects."""
        terms = replace(
            self.terms, residual=self.terms.residual[rows], sqrt_info=self.terms.sqrt_info[rows]
        )
        extras = None if self.extras is None else self.extras[rows]
        return Factors(self.nodes[rows], self.dofs, self.jacobian[rows], terms, extras)

    def whitened(self) -> tuple[Array, Array]:
        """Residual (M, r) and Jacobian (M, r, c·d + 2 E), without robust weights."""
        m, r, c, d = self.jacobian.shape
        residual = self.terms.whiten(self.terms.residual)
        jacobian = self.jacobian.reshape(m, r, c * d)
        if self.extras is not None:
            jacobian = np.concatenate([jacobian, self.extras], axis=-1)
        return residual, self.terms.sqrt_info @ jacobian
