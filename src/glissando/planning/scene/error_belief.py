"""What is known of a robot's model error over time: the filter's covariance, and its slopes.

A model error is a stationary Gauss–Markov process of unit variance, ξ_k+1 = a ξ_k + noise with
a = exp(−step / time scale); what is unknown of the sensors, whose numbers follow those of ξ, are
such processes or constants. Readings tell of it as they come; the covariance depends on where
sensors are and how the robot is bent, not on what they read. Commands of a moment know what was
read before it, and correct for it as far as tendons can: where the base stands elsewhere they
cannot. With L for what they leave of an error that is known, the body is off by the error of what
is known and by L times what is known, d = e + L ξ̂, of covariance P + L (P₀ − P) Lᵀ with P₀ of what
is known without readings. Source: Kalman 1960; backwards, of P⁺ = F P with F = I − K H,
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
    """The belief about a model error and the sensors' errors: mean (n,) and covariance (n, n)."""

    mean: Array
    cov: Array

    @staticmethod
    def unknown(size: int) -> ErrorBelief:
        """The belief before any reading."""
        return ErrorBelief(np.zeros(size), np.eye(size))

    def after(self, time: float, time_scale: Array) -> ErrorBelief:
        """The belief after a time in seconds without readings; time scales (n,) are of each."""
        fade = np.exp(-time / time_scale)
        return ErrorBelief(fade * self.mean, _faded(self.cov, fade))

    def updated(self, rows: Array, residual: Array) -> ErrorBelief:
        """The belief after whitened readings with rows (r, q) and residuals (r,)."""
        gain = _gain(self.cov, rows)
        free = np.eye(self.mean.size) - gain @ rows
        cov = free @ self.cov @ free.T + gain @ gain.T
        return ErrorBelief(self.mean + gain @ residual, cov)


def _faded(cov: Array, fade: Array) -> Array:
    """Covariance (n, n) a time later, of numbers of which so much (n,) is left then."""
    return np.outer(fade, fade) * cov + np.diag(1.0 - fade**2)


def _gain(cov: Array, rows: Array) -> Array:
    """Kalman's gain (q, r) for whitened rows (r, q)."""
    seen = rows @ cov
    return np.asarray(np.linalg.solve(np.eye(len(rows)) + seen @ rows.T, seen).T)


@dataclass(frozen=True)
class PredictedCovariance:
    """Covariances of n errors at K corrections, before and after the readings of each.

    Attributes:
        before: What commands of a correction know (K, n, n), first of the model error's q numbers.
        after: With the readings of the correction (K, n, n).
        free: I − K H of each correction (K, n, n).
        rows: Whitened rows of the readings (K, r, n).
        fade: What is left of each error (n,) from one correction to the next.
        unread: What would be known without any reading (K, n, n).
        left: What corrections leave of a model error that is known (q, q).
    """

    before: Array
    after: Array
    free: Array
    rows: Array
    fade: Array
    unread: Array
    left: Array

    def own(self, cov: Array) -> Array:
        """The part (…, q, q) of the model error of covariances (…, n, n)."""
        return cov[..., : len(self.left), : len(self.left)]

    def _padded(self, slope: Array) -> Array:
        """Slopes (…, n, n) by covariances, of those (…, q, q) by the part of the model error."""
        more = (0, len(self.fade) - len(self.left))
        return np.pad(slope, [*[(0, 0)] * (slope.ndim - 2), more, more])

    @cached_property
    def off(self) -> Array:
        """Covariance (K, q, q) of what the body is off by, as an error."""
        known = self.own(self.unread - self.before)
        return self.own(self.before) + self.left @ known @ self.left.T

    @cached_property
    def lagged(self) -> Array:
        """Covariance (K−1, q, q) of that with what it is off by a correction later, symmetric."""
        learned = self.own(self.before - self.after) @ self.left.T
        known = self.left @ self.own(self.unread - self.before) @ self.left.T
        out = self.own(self.after) + 0.5 * (learned + learned.mT) + known
        return np.asarray(self.fade[0] * out[:-1])

    def bridge(self, early: Array, late: Array) -> Array:
        """Covariances of the bridge of an error of unit variance between two corrections.

        Args:
            early: Parts of the way from one to the other.
            late: Parts that are no less.
        """
        whole = min(-np.log(max(self.fade[0], 1e-100)), _FADED)
        if not whole > 0.0:
            return np.zeros_like(early)
        out = 2.0 * np.sinh(whole * early) * np.sinh(whole * (1.0 - late)) / np.sinh(whole)
        return np.asarray(out)

    def back(self, by_off: Array, by_lagged: Array, by_before: Array) -> Array:
        """Slope (K, r, n) by the rows, of a value with slopes by `off`, `lagged` and `before`.

        Args:
            by_off: Slope (K, q, q).
            by_lagged: Slope (K−1, q, q).
            by_before: Slope (K, q, q), by its part of the model error.
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
    """Covariances of errors over K corrections.

    Args:
        cov: Covariance (n, n) before the readings of the first.
        rows: Whitened rows (K, r, n) of the readings of each.
        fade: What is left of each error (n,) from one correction to the next.
        left: What corrections leave of a model error that is known (q, q).
    """
    shape = (len(rows), *cov.shape)
    before, after, free, unread = (np.empty(shape) for _ in range(4))
    eye, prior = np.eye(len(cov)), cov
    for k, seen in enumerate(rows):
        before[k], unread[k] = cov, prior
        prior = _faded(prior, fade)
        free[k] = eye - _gain(cov, seen) @ seen
        new = free[k] @ cov
        after[k] = 0.5 * (new + new.T)
        cov = _faded(after[k], fade)
    return PredictedCovariance(before, after, free, rows, fade, unread, left)


@dataclass(frozen=True)
class KnownError:
    """Covariances of what a body is off by, as a model error, at M moments.

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
    def off(self) -> Array:
        """Covariances (M, q, q) at the moments."""
        at, share = self.shares
        weights = (1.0 - share) ** 2, share**2, 2.0 * share * (1.0 - share)
        return self._mixed(at, *weights, self.corrections.bridge(share, share))

    @cached_property
    def lagged(self) -> Array:
        """Covariances (M−1, q, q) with the error a moment later."""
        at, early, late = self._pairs
        return self._mixed(at, *self._lagged_weights, self.corrections.bridge(early, late))

    def back(self, by_off: Array, by_lagged: Array, by_before: Array) -> Array:
        """Slope (K, r, n) by the rows, of a value with slopes by `off` and `lagged`.

        And with slopes by what is not known before each correction, (K, q, q).
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
        out: Array = early[:, None, None] * known.off[at]
        out += late[:, None, None] * known.off[at + 1]
        out += both[:, None, None] * known.lagged[at]
        return out + bridge[:, None, None] * np.eye(out.shape[-1])
