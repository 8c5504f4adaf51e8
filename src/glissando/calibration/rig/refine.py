"""From a rough rig to the most likely one with its covariance: Gauss–Newton, errors correlated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from glissando.calibration.rig.model import ROWS, Model
from glissando.calibration.rig.rig import PARAMETERS, Rig
from glissando.geometry import se3
from glissando.geometry.se3 import Array

_ITERATIONS = 30
_ROUNDS = 3  # times the errors' covariance is renewed
_SHORT = 0.01  # standard deviations: a step that changes nothing
_HALVINGS = 8
_STILL = 0.1  # standard deviations a round may move the rig and be the last


@dataclass(frozen=True)
class Found:
    """The most likely rig for one direction, its covariance (17, 17), and how likely it is.

    `chol` is the Cholesky factor of the covariance that the readings' errors have there.
    """

    rig: Rig
    cov: Array
    log_evidence: float
    model: Model
    chol: Array
    converged: bool


def refine(model: Model, rig: Rig, expected: Rig, std: Array, *, rounds: int = _ROUNDS) -> Found:
    """The rig that coil and expectation make most likely, from `rig` on.

    `expected` with standard deviations `std` (17,) is what is believed before; zeros are known.
    The errors' covariance is renewed `rounds` times at most.
    """
    belief = _Belief(expected, np.flatnonzero(std > 0.0), std[std > 0.0] ** -2.0)
    for _ in range(rounds):
        before, chol = rig, _factor(model.covariance(rig))
        rig, cost, inverse, converged = _descend(model, rig, belief, chol)
        moved = apart(rig, before)[belief.free]
        if np.all(np.abs(moved) < _STILL * np.sqrt(inverse.diagonal())):
            break
    cov = np.zeros((len(PARAMETERS),) * 2)
    cov[np.ix_(belief.free, belief.free)] = inverse
    scale = np.sqrt(inverse.diagonal())
    spread = np.linalg.slogdet(inverse / np.outer(scale, scale))[1] + 2.0 * np.sum(np.log(scale))
    log_det = 2.0 * np.sum(np.log(np.diag(chol))) - float(spread)
    return Found(rig, cov, -0.5 * (cost + float(log_det)), model, chol, converged)


def _factor(cov: Array) -> Array:
    return np.asarray(np.linalg.cholesky(cov), dtype=np.float64)


@dataclass(frozen=True)
class _Belief:
    """What was expected: of the `free` parameters, with the information `known` each."""

    expected: Rig
    free: NDArray[np.intp]
    known: Array

    def off(self, rig: Rig) -> Array:
        """How far the free parameters are from what was expected."""
        return apart(rig, self.expected)[self.free]


def _descend(
    model: Model, rig: Rig, belief: _Belief, chol: Array
) -> tuple[Rig, float, Array, bool]:
    """The rig of least cost, its cost, the covariance of what is free, whether it was reached."""
    converged = False
    for _ in range(_ITERATIONS):
        residual, jacobian = _whitened(model, rig, belief, chol)
        off = belief.off(rig)
        system = jacobian.T @ jacobian + np.diag(belief.known)
        scale = np.sqrt(system.diagonal())
        inverse = np.linalg.inv(system / np.outer(scale, scale)) / np.outer(scale, scale)
        right = -(jacobian.T @ residual + belief.known * off)
        cost = float(residual @ residual + off @ (belief.known * off))
        step = np.zeros(len(PARAMETERS))
        step[belief.free] = inverse @ right
        converged = bool(right @ inverse @ right < _SHORT**2)
        if converged:
            break
        lower = _lower(model, rig, belief, chol, (step, cost))
        if lower is None:
            break
        rig = lower
    return rig, cost, inverse, converged


def _lower(
    model: Model, rig: Rig, belief: _Belief, chol: Array, told: tuple[Array, float]
) -> Rig | None:
    """The rig a step leads to, shortened until the cost falls; None where it does not."""
    step, cost = told
    for share in 0.5 ** np.arange(_HALVINGS):
        there = rig.moved(share * step)
        left = solve_triangular(chol, model.residual(there), lower=True)
        off = belief.off(there)
        if left @ left + off @ (belief.known * off) <= cost:
            return there
    return None


def _whitened(model: Model, rig: Rig, belief: _Belief, chol: Array) -> tuple[Array, Array]:
    both = np.column_stack([model.residual(rig), model.jacobian(rig)[:, belief.free]])
    left = solve_triangular(chol, both, lower=True)
    return left[:, 0], left[:, 1:]


def apart(rig: Rig, other: Rig) -> Array:
    """A rig less another (17,), so that other.moved(apart(rig, other)) is the rig."""
    return np.concatenate(
        [
            se3.log(se3.inverse(other.T_wt) @ rig.T_wt),
            rig.mount - other.mount,
            [rig.zero - other.zero, rig.lead - other.lead, rig.backlash - other.backlash],
            rig.tracker_clock - other.tracker_clock,
            rig.slide_clock - other.slide_clock,
        ]
    )


def innovations(found: Found) -> Array:
    """Each reading's distance (M, 5) from what all others foretell, whitened: of unit variance."""
    inverse = cho_solve((found.chol, True), np.eye(len(found.chol)))
    weighted = inverse @ found.model.residual(found.rig)
    out = []
    for i in range(len(weighted) // ROWS):
        mine = slice(i * ROWS, (i + 1) * ROWS)
        out.append(np.linalg.solve(np.linalg.cholesky(inverse[mine, mine]), weighted[mine]))
    return np.array(out)
