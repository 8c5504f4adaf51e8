"""Belief too wide to be linear: that of shapes and of their velocities, narrowed where it winds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

import separable_sessions as drawn
from draws import generators, law
from glissando import (
    BaseVariance,
    PoseReadings,
    SeparablePrior,
    load_robot,
)
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.shape_spread import shape_covariances
from glissando.evaluation.prior_predictive import PriorPredictive
from glissando.io.shipped_robots import shipped_robots
from glissando.model.grid import Grid
from separable_drawn import draw_motion

STEP = 1.0 / 30.0


@settings(law, max_examples=5)
@given(generators)
def test_a_narrow_belief_spreads_as_its_own_covariance(rng):
    node = drawn.PRIOR.rest_state(Grid(drawn.GRID.arclength, [0.0])).take(0)
    size = node.numbers
    root = 1e-4 * rng.standard_normal((size, size))
    cov = root @ root.T / size + 1e-10 * np.eye(size)
    own = cov.reshape(len(node.pose), node.dof, len(node.pose), node.dof)
    spread = shape_covariances(drawn.GRID.arclength, node, cov)
    for n, found in enumerate(spread):
        std = np.sqrt(np.diagonal(found))
        np.testing.assert_allclose(std, np.sqrt(np.diagonal(own[n, :18, n, :18])), rtol=1e-2)


def test_the_spread_at_rest_is_that_of_motions_drawn_from_the_prior():
    smoother = FixedLagSmoother(drawn.PRIOR, drawn.GRID.arclength)
    found = smoother.advance(0.0)
    rng, errors = np.random.default_rng(5), []
    for _ in range(400):
        pose, _, velocity = draw_motion(
            rng,
            drawn.GRID.arclength,
            [0.0],
            psd=drawn.PSD,
            base_pose_var=drawn.BASE.pose,
            base_strain_var=drawn.BASE.strain,
            time_scale=drawn.TIME_SCALE,
            rest_strain=drawn.PRIOR.rest_strain,
        )[:3]
        moved = pose[0, :, :3, 3] - found.position
        errors.append(np.hstack([moved, velocity[0] - found.velocity]))
    seen = np.einsum("mni,mnj->nij", errors, errors) / len(errors)
    for n in range(1, len(found.position)):
        stated = found.cov_position_world[n], found.cov[n, 12:15, 12:15], found.cov[n, 15:18, 15:18]
        for cov, rows in zip(stated, (slice(0, 3), slice(3, 6), slice(6, 9)), strict=True):
            ratio = np.linalg.eigvals(np.linalg.solve(cov, seen[n, rows, rows])).real
            assert np.all((ratio > 0.75) & (ratio < 1.3))


def test_the_spread_of_nodes_that_turn_by_less_than_half_a_turn_is_that_of_the_prior():
    """The tip turns by 5 rad (RMS). The middle's squared error was twice what was stated."""
    robot = load_robot("tdcr466-segments")
    found = FixedLagSmoother(robot.prior, robot.arclength_nodes).advance(0.0)
    grid = Grid(robot.arclength_nodes, [0.0])
    blank = PoseReadings(time=[0.0], arclength=[0.0], values=np.eye(4)[None], cov=1e-6)
    predictive = PriorPredictive(robot, grid, [blank])
    rows = np.abs(predictive.fine.arclength[:, None] - grid.arclength).argmin(axis=0)
    draws = [
        predictive.draw(np.random.default_rng([1, k])).truth.take((0, rows)) for k in range(400)
    ]
    off = np.array([d.pose[:, :3, 3] for d in draws]) - found.position
    for n in (1, 2):
        squares = np.einsum(
            "mi,ij,mj->m", off[:, n], np.linalg.inv(found.cov_position_world[n]), off[:, n]
        )
        assert 0.8 < squares.mean() / 3.0 < 1.25


def soft_shapes(rng, length, psd, count=300, steps=280):
    """Positions (steps + 1, count, 3) along bodies whose curvature is a random walk."""
    h, turn = length / steps, Rotation.identity(count)
    bend, position = np.sqrt(psd) * rng.standard_normal((count, 3)), [np.zeros((count, 3))]
    for _ in range(steps):
        along = (turn * Rotation.from_rotvec(0.5 * h * bend)).apply([0.0, 0.0, 1.0])
        position.append(position[-1] + h * along)
        turn = turn * Rotation.from_rotvec(h * bend)
        bend = bend + np.sqrt(h * psd) * rng.standard_normal((count, 3))
    return np.array(position)


@settings(law, max_examples=4)
@given(generators)
def test_however_soft_a_body_is_each_of_its_nodes_is_as_uncertain_as_its_shapes_differ(rng):
    """Narrowed in steps of two, a node was up to twice as sure as one that may point anywhere."""
    length, nodes, stiff = 0.4, np.linspace(0.0, 0.4, 15), np.repeat(1e-6, 3)
    psd = np.repeat(10.0 ** rng.uniform(1.5, 6.0), 3)
    prior = SeparablePrior(
        np.append(stiff, psd),
        0.5,
        BaseVariance(np.repeat([1e-8, 1e-6], 3), np.append(stiff, psd)),
    )
    found = FixedLagSmoother(prior, nodes).advance(0.0)
    off = soft_shapes(rng, length, psd)[::20] - found.position[:, None]
    squares = np.einsum(
        "nmi,nij,nmj->nm", off[1:], np.linalg.inv(found.cov_position_world[1:]), off[1:]
    )
    assert np.all(squares.mean(axis=1) / 3.0 < 1.3)
    assert np.all(np.diff(found.std_position) > 0.0)


@settings(law, max_examples=10)
@given(generators)
def test_a_base_of_unknown_direction_stands_where_its_file_states(rng):
    robot = load_robot("tdcr466-segments")
    var = np.repeat(10.0 ** rng.uniform([-4.0, -2.0], [-2.0, 4.0]), 3)
    prior = replace(robot.prior, base=BaseVariance(var, robot.prior.base.strain))
    found = FixedLagSmoother(prior, robot.arclength_nodes).advance(0.0)
    np.testing.assert_allclose(np.diagonal(found.cov[0])[:3], var[:3], rtol=2e-2)
    assert np.all(np.diagonal(found.cov[0])[3:6] < np.pi**2)


@pytest.mark.parametrize("name", shipped_robots())
def test_the_base_at_rest_is_as_sure_as_its_file_states_at_any_time(name):
    """The share by which a tip is kept from winding up made the base as much surer."""
    robot = load_robot(name)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    for now in np.arange(3.0) * STEP:
        smoother.advance(now)
        state, cov, _ = smoother.newest_node()
        found = smoother.newest().cov
        np.testing.assert_allclose(np.diagonal(found[0])[:6], np.diagonal(cov)[:6], rtol=2e-2)
        np.testing.assert_array_equal(found, shape_covariances(robot.arclength_nodes, state, cov))
        found[:] = 0.0  # the caller's own
