"""Fisher information of truth about parameters, by finite differences of the predictions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from glissando.calibration.robot.predictive import Predicted, Score
from glissando.geometry.se3 import Array

NUDGE = 1e-2
"""Step of finite differences of a parameter's logarithm, far above rounding errors of estimates."""
_LONGEST_MEMORY = 0.97  # largest correlation of residuals of neighbouring intervals


def slopes(centre: Score, beside: Sequence[Score | None], nudge: float) -> tuple[Array, Array]:
    """Gradient (P,) and Fisher information (P, P) of minus a score, per degree of freedom.

    The information of Gaussian samples with residual r and covariance S is
    Σ rᵢᵀ S⁻¹ rⱼ + ½ tr(S⁻¹ Sᵢ S⁻¹ Sⱼ), where an index is the derivative by that parameter. It is
    the expected curvature, and needs one-sided first differences only.

    Args:
        centre: Score of the robot file.
        beside: Scores with each parameter (P,) perturbed; None where there is no estimate.
        nudge: Perturbation of the parameters.

    Returns:
        Gradient and information, zero for a parameter without an estimate.
    """
    count = len(beside)
    slope, changes = np.zeros(count), np.zeros((count, 0))
    for i, score in enumerate(beside):
        if score is not None:
            change = _whitened(centre.predicted, score.predicted, nudge)
            changes = changes if changes.size else np.zeros((count, change.size))
            changes[i] = change
            slope[i] = (centre.value - score.value) / nudge
    return slope, changes @ changes.T / centre.samples


def slope_covariance(centre: Score, beside: Sequence[Score | None], nudge: float) -> Array:
    """Covariance (P, P) of the gradient per degree of freedom, with errors correlated over time.

    For independent samples it is the information of `slopes`. If residuals at two times have the
    correlation r, products of their derivatives of means are weighted by r, of covariances by r²;
    r falls exponentially with time, at a rate estimated from the residuals (the Godambe information
    of a composite likelihood: Varin, Reid and Firth, Statistica Sinica 21, 2011).

    Args:
        centre: Score of the robot file.
        beside: Scores with each parameter (P,) perturbed; None where there is no estimate.
        nudge: Perturbation of the parameters.
    """
    out = np.zeros((len(beside), len(beside)))
    for i, ((residual, cov), moment) in enumerate(
        zip(centre.predicted, centre.moments, strict=True)
    ):
        root = np.linalg.cholesky(cov)
        by_mean = np.zeros((len(beside), *residual.shape))
        by_cov = np.zeros((len(beside), *cov.shape))
        for mean_row, wide, score in zip(by_mean, by_cov, beside, strict=True):
            if score is not None:
                moved, widened = score.predicted[i]
                mean_row[:], wide[:] = _whitened_changes(root, moved - residual, widened - cov)
        correlation = _residual_correlations(
            np.linalg.solve(root, residual[..., None])[..., 0], moment
        )
        out += np.einsum("pmi,imn,qni->pq", by_mean, correlation, by_mean, optimize=True)
        for a, b in np.ndindex(*cov.shape[1:]):
            wide = by_cov[:, :, a, b]
            out += 0.5 * wide @ (correlation[a] * correlation[b]) @ wide.T
    return out / nudge**2 / centre.samples


def _residual_correlations(white: Array, moment: Array) -> Array:
    """Correlations (r, M, M) of whitened residuals (M, r) in intervals with indices (M,)."""
    lag = np.abs(moment[:, None] - moment)
    neighbours = np.argwhere(np.triu(lag == 1.0))
    pairs = white[neighbours[:, 0]], white[neighbours[:, 1]]
    size = 0.5 * sum(np.sum(each**2, axis=0) for each in pairs)
    correlation = np.sum(pairs[0] * pairs[1], axis=0) / np.maximum(size, 1e-300)
    correlation = np.clip(correlation, 0.0, _LONGEST_MEMORY)
    return np.asarray(correlation[:, None, None] ** lag)


def _whitened(centre: Sequence[Predicted], beside: Sequence[Predicted], nudge: float) -> Array:
    """Whitened derivatives by a parameter, whose inner products are the information."""
    parts: list[Array] = []
    for (residual, cov), (moved, widened) in zip(centre, beside, strict=True):
        by_mean, by_cov = _whitened_changes(
            np.linalg.cholesky(cov), moved - residual, widened - cov
        )
        parts += [by_mean.ravel(), np.sqrt(0.5) * by_cov.ravel()]
    return np.concatenate(parts) / nudge


def _whitened_changes(root: Any, mean: Array, cov: Array) -> tuple[Array, Array]:
    """Changes of means (M, r) and covariances (M, r, r), whitened by Cholesky factors `root`."""
    by_mean = np.asarray(np.linalg.solve(root, mean[..., None])[..., 0])
    half = np.linalg.solve(root, cov)
    return by_mean, np.asarray(np.linalg.solve(root, half.swapaxes(-1, -2)))
