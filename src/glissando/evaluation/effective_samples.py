"""Effective number of independent samples of correlated series."""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array

_CHANCE = 4.0  # sum of two squared correlations attributed to chance, times the number of values
_LONGEST = 0.9  # longest lag over the length of the series; longer ones have too few pairs


def effective_samples(values: Array) -> float:
    """Effective number of independent samples of a series (M,), from 1 to M.

    Computed from the autocorrelation by the initial positive sequence (Geyer 1992).
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
    """Effective number of independent squares of whitened errors (M, r), from 1 to M.

    With a true covariance the errors have mean zero, so a lasting offset is correlation too; the
    series of squares about its own mean does not show it. Squares of Gaussian errors have the
    squared correlation of the errors, which is summed over lags until it falls to the level of
    chance. Differences between the axes count as far as they exceed chance (Bartlett 1946).
    """
    count, varies = len(white), np.any(white, axis=0)
    if count < 4 or not varies.any():
        return float(max(count, 1))
    white = white[:, varies]
    chance = _CHANCE / white.size
    pooled = _autocorrelation(white) ** 2
    per_axis = np.mean([_autocorrelation(axis[:, None]) ** 2 for axis in white.T], axis=0)
    by_chance = (1.0 - 1.0 / white.shape[1]) * _spread(pooled, chance) / count
    spread = _spread(pooled + np.maximum(per_axis - pooled - by_chance, 0.0), chance)
    return float(np.clip(count / max(spread, 1e-12), 1.0, count))


def _spread(squares: Array, chance: float) -> float:
    """Sum of squared correlations (M,) over lags of both signs, until a pair is below `chance`."""
    count = squares.size
    pairs = squares[0 : count - 1 : 2] + squares[1:count:2]
    over = np.flatnonzero(pairs < chance)
    last = min(2 * int(over[0]) if over.size else count, int(_LONGEST * count))
    pair_share = 1.0 - np.arange(last) / count  # share of pairs at each lag, which biases their sum
    return 2.0 * float(np.sum(squares[:last] / pair_share)) - 1.0


def _autocorrelation(values: Array) -> Array:
    """Correlations (M,) about zero of a series (M, r) at lags 0 to M − 1."""
    count = len(values)
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(values, size, axis=0)
    sums = np.fft.irfft(np.sum(np.abs(spectrum) ** 2, axis=1), size)[:count]
    return np.asarray(sums / sums[0])
