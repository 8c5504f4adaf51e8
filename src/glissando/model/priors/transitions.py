"""Exact transitions of [pose, rate] along one direction: process noise and bridges.

Along arclength a pose T moves by its strain, along time by its velocity; either is called `rate`
and is driven by white noise. About a constant rate the errors δ of the pose and δr of the rate obey

    δ' = −ad(rate) δ + δr,   δr' = w,        so   Φ(h) = [Ad(exp(−h rate)), h J_r(h rate); 0, I].

The integrands of the noise are polynomials in ad(rate) whose coefficients depend on the angle
alone, so quadrature of scalars is enough. Arrays are batches over intervals with a leading axis M.
Source: equations (2'), (3') and (12).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels import transitions as kernels
from glissando._kernels.arrays import items, unflatten
from glissando.geometry.se3 import Array


def symmetrize(matrix: Array) -> Array:
    """Half the sum of a matrix (…, r, r) and its transpose."""
    return 0.5 * (matrix + np.swapaxes(matrix, -1, -2))


def process_covariances(
    rate: Array,
    step: Array,
    psd: Array,
    carried_psd: Array,
    *,
    rigid: bool,
    jump: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Process noise of an interval on [pose error, rate error] and on the carried field.

    The first is ∫ Φ(u) diag(0, psd) Φ(u)ᵀ du (equation 2'), plus the variance of a jump of the rate
    at the end; the second ∫ Ad(exp(−u rate)) diag(carried_psd) Ad(…)ᵀ du when the field is carried
    rigidly with the body, else step · diag(carried_psd). The relative error of quadrature is about
    1e-10 for a step that turns the body by one radian.

    Args:
        rate: Strain or velocity (…, 6).
        step: Length (…) of the step, metres or seconds.
        psd: Densities of the moving field, (6,) or (…, 6).
        carried_psd: Densities of the carried field, (6,) or (…, 6).
        rigid: Whether the field is carried rigidly with the body.
        jump: Variance (…, 6) of a jump of the rate at the end.

    Returns:
        Covariances (…, 12, 12) of the pair and (…, 6, 6) of the carried field.
    """
    lead = rate.shape[:-1]
    six = (items(each, lead, 6) for each in (psd, carried_psd, jump))
    cov, carried = unflatten(
        lead,
        *kernels.process_covariances(items(rate, lead, 6), items(step, lead), *six, rigid),
    )
    return cov, carried


def bridge(
    rate: Array, step: Array, offset: Array, psd: Array, jump: Array | float = 0.0
) -> tuple[Array, Array]:
    """Gain and bridge covariance of a point inside an interval whose ends are known.

    gain = Q(u) Φ(h−u)ᵀ Q(h)⁻¹ and cov = Q(u) − gain Φ(h−u) Q(u), which equals equation (12). Gains
    do not depend on the scale of the densities, covariances are proportional to it.

    Args:
        rate: Strain or velocity (…, 6).
        step: Length (…) of the interval, metres or seconds.
        offset: Distance (…) of the point from the beginning.
        psd: Densities of the moving field, (6,) or (…, 6).
        jump: Variance (…, 6) of a jump of the rate at the interval's end.

    Returns:
        Gain and covariance (…, 12, 12) of [pose error, rate error] at the point.
    """
    lead = rate.shape[:-1]
    places, six = (items(step, lead), items(offset, lead)), (items(x, lead, 6) for x in (psd, jump))
    gain, cov = unflatten(lead, *kernels.bridge(items(rate, lead, 6), *places, *six, False))
    return gain, cov
