"""Square roots of covariances: half axes of their ellipsoids, and symmetric roots."""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array


def half_axes(cov: Array) -> Array:
    """Half axes (…, d, d) of one-sigma ellipsoids as columns, a root of covariances (…, d, d).

    Variances that rounding made negative count as zero.

    >>> half_axes(np.diag([4.0, 9.0])) @ half_axes(np.diag([4.0, 9.0])).T
    array([[4., 0.],
           [0., 9.]])
    """
    variance, axes = np.linalg.eigh(cov)
    return np.asarray(axes * np.sqrt(np.maximum(variance, 0.0))[..., None, :])


def symmetric_root(cov: Array) -> Array:
    """Symmetric S (…, d, d) with S S = cov; variances made negative by rounding count as zero.

    >>> symmetric_root(np.diag([4.0, 9.0, 0.0])).diagonal().tolist()
    [2.0, 3.0, 0.0]
    """
    variance, axes = np.linalg.eigh(cov)
    scaled = axes * np.sqrt(np.maximum(variance, 0.0))[..., None, :]
    return np.asarray(scaled @ np.swapaxes(axes, -1, -2))
