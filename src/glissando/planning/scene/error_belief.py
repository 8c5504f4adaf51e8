"""What is known of a robot's model error over time: the filter's covariance, and its slopes.

A model error is a stationary Gauss–Markov process of unit variance, ξ_k+1 = a ξ_k + noise with
a = exp(−step / time scale). Readings tell of it as they come; the covariance depends on where
sensors are and how the robot is bent, not on what they read. Commands of a moment know what was
read before it. Source: Kalman 1960; backwards, of P⁺ = F P with F = I − K H,
dP⁺ = F dP Fᵀ − P⁺ (dHᵀ H + Hᵀ dH) P⁺.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Index

_FADED = 100.0  # time scales after which nothing is left


@dataclass(frozen=True)
class ErrorBelief:
    """The belief about a model error: mean (q,) and covariance (q, q)."""

    mean: Array
    cov: Array

    @staticmethod
    def unknown(size: int) -> ErrorBelief:
        """The belief before any reading."""
        return ErrorBelief(np.zeros(size), np.eye(size))

    def after(self, time: float, time_scale: float) -> ErrorBelief:
        """The belief after a time in seconds without readings."""
        fade = np.exp(-time / time_scale)
        eye = np.eye(self.mean.size)
        return ErrorBelief(fade * self.mean, fade**2 * self.cov + (1.0 - fade**2) * eye)

    def updated(self, rows: Array, residual: Array) -> ErrorBelief:
        """The belief after whitened readings with rows (r, q) and residuals (r,)."""
        gain = _gain(self.cov, rows)
        free = np.eye(self.mean.size) - gain @ rows
        cov = free @ self.cov @ free.T + gain @ gain.T
        return ErrorBelief(self.mean + gain @ residual, cov)


def _gain(cov: Array, rows: Array) -> Array:
    """Kalman's gain (q, r) for whitened rows (r, q)."""
    seen = rows @ cov
    return np.asarray(np.linalg.solve(np.eye(len(rows)) + seen @ rows.T, seen).T)


@dataclass(frozen=True)
class PredictedCovariance:
    """Covariances of a model error at K corrections, before and after the readings of each.

    Attributes:
        before: What commands of a correction know (K, q, q).
        after: With the readings of the correction (K, q, q).
        free: I − K H of each correction (K, q, q).
        rows: Whitened rows of the readings (K, r, q).
        fade: What is left of a model error from one correction to the next.
    """

    before: Array
    after: Array
    free: Array
    rows: Array
    fade: float

    @property
    def lagged(self) -> Array:
        """Covariance (K−1, q, q) of the error of what is known with that a correction later."""
        return self.fade * self.after[:-1]

    def bridge(self, early: Array, late: Array) -> Array:
        """Covariances of the bridge of an error of unit variance between two corrections.

        Args:
            early: Parts of the way from one to the other.
            late: Parts that are no less.
        """
        whole = min(-np.log(max(self.fade, 1e-100)), _FADED)
        if not whole > 0.0:
            return np.zeros_like(early)
        out = 2.0 * np.sinh(whole * early) * np.sinh(whole * (1.0 - late)) / np.sinh(whole)
        return np.asarray(out)

    def back(self, by_before: Array, by_lagged: Array) -> Array:
        """Slope (K, r, q) by the rows, of a value with slopes by `before` and `lagged`.

        Args:
            by_before: Slope (K, q, q).
            by_lagged: Slope (K−1, q, q).
        """
        out = np.empty_like(self.rows)
        by_after = np.zeros_like(self.before[0])
        for k in range(len(self.rows) - 1, -1, -1):
            by_after = 0.5 * (by_after + by_after.T)
            out[k] = -2.0 * self.rows[k] @ (self.after[k] @ by_after @ self.after[k])
            if k:
                by_here = self.free[k].T @ by_after @ self.free[k] + by_before[k]
                by_after = self.fade**2 * by_here + self.fade * by_lagged[k - 1]
        return out


