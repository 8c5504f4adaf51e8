"""Noise covariances, their square-root information, and robust losses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from glissando._kernels import process
from glissando._kernels.arrays import items
from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.field_checks import is_number

_ASYMMETRY = 1e-9  # relative to both standard deviations, due to rounding


def covariance_matrix(given: ArrayLike, rows: int, what: str) -> Array:
    """A covariance (rows, rows) or (M, rows, rows) from a matrix, variances (rows,) or a scalar.

    Raises SensorError when the shape does not fit, or it is not symmetric positive definite.
    """
    try:
        cov = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise SensorError(f"{what}: covariance is {given!r}; give numbers.") from None
    if not np.all(np.isfinite(cov)):
        raise SensorError(f"{what}: covariance is not finite; give every row a finite variance.")
    if cov.ndim == 0:
        cov = cov * np.eye(rows)
    elif cov.ndim == 1 and cov.size == rows:
        cov = np.diag(cov)
    if cov.shape[-2:] != (rows, rows) or cov.ndim > 3:
        raise SensorError(
            f"{what}: covariance has shape {np.shape(given)}; give a variance, {rows} variances, "
            f"or a {rows}×{rows} matrix (one, or one a reading)."
        )
    other = np.swapaxes(cov, -1, -2)
    std = np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0))
    if np.any(np.abs(cov - other) > _ASYMMETRY * std[..., :, None] * std[..., None, :]):
        raise SensorError(f"{what}: covariance is not symmetric; give a symmetric matrix.")
    cov = 0.5 * (cov + other)
    if not np.all(np.linalg.eigvalsh(cov) > 0.0):
        raise SensorError(
            f"{what}: covariance is not positive definite; give every row a variance above zero, "
            f"and correlations between −1 and 1."
        )
    return cov


def sqrt_information(cov: Array) -> Array:
    """Square-root information W (…, r, r): Wᵀ W = cov⁻¹, so that W @ residual is white.

    Raises:
        LinAlgError: The covariance is not positive definite.
    """
    size = cov.shape[-1]
    whitener: Array = process.sqrt_information(items(cov, cov.shape[:-2], size, size))
    return whitener.reshape(cov.shape)


class Loss(Protocol):
    """A robust loss, a function of the norm of a reading's whitened residual."""

    def weight(self, norm: Array) -> Array:
        """Weight (M,) of the squared residual: 1 for inliers, towards 0 for outliers."""

    def cost(self, norm: Array) -> Array:
        """Loss (M,) at the norm of a whitened residual, ½ norm² where it is small."""


def _require_positive(threshold: float) -> None:
    if not is_number(threshold) or not threshold > 0.0:
        raise SensorError(f"The threshold of a loss is {threshold}; give one above zero.")


@dataclass(frozen=True)
class Huber:
    """Quadratic up to `threshold` standard deviations, linear beyond (Huber 1964)."""

    threshold: float = 3.0

    def __post_init__(self) -> None:
        _require_positive(self.threshold)

    def weight(self, norm: Array) -> Array:
        """Weight threshold / norm beyond the threshold."""
        return np.minimum(1.0, self.threshold / np.maximum(norm, 1e-300))

    def cost(self, norm: Array) -> Array:
        """½ norm², then threshold · norm − ½ threshold²."""
        linear = self.threshold * (norm - 0.5 * self.threshold)
        return np.where(norm <= self.threshold, 0.5 * norm**2, linear)


@dataclass(frozen=True)
class GemanMcClure:
    """A loss that saturates: gross outliers lose all influence (Geman and McClure 1987)."""

    threshold: float = 5.0

    def __post_init__(self) -> None:
        _require_positive(self.threshold)

    def weight(self, norm: Array) -> Array:
        """Weight 1 / (1 + (norm / threshold)²)²."""
        return 1.0 / (1.0 + (norm / self.threshold) ** 2) ** 2

    def cost(self, norm: Array) -> Array:
        """½ norm² / (1 + (norm / threshold)²)."""
        return 0.5 * norm**2 / (1.0 + (norm / self.threshold) ** 2)
