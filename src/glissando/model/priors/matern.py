"""A Matérn-3/2 process of unit variance in time: its state (x, ẋ) between two moments.

Everything is 2×2, exact at any step against the time scale ℓ; λ = √3/ℓ. Source: equation (7).
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammainc

from glissando.geometry.se3 import Array


def stationary(time_scale: float) -> Array:
    """P∞ (2, 2), the covariance of (x, ẋ) at any moment."""
    return np.diag([1.0, 3.0 / time_scale**2])


def transition(time_scale: float, step: Array) -> Array:
    """Φ(step) (…, 2, 2)."""
    decay = np.sqrt(3.0) / time_scale
    a = decay * step
    rows = [[1.0 + a, step], [-decay * a, 1.0 - a]]
    return np.exp(-a)[..., None, None] * np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def process_covariance(time_scale: float, step: Array) -> Array:
    """Q(step) = P∞ − Φ P∞ Φᵀ (…, 2, 2), without the cancellation of that difference."""
    decay = np.sqrt(3.0) / time_scale
    a = decay * step
    fade = np.exp(-2.0 * a)
    first = gammainc(3.0, 2.0 * a)
    corner = 2.0 * decay * a**2 * fade
    rows = [[first, corner], [corner, decay**2 * (first + 4.0 * a * fade)]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def bridge(time_scale: float, step: Array, offset: Array) -> tuple[Array, Array, Array]:
    """What both ends of a step say at `offset` into it: Λ, Ψ and leftover covariance (…, 2, 2).

    The mean is Λ z₀ + Ψ z₁; offsets lie strictly inside. Source: equations (10) and (12).
    """
    near, rest = process_covariance(time_scale, offset), step - offset
    onward = transition(time_scale, rest)
    whole = process_covariance(time_scale, step)
    late = np.swapaxes(np.linalg.solve(whole, onward @ near), -1, -2)
    early = transition(time_scale, offset) - late @ transition(time_scale, step)
    beyond = np.linalg.solve(process_covariance(time_scale, rest), onward)
    information = np.linalg.inv(near) + np.swapaxes(onward, -1, -2) @ beyond
    return early, late, np.linalg.inv(information)
