"""A Matérn-3/2 process of unit variance: transitions of its state (x, ẋ). Source: (7).

λ = √3/ℓ for a time scale ℓ; matrices are 2×2.
"""

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from glissando._kernels.blas import product
from glissando._kernels.jit import jit
from glissando._kernels.scratch import matrix

_SMALL = 2.0  # argument below which a series is more accurate than the difference


@jit()
def _gamma3(x):
    """The regularised lower incomplete gamma function P(3, x) = 1 − e⁻ˣ (1 + x + x²/2)."""
    if x > _SMALL:
        return 1.0 - exp(-x) * (1.0 + x + 0.5 * x * x)
    term = total = x**3 / 6.0
    n = 4
    while term > 1e-17 * total:
        term *= x / n
        total += term
        n += 1
    return exp(-x) * total


@jit()
def transition_into(scale, step, out):
    """Transition matrix Φ(step) (2, 2)."""
    rate = sqrt(3.0) / scale
    a = rate * step
    fade = exp(-a)
    out[0, 0], out[0, 1] = fade * (1.0 + a), fade * step
    out[1, 0], out[1, 1] = -fade * rate * a, fade * (1.0 - a)


@jit()
def covariance_into(scale, step, out):
    """Q(step) = P∞ − Φ P∞ Φᵀ (2, 2), without the cancellation of that difference."""
    rate = sqrt(3.0) / scale
    a = rate * step
    fade, first = exp(-2.0 * a), _gamma3(2.0 * a)
    out[0, 0] = first
    out[0, 1] = out[1, 0] = 2.0 * rate * a * a * fade
    out[1, 1] = rate * rate * (first + 4.0 * a * fade)


@jit()
def inverse_into(a, out):
    """Inverse of a matrix (2, 2)."""
    det = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    out[0, 0], out[1, 1] = a[1, 1] / det, a[0, 0] / det
    out[0, 1], out[1, 0] = -a[0, 1] / det, -a[1, 0] / det


@jit()
def inverse_root_of_noise_into(scale, step, out):
    """W (2, 2), lower triangular, with Wᵀ W = Q(step)⁻¹."""
    noise = matrix(2, 2)
    covariance_into(scale, step, noise)
    first = sqrt(noise[0, 0])
    corner = noise[1, 0] / first
    last = sqrt(noise[1, 1] - corner * corner)
    out[0, 0], out[0, 1] = 1.0 / first, 0.0
    out[1, 0], out[1, 1] = -corner / (first * last), 1.0 / last


@jit()
def bridge_into(scale, step, offset, early, late, left):
    """Gains Λ, Ψ of both ends and bridge covariance (2, 2) at `offset` strictly inside a step."""
    near, whole, inverse = matrix(2, 2), matrix(2, 2), matrix(2, 2)
    onward, a, b = matrix(2, 2), matrix(2, 2), matrix(2, 2)
    covariance_into(scale, offset, near)
    covariance_into(scale, step, whole)
    transition_into(scale, step - offset, onward)
    inverse_into(whole, inverse)
    product(near, onward, a, 1.0, 0.0, False, True)
    product(a, inverse, late, 1.0, 0.0, False, False)
    transition_into(scale, offset, early)
    transition_into(scale, step, a)
    product(late, a, early, -1.0, 1.0, False, False)
    covariance_into(scale, step - offset, whole)
    inverse_into(whole, inverse)
    inverse_into(near, a)
    product(inverse, onward, b, 1.0, 0.0, False, False)
    product(onward, b, a, 1.0, 1.0, True, False)
    inverse_into(a, left)


@jit("(f8, f8[::1])")
def transition(scale, step):
    """Transition matrices Φ (M, 2, 2) over steps (M,)."""
    out = np.empty((len(step), 2, 2))
    for n in range(len(step)):
        transition_into(scale, step[n], out[n])
    return out


@jit("(f8, f8[::1])")
def process_covariance(scale, step):
    """Process noise Q (M, 2, 2) of steps (M,)."""
    out = np.empty((len(step), 2, 2))
    for n in range(len(step)):
        covariance_into(scale, step[n], out[n])
    return out


@jit("(f8, f8[::1], f8[::1])")
def bridge(scale, step, offset):
    """Gains Λ, Ψ and bridge covariances (M, 2, 2) at offsets into steps (M,)."""
    early, late, left = np.empty((3, len(step), 2, 2))
    for n in range(len(step)):
        bridge_into(scale, step[n], offset[n], early[n], late[n], left[n])
    return early, late, left
