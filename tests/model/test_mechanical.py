"""The mechanical prior: slopes, the rod it describes, and what it says between nodes."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from draws import sixes
from glissando.errors import OutsideGridError
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.interpolation import sort_points
from glissando.model.mechanics import Mechanics
from glissando.model.priors.intervals import RATED
from glissando.model.priors.mechanical.intervals import interval_end, interval_error
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.simulation import Loads, Rod, Wrench, solve_shape
from mechanical_rod import GRID, NODES_S, mechanical, moving
from oracles import separable as oracle
from slope import PLACES, interpolation_slope_test, slope_test

NO_POINTS = {"points": np.zeros(0), "var_points": np.zeros((0, 6))}
NODES = GRID.shape[0] * GRID.shape[1]


def unit(prior, grid=GRID):
    """Steps (K, N, 24) of a tenth of a newton or newton-metre in every strain, else of one."""
    where = np.broadcast_to(grid.arclength, grid.shape)
    stiffness = prior.rod.wrench(np.zeros((*grid.shape, 6)), where)[1]
    ones = np.ones_like(stiffness)
    return np.concatenate([ones, 0.1 / stiffness, ones, 0.1 / stiffness], axis=-1)


def batches(prior, state, about=None, times=slice(0, 3)):
    return list(prior.factors(GRID, state, state if about is None else about, times))


@pytest.mark.parametrize("seed", range(2))
def test_every_factor_has_its_jacobian_and_names_its_nodes(seed):
    rng, prior = np.random.default_rng(seed), mechanical()
    state, scale = moving(rng, prior), unit(prior)
    found = batches(prior, state)
    assert len(found) == 6  # base, tip and intervals, at the first time and between times
    for i, batch in enumerate(found):
        unit_of = 1e-2 if batch.terms.residual.shape[1] == 12 else 1.0  # N: strain has 16 digits

        def moved(step, i=i, unit_of=unit_of):
            there = state.retract(scale * step.reshape(scale.shape))
            return unit_of * batches(prior, there)[i].terms.residual.ravel()

        slope = unit_of * oracle.spread(batch, NODES).reshape(-1, NODES * RATED)
        slope_test(moved, slope * scale.ravel())


def test_static_factors_are_those_of_a_single_moment_without_rates():
    rng, prior = np.random.default_rng(2), mechanical()
    grid = Grid(NODES_S, [0.0])
    state = moving(rng, prior, grid)
    still, moment = (
        list(prior.static_factors(grid, state)),
        list(prior.factors(grid, state, state, slice(0, 1))),
    )
    order = [1, 2, 0]  # base, tip, intervals
    for one, other in zip((still[i] for i in order), moment, strict=True):
        half = one.terms.residual.shape[1]
        np.testing.assert_allclose(one.terms.residual, other.terms.residual[:, :half], rtol=1e-12)
        np.testing.assert_allclose(one.jacobian, other.jacobian[:, :half, :, :12], rtol=1e-12)
        white = other.terms.sqrt_info[:, :half, :half]
        np.testing.assert_allclose(one.terms.sqrt_info, white, rtol=1e-9)


def test_a_robot_that_hangs_under_its_weight_costs_nothing():
    prior = mechanical(base_pose=se3.exp(sixes(np.random.default_rng(3))))
    state = prior.rest_state(GRID)
    for batch in batches(prior, state):
        white = batch.terms.whiten(batch.terms.residual)
        np.testing.assert_allclose(white, 0.0, atol=1e-5)


def test_an_interval_ends_where_its_error_says():
    rng, prior = np.random.default_rng(4), mechanical()
    state, intervals = moving(rng, prior), prior.rod.intervals(NODES_S).take(np.array([1, 3, 4]))
    nodes = [state.take((0, np.array(n))) for n in ([1, 3, 4], [2, 4, 5])]
    error, _ = interval_error(*nodes, intervals)
    again, _ = interval_end(nodes[0], error, intervals)
    np.testing.assert_allclose(again.difference(nodes[1]), 0.0, atol=1e-11)


@pytest.mark.parametrize("nodes", [4, 7, 25])
def test_without_unknown_loads_it_is_the_simulators_rod(nodes):
    rng = np.random.default_rng(5)
    rod = Rod.of_tubes(0.6, [(1.6e-3, 0.0)], young=200e9, poisson=0.33, density=7870.0)
    gravity, tool = np.array([9.0, 0.0, -3.0]), 20e-3
    ends = Wrench(0.6, tool * gravity)
    shape = solve_shape(rod, [], Loads(gravity=gravity, wrenches=[ends]))
    mechanics = Mechanics(
        rod.stiffness[None], np.array([rod.mass_per_length]), gravity=gravity, tip_mass=tool
    )
    none = {"rest_strain": np.array([0, 0, 1.0, 0, 0, 0]), "rest_slope": np.zeros(6),
            **NO_POINTS}  # fmt: skip
    prior = mechanical(mechanics=mechanics, base_pose=np.eye(4), **none)
    grid = Grid(np.sort(np.r_[0.0, 0.6, rng.uniform(0.01, 0.59, nodes - 2)]), [0.0])
    found, expected = prior.rest_state(grid), shape.at(grid.arclength)
    assert np.abs(expected.pose[-1, :2, 3]).max() > 0.1  # well bent
    np.testing.assert_allclose(found.pose[0], expected.pose, atol=5e-4 if nodes == 4 else 5e-6)


@pytest.mark.parametrize("place", PLACES)
def test_interpolation_has_its_jacobian_and_names_its_nodes(place):
    prior = mechanical()
    state = moving(np.random.default_rng(6), prior)
    interpolation_slope_test(prior, GRID, state, place, unit(prior))


def test_a_sections_prior_covariance_is_that_of_all_factors_together():
    prior = mechanical()
    grid = Grid(np.insert(NODES_S, 2, 0.11), [0.0])
    state = prior.rest_state(grid)
    count = grid.arclength.size
    every = list(prior.static_factors(grid, state))
    information = np.zeros((count * 12, count * 12))
    for batch in every:
        spread = np.zeros((*batch.terms.residual.shape, count, 12))
        for row, nodes in enumerate(batch.nodes):
            spread[row][:, nodes] = batch.jacobian[row]
        white = (batch.terms.sqrt_info @ spread.reshape(*spread.shape[:2], -1)).reshape(
            -1, count * 12
        )
        information += white.T @ white
    size = 1.0 / np.sqrt(np.diag(information))
    dense = size * np.linalg.inv(size[:, None] * information * size) * size[:, None]
    coarse = Grid(NODES_S, [0.0])
    there = prior.rest_state(coarse)
    for place, node in ((0.0, 0), (0.11, 2), (0.3, 5), (0.4, 6)):
        s, _ = coarse.locate(np.array([place]), np.zeros(1))
        inside = place == 0.11
        n = s.lower if inside else s.nearest
        [(_, covs)] = prior.sections(coarse, there, np.zeros(1, dtype=int), n, s, inside)
        at = slice(12 * node, 12 * node + 12)
        std = np.sqrt(np.diag(dense[at, at]))
        np.testing.assert_allclose(
            covs[0] / np.outer(std, std), dense[at, at] / np.outer(std, std), atol=1e-4
        )


@pytest.mark.slow
def test_a_column_that_is_about_to_buckle_stands():
    """Its weight is put on by steps where Newton's method fails with all of it."""
    stiffness = np.array([[2.76e4, 2.76e4, 7.35e4, 2.11e-2, 2.11e-2, 1.59e-2]])
    rod = mechanical(rest_strain=STRAIGHT, rest_slope=np.zeros(6), **NO_POINTS)
    gravity = np.array([2.4, 0.0, -9.5])
    heavy = replace(rod, mechanics=Mechanics(stiffness, np.array([0.0379]), gravity=gravity))
    grid = Grid(np.linspace(0.0, 0.7, 11), [0.0])
    shape = heavy.rest_state(grid)
    wrench, _ = heavy.rod.wrench(shape.strain[0], grid.arclength)
    weight = 0.0379 * 0.7 * shape.pose[0, 0, :3, :3].T @ gravity
    np.testing.assert_allclose(wrench[0, :3], weight, atol=1e-7)
    np.testing.assert_allclose(wrench[-1], 0.0, atol=1e-7)


