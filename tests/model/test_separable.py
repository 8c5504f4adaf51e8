"""The separable prior's factors and what it says between nodes, against a dense process."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given

from draws import generators, law, poses, sixes
from glissando.geometry import se3
from glissando.model.interpolation import sort_points
from glissando.model.priors import matern
from glissando.model.priors.intervals import RATED
from oracles import dense
from oracles import separable as oracle
from separable_rod import GRID, JOINT, NODES, PRIORS, PSD, SCALE, TWO, moving, process_of, separable
from slope import PLACES, interpolation_slope_test, slope_test


def batches(prior, state, times=slice(0, 3), about=None):
    return list(prior.factors(GRID, state, state if about is None else about, times))


@PRIORS
@pytest.mark.parametrize("seed", range(2))
def test_every_factor_has_its_jacobian_and_names_its_nodes(changes, seed):
    rng = np.random.default_rng(seed)
    state = moving(rng)
    prior = separable(base_pose=state.pose[0, 0] @ se3.exp(sixes(rng, reach=0.1)), **changes)
    found = batches(prior, state)
    assert len(found) == 4  # base and intervals, at the first time and between times
    for i, batch in enumerate(found):

        def moved(step, i=i):
            there = state.retract(step.reshape(*GRID.shape, RATED))
            return batches(prior, there)[i].terms.residual.ravel()

        slope_test(moved, oracle.spread(batch, NODES).reshape(-1, NODES * RATED))


@PRIORS
def test_a_robot_at_rest_costs_nothing(changes):
    prior = separable(base_pose=poses(np.random.default_rng(101)), **changes)
    state = prior.rest_state(GRID)
    for batch in batches(prior, state):
        np.testing.assert_allclose(batch.terms.residual, 0.0, atol=1e-13)


@PRIORS
@pytest.mark.parametrize("cuts", [[1], [2], [1, 2]], ids=str)
def test_factors_of_parts_of_the_time_are_those_of_the_whole(changes, cuts):
    rng = np.random.default_rng(102)
    state, about, prior = moving(rng), moving(rng), separable(**changes)
    edges = [0, *cuts, 3]
    parts = [
        batch
        for start, stop in pairwise(edges)
        for batch in batches(prior, state, slice(start, stop), about)
    ]
    whole = batches(prior, state, slice(0, 3), about)
    found, expected = (oracle.information(b, NODES) for b in (parts, whole))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    found, expected = (
        sorted(float(np.sum(b.terms.cost(b.terms.residual))) for b in each)
        for each in (parts, whole)
    )
    assert sum(found) == pytest.approx(sum(expected), rel=1e-12)
    assert sum(len(b.nodes) for b in parts) == sum(len(b.nodes) for b in whole)


@PRIORS
def test_factors_together_are_the_process_itself_where_strain_is_constant(changes):
    prior = separable(base_pose=poses(np.random.default_rng(103)), **changes)
    state = prior.rest_state(GRID)
    found = np.linalg.inv(oracle.information(batches(prior, state), NODES))
    points = [(s, t) for t in GRID.time for s in GRID.arclength]
    expected = oracle.joint(points, **process_of(changes))
    std = np.sqrt(np.diag(expected))
    gap = np.abs((found - expected) / np.outer(std, std)).max()
    print(f"covariance of the nodes differs by {gap:.1e} of their standard deviations")
    assert gap < 1e-6


@PRIORS
@pytest.mark.parametrize("place", PLACES)
def test_interpolation_has_its_jacobian_and_names_its_nodes(changes, place):
    state = moving(np.random.default_rng(104))
    interpolation_slope_test(separable(**changes), GRID, state, place)


@law
@given(generators)
def test_interpolation_reproduces_the_nodes_and_runs_into_them_from_every_side(rng):
    state, prior, near = moving(rng), separable(**TWO), 1e-7
    for s in (JOINT - near, JOINT, JOINT + near):
        for t in (0.1 - near, 0.1, 0.1 + near):
            (points,) = sort_points(GRID, np.array([s]), np.array([t]))
            found = prior.interpolate(GRID, state, state, points)
            gap = found.state.take(0).difference(replace(state.take((1, 2)), strain_rate=None))
            if s < JOINT:  # the node's strain is the one beyond the joint
                gap[6:12] = 0.0
                found.cov[:, 6:12] = found.cov[:, :, 6:12] = 0.0
            assert np.abs(gap).max() < 1e-3
            assert np.abs(found.cov).max() < 1e-3


def test_what_an_interval_leaves_open_rides_with_the_moving_body():
    """Its velocity errs by the rate of the pose's error and by that error's ride, δ̇ + ad(ϖ) δ."""
    state = moving(np.random.default_rng(106))
    (points,) = sort_points(GRID, np.array([0.15]), np.array([0.1]))
    found = separable().interpolate(GRID, state, state, points)
    strain = 0.5 * (state.strain[1, 1] + state.strain[1, 2])
    near, far = (dense.pair_covariance(strain, h, PSD) for h in (0.05, 0.1))
    open_ = dense.bridge_covariance(near, dense.pair_transition(strain, 0.1), far)
    pose, velocity = found.state.pose[0], found.state.velocity[0]

    def seen(error):
        """Deviation (18,) that a body shows when its pose and strain err by this, and its rates."""
        delta, strain, delta_rate = error[:6], error[6:12], error[12:18]
        wait = 1e-4
        ends = [
            pose @ se3.exp(t * velocity) @ se3.exp(delta + t * delta_rate) for t in (-wait, wait)
        ]
        seen_velocity = se3.log(se3.inverse(ends[0]) @ ends[1]) / (2 * wait)
        return np.concatenate([delta, strain, seen_velocity - velocity])

    step = 1e-4
    slope = [(seen(h) - seen(-h)) / (2 * step) for h in step * np.eye(RATED)]
    into_body = np.stack(slope, axis=1)
    expected = into_body @ np.kron(matern.stationary(SCALE), open_) @ into_body.T
    std = np.sqrt(np.diag(expected))
    gap = np.abs((found.cov[0] - expected) / np.outer(std, std)).max()
    print(f"covariance of the bridge is off by {gap:.1e}")
    assert gap < 1e-6
