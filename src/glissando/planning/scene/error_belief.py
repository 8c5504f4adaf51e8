"""Belief about a robot's model error over time: covariance of a Kalman filter, and gradients.

A model error is a stationary Gauss–Markov process of unit variance, ξ_k+1 = a ξ_k + noise with
a = exp(−step / time scale). Sensor errors, whose components follow those of ξ, are such processes
or constants. The covariance depends on where sensors are and how the robot is bent, not on the
values they read. A command uses all earlier readings, and corrects the estimated error as far as
tendons can; they cannot correct an error of the base. With L for the part of an estimated error
that remains after the correction, the body deviates as by the model error d = e + L ξ̂, e being the
estimation error. Its covariance is P + L (P₀ − P) Lᵀ, with P₀ the covariance without readings.
Source: Kalman 1960; backward pass of P⁺ = F P with F = I − K H,
dP⁺ = F dP Fᵀ − P⁺ (dHᵀ H + Hᵀ dH) P⁺.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Index

_FADED = 100.0  # time scales after which an error is forgotten


@dataclass(frozen=True)
class ErrorBelief:
    """Belief about model error and sensor errors: mean (n,) and covariance (n, n)."""

    mean: Array
    cov: Array

    @staticmethod
    def unknown(size: int) -> ErrorBelief:
        """The belief before any reading."""
        return ErrorBelief(np.zeros(size), np.eye(size))

    def after(self, time: float, time_scale: Array) -> ErrorBelief:
        """Predict the belief after `time` s without readings; time scales (n,) of each error, s."""
        fade = np.exp(-time / time_scale)
        return ErrorBelief(fade * self.mean, _predicted_cov(self.cov, fade))

    def updated(self, rows: Array, residual: Array) -> ErrorBelief:
        """Belief after an update with whitened readings: rows (r, n) and innovations (r,)."""
        gain = _gain(self.cov, rows)
        free = np.eye(self.mean.size) - gain @ rows
        cov = free @ self.cov @ free.T + gain @ gain.T
        return ErrorBelief(self.mean + gain @ residual, cov)


def _predicted_cov(cov: Array, fade: Array) -> Array:
    """Predicted covariance (n, n) of unit-variance processes with decay factors `fade` (n,)."""
    return np.outer(fade, fade) * cov + np.diag(1.0 - fade**2)


def _gain(cov: Array, rows: Array) -> Array:
    """Kalman gain (n, r) for whitened rows (r, n)."""
    rows_cov = rows @ cov
    return np.asarray(np.linalg.solve(np.eye(len(rows)) + rows_cov @ rows.T, rows_cov).T)


@dataclass(frozen=True)
class PredictedCovariance:
    """Covariances of n errors at K corrections, before and after the readings of each.

    Attributes:
        before: Covariances (K, n, n) when the commands of a correction are computed; the first q
            components are the model error.
        after: Covariances (K, n, n) given the readings of the correction too.
        free: I − (Kalman gain) H of each correction (K, n, n).
        rows: Whitened rows H of the readings (K, r, n).
        fade: Decay factor (n,) of each error from one correction to the next.
        unread: Covariances (K, n, n) without any reading.
        left: Matrix L (q, q), the part of an estimated model error that corrections leave.
    """

    before: Array
    after: Array
    free: Array
    rows: Array
    fade: Array
    unread: Array
    left: Array

    def own(self, cov: Array) -> Array:
        """Block (…, q, q) of the model error in covariances (…, n, n)."""
        return cov[..., : len(self.left), : len(self.left)]

    def _padded(self, slope: Array) -> Array:
        """Gradients (…, q, q) by the model error's block, padded to (…, n, n)."""
        more = (0, len(self.fade) - len(self.left))
        return np.pad(slope, [*[(0, 0)] * (slope.ndim - 2), more, more])

    @cached_property
    def off(self) -> Array:
        """Covariances (K, q, q) of the deviation d of the body, as a model error."""
        known = self.own(self.unread - self.before)
        return self.own(self.before) + self.left @ known @ self.left.T

    @cached_property
    def lagged(self) -> Array:
        """Symmetrised covariances (K−1, q, q) of d at one correction and at the next."""
        learned = self.own(self.before - self.after) @ self.left.T
        known = self.left @ self.own(self.unread - self.before) @ self.left.T
        out = self.own(self.after) + 0.5 * (learned + learned.mT) + known
        return np.asarray(self.fade[0] * out[:-1])

    def bridge(self, early: Array, late: Array) -> Array:
        """Covariances of a unit-variance error between two corrections, given its values at both.

        Args:
            early: Earlier times, as shares of the interval between the corrections.
            late: Later or equal times, as shares of the interval.
        """
        whole = min(-np.log(max(self.fade[0], 1e-100)), _FADED)
        if not whole > 0.0:
            return np.zeros_like(early)
        out = 2.0 * np.sinh(whole * early) * np.sinh(whole * (1.0 - late)) / np.sinh(whole)
        return np.asarray(out)

    def back(self, by_off: Array, by_lagged: Array, by_before: Array) -> Array:
        """Gradient (K, r, n) by the rows, of a value with given gradients by the covariances.

        Args:
            by_off: Gradient (K, q, q) by `off`.
            by_lagged: Gradient (K−1, q, q) by `lagged`.
            by_before: Gradient (K, q, q) by the model error's block of `before`.
        """
        out, left = np.empty_like(self.rows), self.left
        lagged = 0.5 * self.fade[0] * (by_lagged + by_lagged.mT)
        half = 0.5 * (lagged @ left + left.T @ lagged)
        by_before = by_before + by_off - left.T @ by_off @ left
        by_before[:-1] += half - left.T @ lagged @ left
        by_before, by_later = self._padded(by_before), np.zeros_like(self.before)
        by_later[:-1] = self._padded(lagged - half)
        by_after, faded = np.zeros_like(self.before[0]), np.outer(self.fade, self.fade)
        for k in range(len(self.rows) - 1, -1, -1):
            by_after = by_after + by_later[k]
            by_after = 0.5 * (by_after + by_after.T)
            out[k] = -2.0 * self.rows[k] @ (self.after[k] @ by_after @ self.after[k])
            by_after = faded * (self.free[k].T @ by_after @ self.free[k] + by_before[k])
        return out


