"""How many independent samples correlated ones are worth."""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array

_CHANCE = 4.0  # over the number of values: what squares of two correlations sum to by chance
_LONGEST = 0.9  # of the series: lags beyond are of too few pairs


def effective_samples(values: Array) -> float:
    """Number of independent samples that a series (M,) is worth, from 1 to M.

    From its autocorrelation, by the initial positive sequence (Geyer 1992).
    """
    count = values.size
    centred = values - values.mean()
    if count < 4 or not np.any(np.abs(centred) > 1e-12 * (1.0 + np.abs(values).max())):
        return 1.0
    rho = _autocorrelation(centred[:, None])
    pairs = rho[0 : count - 1 : 2] + rho[1:count:2]
    negative = np.flatnonzero(pairs <= 0.0)
    positive = pairs[: negative[0]] if negative.size else pairs
    return float(np.clip(count / max(2.0 * positive.sum() - 1.0, 1e-12), 1.0, count))


def effective_errors(white: Array) -> float:
    """Number of independent squares that whitened errors (M, r) are worth, from 1 to M.

    True confidence has them vary about zero, so one that lasts is correlation as well, which a
    series of their squares about its own mean does not show. Squares of Gaussian errors correlate
    by the square of what the errors do, and count until that is what chance makes of none.
    """
    count, rows = white.shape
    if count < 4 or not np.any(white):
        return float(max(count, 1))
    squares = _autocorrelation(white) ** 2
    pairs = squares[0 : count - 1 : 2] + squares[1:count:2]
    none = np.flatnonzero(pairs < _CHANCE / (count * rows))
    last = min(2 * int(none[0]) if none.size else count, int(_LONGEST * count))
    left = 1.0 - np.arange(last) / count  # of the pairs, and of their sum
    spread = 2.0 * float(np.sum(squares[:last] / left)) - 1.0
    return float(np.clip(count / max(spread, 1e-12), 1.0, count))


def _autocorrelation(values: Array) -> Array:
    """Correlations (M,) about zero, by lag, of a series (M, r)."""
    count = len(values)
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(values, size, axis=0)
    sums = np.fft.irfft(np.sum(np.abs(spectrum) ** 2, axis=1), size)[:count]
    return np.asarray(sums / sums[0])
