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
    by the square of what the errors do, and count until that is what chance makes of none. By how
    much axes differ in that counts as far as it is more than chance (Bartlett 1946).
    """
    count, varies = len(white), np.any(white, axis=0)
    if count < 4 or not varies.any():
        return float(max(count, 1))
    white = white[:, varies]
    none = _CHANCE / white.size
    together = _autocorrelation(white) ** 2
    each = np.mean([_autocorrelation(axis[:, None]) ** 2 for axis in white.T], axis=0)
    by_chance = (1.0 - 1.0 / white.shape[1]) * _spread(together, none) / count
    spread = _spread(together + np.maximum(each - together - by_chance, 0.0), none)
    return float(np.clip(count / max(spread, 1e-12), 1.0, count))


def _spread(squares: Array, none: float) -> float:
    """Sum of squared correlations (M,) at all lags of both signs, until a pair is that of none."""
    count = squares.size
    pairs = squares[0 : count - 1 : 2] + squares[1:count:2]
    over = np.flatnonzero(pairs < none)
    last = min(2 * int(over[0]) if over.size else count, int(_LONGEST * count))
    left = 1.0 - np.arange(last) / count  # of the pairs, and of their sum
    return 2.0 * float(np.sum(squares[:last] / left)) - 1.0


def _autocorrelation(values: Array) -> Array:
    """Correlations (M,) about zero, by lag, of a series (M, r)."""
    count = len(values)
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(values, size, axis=0)
    sums = np.fft.irfft(np.sum(np.abs(spectrum) ** 2, axis=1), size)[:count]
    return np.asarray(sums / sums[0])
