"""Quantiles of χ² and binomial distributions; importing scipy.stats would take a second."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import bdtr, bdtrik, gammaincc, gammainccinv, gammaincinv

_LEAST = 1e-290  # smallest probability computed to full precision


def chi_square_quantile(probability: ArrayLike, dof: ArrayLike) -> Any:
    """Quantile of the χ² distribution with `dof` degrees of freedom at a probability."""
    return 2.0 * gammaincinv(0.5 * np.asarray(dof), probability)


def chi_square_exceedance(chance: ArrayLike, dof: ArrayLike) -> Any:
    """Value that a χ² variable of `dof` degrees of freedom exceeds with a small probability."""
    return 2.0 * gammainccinv(0.5 * np.asarray(dof), chance)


def chi_square_of(values: ArrayLike, dof: ArrayLike, other: int) -> Any:
    """Map χ² values of `dof` degrees of freedom to equally improbable ones of `other` degrees."""
    if dof == other:
        return np.asarray(values)
    chance = gammaincc(0.5 * np.asarray(dof), 0.5 * np.asarray(values))
    alike = chi_square_exceedance(chance, other)
    return np.where(chance > _LEAST, alike, values)  # farther out the two differ by little


def binomial_quantile(probability: ArrayLike, count: int, chance: ArrayLike) -> Any:
    """Quantile of the number of successes in `count` trials, each of probability `chance`."""
    above = np.ceil(bdtrik(probability, count, chance))
    below = np.maximum(above - 1.0, 0.0)
    return np.where(bdtr(below, count, chance) >= probability, below, above)
