"""Evidence of a force anywhere along the robot, and its distribution without contact.

A force at s_c adds G f to the error r of the interval in which it lies. With the states
marginalised it has information matrix B = GᵀQ⁻¹(Q − P_r)Q⁻¹G and vector b = GᵀQ⁻¹r̂, so that the
log evidence grows by ½ bᵀ(B + Σ⁻¹)⁻¹b − ½ log det(1 + ΣB). Source: equation (29).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.noise import sqrt_information
from glissando.model.priors import matern
from glissando.model.priors.mechanical.intervals import still_columns, still_error
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.state import State
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate

_DRAWS = 4000  # of a robot without contact, for the threshold
RAREST = 4.0 / _DRAWS
"""Least share of false alarms for which so many draws determine a threshold."""

_PER_INTERVAL = 6  # places in an interval
_ROUNDING = 1e-12  # relative to a diagonal entry of the information
_UNSEEN = 1e-9  # share of an error's prior variance below which readings are uninformative


@dataclass(frozen=True)
class ErrorPrior:
    """Prior of the intervals' errors at one time.

    Their covariance depends on all earlier shapes, not only on that at this time: errors decay and
    are renewed from one time node to the next, see equation (8).

    Attributes:
        time: Seconds.
        noise: Stationary covariance Q (N−1, 12, 12) of errors for the shape at that time.
        cov: Covariance (2, 2, N−1, 12, 12) of errors and of their rates.
    """

    time: float
    noise: Array
    cov: Array

    @property
    def of_errors(self) -> Array:
        """Covariance (N−1, 12, 12) of the errors."""
        return np.asarray(self.cov[0, 0])

    def advanced(self, time_scale: float, time: float, noise: Array) -> ErrorPrior:
        """The prior at a later time, whose shape has errors of covariance `noise`."""
        step = np.array([time - self.time])
        fade = matern.transition(time_scale, step)[0]
        new = matern.process_covariance(time_scale, step)[0]
        cov = np.einsum("ac,cdnij,bd->abnij", fade, self.cov, fade)
        cov += np.einsum("ab,nij->abnij", new, 0.5 * (self.noise + noise))
        return ErrorPrior(time, noise, cov)


def error_priors(
    prior: MechanicalPrior, grid: Grid, state: State, before: ErrorPrior | None = None
) -> list[ErrorPrior]:
    """Priors of the intervals' errors at K times.

    Args:
        prior: The prior.
        grid: Grid with the K times.
        state: Nodes (K, N).
        before: Prior at the first time or earlier; if None, that at the first time is stationary.
    """
    count = grid.arclength.size - 1
    start = state.take(np.s_[:, :-1]).flatten()
    noise = prior.rod.tiled(grid, grid.time.size).flow(start, noisy=True).noise
    out: list[ErrorPrior] = []
    for time, here in zip(grid.time, noise.reshape(-1, count, 12, 12), strict=True):
        if before is None or before.time > time:
            cov = np.einsum("ab,nij->abnij", matern.stationary(prior.time_scale), here)
            before = ErrorPrior(float(time), here, cov)
        elif before.time < time:
            before = before.advanced(prior.time_scale, float(time), here)
        out.append(before)
    return out


def seen_times(posterior: Posterior) -> NDArray[np.bool_]:
    """Mask (K,) of time nodes with readings in the time steps beside them.

    Elsewhere the state decays from earlier ones, and a force would only explain the small remainder
    of an earlier force.

    Args:
        posterior: Posterior with its linearisation point.
    """
    assert posterior.linearized is not None
    alone = linearize(posterior.prior, locate(posterior.grid, []), *posterior.linearized)
    rest = np.einsum("kii->ki", alone.system.diagonal)
    own = np.einsum("kii->ki", posterior.system.diagonal)[:, : rest.shape[1]]
    return np.asarray(np.any(np.abs(own - rest) > _ROUNDING * own, axis=1))


@dataclass(frozen=True)
class ForceEvidence:
    """Information on a force at each of C places, at one time.

    Attributes:
        arclength: Places (C,), m.
        vector: Information vectors b (C, 3).
        root: Root (m, C, 3) of the joint covariance of all b without contact: b = Σ w_m root_m
            with w of unit variance. Its blocks are the information matrices B.
    """

    arclength: Array
    vector: Array
    root: Array

    def take(self, rows: slice) -> ForceEvidence:
        """Information at some of the places."""
        return ForceEvidence(self.arclength[rows], self.vector[rows], self.root[:, rows])

    def uninformative(self) -> ForceEvidence:
        """Information of a state without readings: zero at the same places."""
        return ForceEvidence(self.arclength, 0.0 * self.vector, 0.0 * self.root)

    @property
    def shares(self) -> Array:
        """Share (C,) of the length that each place represents."""
        return shares_of_length(self.arclength)

    def given_force(self, variance: Array) -> tuple[Array, Array]:
        """Posterior covariance (C, 3, 3) of a force of prior variance (3,); ½ log det(1 + ΣB)."""
        blocks = np.einsum("mci,mcj->cij", self.root, self.root)
        cov = np.asarray(np.linalg.inv(blocks + np.diag(1.0 / variance)), dtype=float)
        return cov, 0.5 * np.linalg.slogdet(np.eye(3) + variance[:, None] * blocks)[1]

    def alarm_threshold(self, variance: Array, false_alarms: float) -> float:
        """Value that the evidence of a force anywhere exceeds in a share of draws without contact.

        Maps over arclength are smooth, so two places in an interval suffice.
        """
        few = self.take(slice(1, None, _PER_INTERVAL // 2))
        cov, half_log_det = few.given_force(variance)
        scaled = np.einsum("mci,cij->mcj", few.root, np.linalg.cholesky(cov))
        noise = np.random.default_rng(0).standard_normal((_DRAWS, len(scaled)))
        drawn = noise @ scaled.reshape(len(scaled), 3 * few.arclength.size)
        ratio = 0.5 * np.square(drawn).reshape(_DRAWS, -1, 3).sum(axis=-1) - half_log_det
        return float(np.quantile(np.log(np.exp(ratio) @ few.shares), 1.0 - false_alarms))


def shares_of_length(places: Array) -> Array:
    """Share (C,) of the length that each of C places represents."""
    edges = np.concatenate([[0.0], 0.5 * (places[1:] + places[:-1]), places[-1:]])
    return np.diff(edges) / edges[-1]


def force_evidence(
    prior: MechanicalPrior,
    arclength: Array,
    errors: ErrorPrior,
    state: State,
    cov: Array,
    step: Array,
) -> ForceEvidence:
    """Information on a force anywhere from the posterior at one time.

    In units of their prior, errors have the covariance I − D in the posterior; directions in which
    D is no larger than its rounding errors are treated as uninformative.

    Args:
        prior: The prior, without the contact.
        arclength: Nodes (N,), m.
        errors: Prior of the intervals' errors.
        state: Nodes (N,) at which the posterior is linearised.
        cov: Posterior covariance (D, D), unknowns of the nodes first.
        step: Step (D,) from the linearisation point to the mean.
    """
    places, n, jacobian = _force_jacobians(prior, arclength, state)
    count = arclength.size - 1
    ends = state.take(np.s_[:-1]), state.take(np.s_[1:])
    error, slopes = still_error(*ends, prior.rod.intervals(arclength))
    whitener = sqrt_information(errors.of_errors)
    slope = np.zeros((count, 12, count + 1, slopes.shape[3]))
    rows = np.arange(count)
    for end in range(2):
        slope[rows, :, rows + end] = whitener @ slopes[:, :, end]
    flat = slope.reshape(12 * count, -1)
    chosen = (np.arange(count + 1)[:, None] * state.dof + still_columns(slopes.shape[3])).ravel()
    white = (whitener @ error[:, :, None]).ravel() + flat @ step[chosen]
    value, vector = np.linalg.eigh(np.eye(12 * count) - flat @ cov[np.ix_(chosen, chosen)] @ flat.T)
    seen = value > max(_UNSEEN, -2.0 * float(value[0]))
    directions = vector[:, seen].reshape(count, 12, -1)[n]
    root = np.einsum("cam,cai->mci", directions, whitener[n] @ jacobian)
    by_force = np.einsum("m,mci->ci", white @ vector[:, seen], root)
    return ForceEvidence(places, by_force, np.sqrt(value[seen])[:, None, None] * root)


def _force_jacobians(
    prior: MechanicalPrior, arclength: Array, state: State
) -> tuple[Array, Index, Array]:
    """Places (C,), their intervals (C,), and Jacobians (C, 12, 3) of errors by a force there."""
    lengths = np.diff(arclength)
    n = np.repeat(np.arange(lengths.size), _PER_INTERVAL)
    offset = lengths[n] * np.tile((np.arange(_PER_INTERVAL) + 0.5) / _PER_INTERVAL, lengths.size)
    start, piece = state.take(n), prior.rod.intervals(arclength).take(n)
    piece = piece.accelerated(start, state.take(n + 1))
    near = piece.before(offset).flow(start, noisy=False)
    point = State(start.pose @ near.pose, near.wrench, start.velocity)
    onward = piece.beyond(offset).flow(point, noisy=False).transition
    return arclength[n] + offset, n, -onward[:, :, 6:9] / piece.section.stiffness[:, None, :3]
