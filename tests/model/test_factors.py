"""A state far off costs infinitely much, without a warning."""

import numpy as np

from glissando.model.factors import Residuals


def test_a_residual_beyond_all_numbers_costs_infinitely_much():
    residual = np.full((2, 3), 1e200)
    terms = Residuals(residual, np.broadcast_to(np.eye(3), (2, 3, 3)))
    assert terms.cost(residual) == np.inf
