"""The square root of a chain's information: its square is what the normal equations hold."""

import numpy as np
import pytest

from glissando import Grid, load_robot
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate
from glissando.solver.normal_equations import system_shape
from glissando.solver.square_root import root_information


def of_rest(prior, grid):
    """Square root and normal equations of a prior about rest."""
    rest = prior.rest_state(grid)
    factors = prior.factors(grid, rest, rest, slice(0, grid.time.size))
    workspace = np.empty(system_shape(grid.time.size, rest.numbers))
    equations = linearize(prior, locate(grid, []), rest, rest, workspace)
    return root_information(factors, grid.shape, rest.dof), equations.system


@pytest.mark.parametrize("name", ["tdcr466", "tdcr466-segments"])
def test_its_square_is_the_information_of_the_normal_equations(name):
    robot = load_robot(name)
    root, system = of_rest(robot.prior, Grid([0.0, 0.233, 0.466], np.arange(4) / 30.0))
    over, beside = root.diagonal, root.beside
    square = np.swapaxes(over, 1, 2) @ over
    square[1:] += np.swapaxes(beside, 1, 2) @ beside
    across = np.swapaxes(beside, 1, 2) @ over[:-1]
    scale = np.sqrt(np.einsum("kii->ki", system.diagonal))
    assert np.abs((square - system.diagonal) / (scale[:, :, None] * scale[:, None])).max() < 1e-9
    apart = (across - system.lower) / (scale[1:, :, None] * scale[:-1, None])
    assert np.abs(apart).max() < 1e-9


@pytest.mark.slow
def test_draws_have_the_variance_that_the_prior_states_at_the_base():
    prior = load_robot("tdcr466-segments").prior
    grid = Grid(np.linspace(0.0, 0.466, 17), np.arange(25) / 120.0)
    root, _ = of_rest(prior, grid)
    rng = np.random.default_rng(0)
    draws = [root.sample(rng).reshape(*grid.shape, 24)[:, 0, :12] for _ in range(300)]
    ratio = np.var(draws, axis=0)[[0, -1]] / np.concatenate([prior.base.pose, prior.base.strain])
    assert np.all((ratio > 0.7) & (ratio < 1.4))