def predict_covariance(cov: Array, rows: Array, fade: float) -> PredictedCovariance:
    """Covariances of a model error over K corrections.

    Args:
        cov: Covariance (q, q) before the readings of the first.
        rows: Whitened rows (K, r, q) of the readings of each.
        fade: What is left of a model error from one correction to the next.
    """
    shape = (len(rows), *cov.shape)
    before, after, free = np.empty(shape), np.empty(shape), np.empty(shape)
    eye = np.eye(len(cov))
    for k, seen in enumerate(rows):
        before[k] = cov
        free[k] = eye - _gain(cov, seen) @ seen
        new = free[k] @ cov
        after[k] = 0.5 * (new + new.T)
        cov = fade**2 * after[k] + (1.0 - fade**2) * eye
    return PredictedCovariance(before, after, free, rows, fade)


@dataclass(frozen=True)
class KnownError:
    """Covariances of what is not known of a model error, at M moments.

    From one correction of the commands to the next the actuators go evenly, and what is left of the
    error too, (1 − w) e_k + w e_k+1, but for the bridge between both: a stationary error wanders
    there by itself. That it counts in full errs a little on the careful side.

    Attributes:
        corrections: The covariances at the corrections.
        position: The moments (M,) in numbers of corrections; all of these are among them.
    """

    corrections: PredictedCovariance
    position: Array

    @cached_property
    def before(self) -> Array:
        """Covariances (M, q, q) at the moments."""
        at, share = self.shares
        weights = (1.0 - share) ** 2, share**2, 2.0 * share * (1.0 - share)
        return self._mixed(at, *weights, self.corrections.bridge(share, share))

    @cached_property
    def lagged(self) -> Array:
        """Covariances (M−1, q, q) with the error a moment later."""
        at, early, late = self._pairs
        return self._mixed(at, *self._lagged_weights, self.corrections.bridge(early, late))

    def back(self, by_before: Array, by_lagged: Array) -> Array:
        """Slope (K, r, q) by the rows, of a value with slopes by `before` and `lagged`."""
        at, share = self.shares
        first = (1.0 - share) ** 2, share**2, 2.0 * share * (1.0 - share)
        known = self.corrections
        own, lag = np.zeros_like(known.before), np.zeros_like(known.lagged)
        pairs = ((by_before, at, first), (by_lagged, at[:-1], self._lagged_weights))
        for by, here, (early, late, both) in pairs:
            np.add.at(own, here, early[:, None, None] * by)
            np.add.at(own, here + 1, late[:, None, None] * by)
            np.add.at(lag, here, both[:, None, None] * by)
        return known.back(own, lag)

    @cached_property
    def shares(self) -> tuple[Index, Array]:
        """The correction before each moment (M,), the last but one at most, and how far from it."""
        at = np.minimum(self.position.astype(np.intp), len(self.corrections.before) - 2)
        return at, self.position - at

    @property
    def _lagged_weights(self) -> tuple[Array, Array, Array]:
        """Weights (M−1,) of both corrections' covariances and of that between them."""
        _, early, late = self._pairs
        both = (1.0 - early) * late + early * (1.0 - late)
        return (1.0 - early) * (1.0 - late), early * late, both

    @property
    def _pairs(self) -> tuple[Index, Array, Array]:
        """The correction before each moment and the next (M−1,), and how far from it both are."""
        at, share = self.shares
        return at[:-1], share[:-1], self.position[1:] - at[:-1]

    def _mixed(self, at: Index, early: Array, late: Array, both: Array, bridge: Array) -> Array:
        """Weighted sums of the covariances about each correction, and what the bridge adds."""
        known = self.corrections
        out: Array = early[:, None, None] * known.before[at]
        out += late[:, None, None] * known.before[at + 1]
        out += both[:, None, None] * known.lagged[at]
        return out + bridge[:, None, None] * np.eye(out.shape[-1])
