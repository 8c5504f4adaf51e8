"""What truth tells of parameters, by how they change what an estimate predicts of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from glissando.calibration.robot.predictive import Predicted, Score
from glissando.geometry.se3 import Array

NUDGE = 1e-2
"""Of a logarithm: far above what estimates beside one another are rounded to."""


def slopes(centre: Score, beside: Sequence[Score | None], nudge: float) -> tuple[Array, Array]:
    """Slope (P,) and Fisher information (P, P) of minus a score, per degree of freedom.

    The information of Gaussian samples with residual r and covariance S is
    Σ rᵢᵀ S⁻¹ rⱼ + ½ tr(S⁻¹ Sᵢ S⁻¹ Sⱼ), where an index is the derivative by that parameter: what the
    curvature is on average. So it takes first differences alone, and from one side.

    Args:
        centre: The score of a robot file.
        beside: Scores with each parameter (P,) nudged; None where there is no estimate.
        nudge: How far it was moved.

    Returns:
        Slope and information, zero for a parameter without an estimate.
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


def _whitened(centre: Sequence[Predicted], beside: Sequence[Predicted], nudge: float) -> Array:
    """Changes of residuals and covariances by a parameter, of which products are information."""
    parts: list[Array] = []
    for (residual, cov), (moved, widened) in zip(centre, beside, strict=True):
        root = np.linalg.cholesky(cov)
        along = np.linalg.solve(root, (moved - residual)[..., None])
        half = np.linalg.solve(root, widened - cov)
        across = np.linalg.solve(root, half.swapaxes(-1, -2))
        parts += [along.ravel(), np.sqrt(0.5) * across.ravel()]
    return np.concatenate(parts) / nudge
