"""A Matérn-3/2 process of unit variance in time: transitions of its state (x, ẋ).

Matrices are 2×2, and exact for any ratio of step to time scale ℓ; λ = √3/ℓ. Source: equation (7).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels import matern as kernels
from glissando._kernels.arrays import items, unflatten
from glissando.geometry.se3 import Array


def stationary(time_scale: float) -> Array:
    """Stationary covariance P∞ (2, 2) of (x, ẋ)."""
    return np.diag([1.0, 3.0 / time_scale**2])


def transition(time_scale: float, step: Array) -> Array:
    """Transition matrix Φ(step) (…, 2, 2)."""
    (out,) = unflatten(step.shape, kernels.transition(time_scale, items(step, step.shape)))
    return out


def process_covariance(time_scale: float, step: Array) -> Array:
    """Q(step) = P∞ − Φ P∞ Φᵀ (…, 2, 2), without the cancellation of that difference."""
    (out,) = unflatten(step.shape, kernels.process_covariance(time_scale, items(step, step.shape)))
    return out


def bridge(time_scale: float, step: Array, offset: Array) -> tuple[Array, Array, Array]:
    """Gains Λ, Ψ of both ends of a step, and bridge covariance, at `offset` in it (…, 2, 2).

    The mean is Λ z₀ + Ψ z₁; offsets lie strictly inside. Source: equations (10) and (12).
    """
    lead = offset.shape
    places = items(step, lead), items(offset, lead)
    early, late, left = unflatten(lead, *kernels.bridge(time_scale, *places))
    return early, late, left
