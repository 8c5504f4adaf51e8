"""Quantiles agree with those of scipy's distributions."""

import numpy as np
import pytest
from scipy.stats import binom, chi2

from glissando.model.quantiles import (
    binomial_quantile,
    chi_square_exceedance,
    chi_square_quantile,
)


@pytest.mark.parametrize("dof", [1, 3, 6.5, 400])
def test_quantiles_of_squares_are_those_of_the_distribution(dof):
    chance = np.array([1e-9, 0.025, 0.5, 0.975])
    np.testing.assert_allclose(chi_square_quantile(chance, dof), chi2.ppf(chance, dof), rtol=1e-9)
    np.testing.assert_allclose(chi_square_exceedance(chance, dof), chi2.isf(chance, dof), rtol=1e-9)


def test_quantiles_of_counts_are_those_of_the_distribution():
    for count in (1, 7, 250):
        for chance in (0.05, 0.95):
            for probability in (0.0, 0.025, 0.5, 0.975, 1.0):
                expected = max(binom.ppf(probability, count, chance), 0.0)
                assert binomial_quantile(probability, count, chance) == expected