def predict_covariance(cov: Array, rows: Array, fade: Array, left: Array) -> PredictedCovariance:
    """Predict covariances of errors over K corrections.

    Args:
        cov: Covariance (n, n) before the readings of the first correction.
        rows: Whitened rows (K, r, n) of the readings of each correction.
        fade: Decay factor (n,) of each error from one correction to the next.
        left: Matrix L (q, q), the part of an estimated model error that corrections leave.
    """
    shape = (len(rows), *cov.shape)
    before, after, free, unread = (np.empty(shape) for _ in range(4))
    eye, prior = np.eye(len(cov)), cov
    for k, seen in enumerate(rows):
        before[k], unread[k] = cov, prior
        prior = _predicted_cov(prior, fade)
        free[k] = eye - _gain(cov, seen) @ seen
        new = free[k] @ cov
        after[k] = 0.5 * (new + new.T)
        cov = _predicted_cov(after[k], fade)
    return PredictedCovariance(before, after, free, rows, fade, unread, left)


@dataclass(frozen=True)
class KnownError:
    """Covariances at M times (moments) of the deviation of a body, as a model error.

    Between two corrections the commands, and with them the deviation, are interpolated linearly,
    (1 − w) d_k + w d_k+1. The variance of the error's bridge between both is added in full, which
    overestimates the deviation slightly.

    Attributes:
        corrections: Covariances at the corrections.
        position: The moments (M,) in units of correction intervals, including all corrections.
    """

    corrections: PredictedCovariance
    position: Array

    @cached_property
    def off(self) -> Array:
        """Covariances (M, q, q) of the deviation at the moments."""
        at, share = self.shares
        weights = (1.0 - share) ** 2, share**2, 2.0 * share * (1.0 - share)
        return self._mixed(at, *weights, self.corrections.bridge(share, share))

    @cached_property
    def lagged(self) -> Array:
        """Covariances (M−1, q, q) of the deviations at one moment and at the next."""
        at, early, late = self._pairs
        return self._mixed(at, *self._lagged_weights, self.corrections.bridge(early, late))

    def back(self, by_off: Array, by_lagged: Array, by_before: Array) -> Array:
        """Gradient (K, r, n) by the rows, of a value with given gradients.

        These are by `off` (M, q, q), by `lagged` (M−1, q, q), and by the model error's covariance
        before each correction (K, q, q).
        """
        at, share = self.shares
        first = (1.0 - share) ** 2, share**2, 2.0 * share * (1.0 - share)
        known = self.corrections
        own, lag = np.zeros_like(known.off), np.zeros_like(known.lagged)
        pairs = ((by_off, at, first), (by_lagged, at[:-1], self._lagged_weights))
        for by, here, (early, late, both) in pairs:
            np.add.at(own, here, early[:, None, None] * by)
            np.add.at(own, here + 1, late[:, None, None] * by)
            np.add.at(lag, here, both[:, None, None] * by)
        return known.back(own, lag, by_before)

    @cached_property
    def shares(self) -> tuple[Index, Array]:
        """Index (M,) of the correction before each moment, and share (M,) of its interval passed.

        The last moment belongs to the last interval.
        """
        at = np.minimum(self.position.astype(np.intp), len(self.corrections.before) - 2)
        return at, self.position - at

    @property
    def _lagged_weights(self) -> tuple[Array, Array, Array]:
        """Weights (M−1,) of the covariances of both corrections, and of the one between them."""
        _, early, late = self._pairs
        both = (1.0 - early) * late + early * (1.0 - late)
        return (1.0 - early) * (1.0 - late), early * late, both

    @property
    def _pairs(self) -> tuple[Index, Array, Array]:
        """Correction (M−1,) before each moment; shares of its interval at this and the next one."""
        at, share = self.shares
        return at[:-1], share[:-1], self.position[1:] - at[:-1]

    def _mixed(self, at: Index, early: Array, late: Array, both: Array, bridge: Array) -> Array:
        """Weighted sums of the covariances at neighbouring corrections, plus the bridge's."""
        known = self.corrections
        out: Array = early[:, None, None] * known.off[at]
        out += late[:, None, None] * known.off[at + 1]
        out += both[:, None, None] * known.lagged[at]
        return out + bridge[:, None, None] * np.eye(out.shape[-1])
