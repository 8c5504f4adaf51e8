"""Quantiles of the laws that confidence is judged by; scipy.stats would take a second to import."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import bdtr, bdtrik, gammaincc, gammainccinv, gammaincinv

_LEAST = 1e-290  # chance that has all its digits


def chi_square_quantile(probability: ArrayLike, dof: ArrayLike) -> Any:
    """What a sum of `dof` squared standard normals stays below with a probability."""
    return 2.0 * gammaincinv(0.5 * np.asarray(dof), probability)


def chi_square_exceedance(chance: ArrayLike, dof: ArrayLike) -> Any:
    """What a sum of `dof` squared standard normals exceeds with a small chance."""
    return 2.0 * gammainccinv(0.5 * np.asarray(dof), chance)


def chi_square_of(values: ArrayLike, dof: ArrayLike, other: int) -> Any:
    """Sums of `dof` squared standard normals as sums of `other` ones that are as rare."""
    if dof == other:
        return np.asarray(values)
    chance = gammaincc(0.5 * np.asarray(dof), 0.5 * np.asarray(values))
    alike = chi_square_exceedance(chance, other)
    return np.where(chance > _LEAST, alike, values)  # where rarer, the two differ by little


def binomial_quantile(probability: ArrayLike, count: int, chance: ArrayLike) -> Any:
    """The least number of successes that `count` trials stay at or below with a probability."""
    above = np.ceil(bdtrik(probability, count, chance))
    below = np.maximum(above - 1.0, 0.0)
    return np.where(bdtr(below, count, chance) >= probability, below, above)
