"""The scalar functions SE(3) is made of: of the squared angle q = θ², accurate everywhere.

Power series near zero, closed forms away from it.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.special import zeta

Array = NDArray[np.float64]

BELOW = 1.0  # squared angle under which the power series are used
_TERMS = 12


def _factorial_series(offset: int) -> list[float]:
    """Coefficients of Σ (−q)^m / (2m + offset)!, lowest first."""
    return [(-1.0) ** m / factorial(2 * m + offset) for m in range(_TERMS)]


_A, _B, _C = (_factorial_series(k) for k in (1, 2, 3))
_D = [2.0 * float(zeta(2 * m + 2)) / (2.0 * np.pi) ** (2 * m + 2) for m in range(_TERMS + 4)]


def _derivative(coefficients: list[float]) -> list[float]:
    return [m * c for m, c in enumerate(coefficients)][1:]


def _together(*series: list[float]) -> Array:
    """Coefficients of F series as a table (terms, F, 1), as long as the shortest of them."""
    return np.array(list(zip(*series, strict=False)))[..., None]


_B1, _C1 = _derivative(_B), _derivative(_C)
ABC = _together(_A, _B, _C)
D_SLOPE = _together(_D, _derivative(_D))
BC_SLOPES = _together(_B, _C, _B1, _C1)
BC_CURVES = _together(_derivative(_B1), _derivative(_C1))


def _series(table: Array, q: Array, largest: float) -> Array:
    """Σ c_m q^m (F, …) for q < 1, with no more terms than the largest q asks for."""
    terms = 5 if largest < 1e-3 else 7 if largest < 0.05 else len(table)
    flat = q.ravel()
    value = flat * table[terms - 1]
    for c in table[terms - 2 : 0 : -1]:
        value += c
        value *= flat
    value += table[0]
    return value.reshape(table.shape[1], *q.shape)


def _piecewise(q: Array, table: Array, closed: Callable[[Array], tuple[Array, ...]]) -> Array:
    """Functions (F, …) of q = θ²: power series near zero, closed forms (given q) away from it."""
    largest = float(q.max(initial=0.0))
    if largest < BELOW:
        return _series(table, q, largest)
    far = q >= BELOW
    values = _series(table, np.where(far, 0.0, q), BELOW)
    values[:, far] = closed(q[far])
    return values


def _abc_closed(q: Array) -> tuple[Array, ...]:
    theta = np.sqrt(q)
    a = np.sin(theta) / theta
    return a, (1.0 - np.cos(theta)) / q, (1.0 - a) / q


def abc(q: Array) -> Array:
    """A = sin θ/θ, B = (1−cos θ)/θ², C = (θ−sin θ)/θ³ as functions (3, …) of q = θ²."""
    return _piecewise(q, ABC, _abc_closed)


def _d_closed(q: Array) -> tuple[Array, ...]:
    half = 0.5 * np.sqrt(q)
    g = half / np.tan(half)
    g_slope = (g - half**2 / np.sin(half) ** 2) / (2.0 * q)
    d = (1.0 - g) / q
    return d, (-g_slope - d) / q


def d_and_slope(q: Array) -> Array:
    """D = (1 − (θ/2) cot(θ/2))/θ² and dD/dq (2, …)."""
    return _piecewise(q, D_SLOPE, _d_closed)


def _bc_closed(q: Array) -> tuple[Array, ...]:
    a, b, c = _abc_closed(q)
    a_slope = (np.cos(np.sqrt(q)) - a) / (2.0 * q)
    return b, c, (0.5 * a - b) / q, (-a_slope - c) / q


def _bc_curves_closed(q: Array) -> tuple[Array, ...]:
    a, _, _ = _abc_closed(q)
    _, _, b_slope, c_slope = _bc_closed(q)
    a_slope = (np.cos(np.sqrt(q)) - a) / (2.0 * q)
    a_curve = -(0.5 * a + 3.0 * a_slope) / (2.0 * q)
    return (0.5 * a_slope - 2.0 * b_slope) / q, -(a_curve + 2.0 * c_slope) / q


def bc_and_slopes(q: Array) -> Array:
    """B, C and their derivatives by q (4, …)."""
    return _piecewise(q, BC_SLOPES, _bc_closed)


def bc_curves(q: Array) -> Array:
    """Second derivatives (2, …) of B and C by q."""
    return _piecewise(q, BC_CURVES, _bc_curves_closed)