def test_what_is_kept_of_a_rod_is_used_for_those_nodes_alone_and_sent_nowhere():
    """Interpolations of two motions in turns, at few moments and at many, are a fresh prior's."""
    rng, prior = np.random.default_rng(8), mechanical()
    states = [moving(rng, prior) for _ in range(2)]
    times = [np.full(3, 0.5 * sum(GRID.time[:2])), np.repeat(GRID.time[:-1] + 0.01, 3)]
    for state, other in (states, states[::-1], states):
        for when in times:
            where = np.resize(NODES_S[[1, 3, 5]] - 0.01, when.size)
            (points,) = sort_points(GRID, where, when)
            list(prior.factors(GRID, other, other, slice(0, 2)))
            found = prior.interpolate(GRID, state, state, points).cov
            fresh = mechanical().interpolate(GRID, state, state, points).cov
            np.testing.assert_allclose(found, fresh, rtol=1e-9, atol=1e-15)
    assert not [v for v in vars(pickle.loads(pickle.dumps(prior))).values() if isinstance(v, dict)]


@pytest.mark.parametrize("count", [2, 5])
def test_gravity_by_shape_is_of_as_many_shapes_as_there_are(count):
    prior = mechanical()
    gravity = np.tile([0.0, 0.0, -9.81], (count, 1))
    heavy = replace(prior, mechanics=replace(prior.mechanics, gravity=gravity))
    with pytest.raises(OutsideGridError, match=f"given for {count} shapes and there are 3"):
        heavy.rest_state(Grid.apart(NODES_S, 3))
