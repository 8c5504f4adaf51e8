"""Refinement of a rig by Gauss–Newton with correlated errors, with the posterior covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from glissando.calibration.rig.model import ROWS, CoilModel
from glissando.calibration.rig.rig import PARAMETERS, Rig
from glissando.geometry.se3 import Array

_ITERATIONS = 30
_ROUNDS = 3  # evaluations of the errors' covariance
_CONVERGED = 0.01  # standard deviations: a shorter step ends the iteration
_SETTLED = 0.1  # standard deviations: after a smaller change the covariance is not recomputed
_HALVINGS = 8


@dataclass(frozen=True)
class RigFit:
    """Maximum a posteriori rig for one direction.

    Attributes:
        rig: The rig.
        cov: Covariance (17, 17) of the rig's parameters.
        log_evidence: Laplace log evidence of this direction.
        model: The readings that were fitted.
        chol: Cholesky factor of the covariance of the readings' errors.
        converged: Whether the iteration converged.
    """

    rig: Rig
    cov: Array
    log_evidence: float
    model: CoilModel
    chol: Array
    converged: bool

    def innovations(self) -> Array:
        """Whitened innovations (B, 5) of each block given all other blocks."""
        inverse = cho_solve((self.chol, True), np.eye(len(self.chol)))
        weighted = inverse @ self.model.residual(self.rig)
        out = []
        for i in range(len(weighted) // ROWS):
            rows = slice(i * ROWS, (i + 1) * ROWS)
            out.append(np.linalg.solve(np.linalg.cholesky(inverse[rows, rows]), weighted[rows]))
        return np.array(out)


def refine(
    model: CoilModel, rig: Rig, expected: Rig, std: Array, *, rounds: int = _ROUNDS
) -> RigFit:
    """Maximum a posteriori rig given the coil's readings and the prior.

    Args:
        model: The coil's readings against the shape.
        rig: Initial guess.
        expected: Prior mean.
        std: Prior standard deviations (17,); parameters with zero are fixed at the prior mean.
        rounds: Maximum number of evaluations of the covariance of the readings' errors.
    """
    problem = _Problem(model, expected, np.flatnonzero(std > 0.0), std[std > 0.0] ** -2.0)
    for _ in range(rounds):
        before = rig
        chol = np.asarray(np.linalg.cholesky(model.covariance(rig)), dtype=np.float64)
        rig, cost, inverse, converged = problem.minimise(rig, chol)
        change = rig.minus(before)[problem.free]
        if np.all(np.abs(change) < _SETTLED * np.sqrt(inverse.diagonal())):
            break
    cov = np.zeros((len(PARAMETERS),) * 2)
    cov[np.ix_(problem.free, problem.free)] = inverse
    scale = np.sqrt(inverse.diagonal())
    log_det = 2.0 * np.sum(np.log(np.diag(chol)))
    log_det -= np.linalg.slogdet(inverse / np.outer(scale, scale))[1] + 2.0 * np.sum(np.log(scale))
    return RigFit(rig, cov, -0.5 * (cost + float(log_det)), model, chol, converged)


@dataclass(frozen=True)
class _Problem:
    """Least squares over the parameters `free`, with the diagonal prior `information`."""

    model: CoilModel
    expected: Rig
    free: NDArray[np.intp]
    information: Array

    def minimise(self, rig: Rig, chol: Array) -> tuple[Rig, float, Array, bool]:
        """Rig of least cost, its cost, covariance of the free parameters, and convergence."""
        converged = False
        for _ in range(_ITERATIONS):
            columns = [self.model.residual(rig), self.model.jacobian(rig)[:, self.free]]
            whitened = solve_triangular(chol, np.column_stack(columns), lower=True)
            residual, jacobian = whitened[:, 0], whitened[:, 1:]
            deviation = rig.minus(self.expected)[self.free]
            system = jacobian.T @ jacobian + np.diag(self.information)
            scale = np.sqrt(system.diagonal())
            inverse = np.linalg.inv(system / np.outer(scale, scale)) / np.outer(scale, scale)
            rhs = -(jacobian.T @ residual + self.information * deviation)
            cost = float(residual @ residual + deviation @ (self.information * deviation))
            converged = bool(rhs @ inverse @ rhs < _CONVERGED**2)
            if converged:
                break
            step = np.zeros(len(PARAMETERS))
            step[self.free] = inverse @ rhs
            shares = 0.5 ** np.arange(_HALVINGS)
            candidates = (rig.moved(share * step) for share in shares)
            lower = next((new for new in candidates if self._cost(new, chol) <= cost), None)
            if lower is None:
                break
            rig = lower
        return rig, cost, inverse, converged

    def _cost(self, rig: Rig, chol: Array) -> float:
        residual = solve_triangular(chol, self.model.residual(rig), lower=True)
        deviation = rig.minus(self.expected)[self.free]
        return float(residual @ residual + deviation @ (self.information * deviation))
