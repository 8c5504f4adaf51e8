"""Pauses: belief grows, saturates, claims no more than is true, and takes true readings back."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import separable_sessions as drawn
from draws import generators, law
from glissando import (
    BaseVariance,
    PoseReadings,
    SeparablePrior,
    load_robot,
)
from glissando.errors import FalseConfidenceWarning, OutsideGridError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.shape_spread import shape_covariances
from glissando.evaluation.prior_predictive import PriorPredictive
from glissando.geometry import se3
from glissando.io.shipped_robots import shipped_robots
from glissando.model.grid import Grid
from separable_drawn import draw_motion
from tip_coil import coil, tip

PAUSES = (0.3, 1.0, 10.0, 100.0, 1000.0, 10_000.0, 86_400.0)
STEP = 1.0 / 30.0
LIMIT = chi2.ppf(1.0 - 1e-6, 3)


@pytest.mark.parametrize("name", shipped_robots())
@pytest.mark.parametrize("pause", [60.0, 3600.0])
def test_a_silence_after_the_first_update_is_one_as_well(name, pause):
    """Nothing says yet how often the robot is read: a single step would make it sure of rest."""
    robot, rng = load_robot(name), np.random.default_rng(0)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    rest = smoother.advance(-10.0)
    smoother.add(coil(rng, 0.0, tip(robot.length, 1e-3, 0.0), robot.length))
    smoother.advance(0.0)
    quiet = smoother.advance(pause - 1.0)
    assert quiet.std_position[-1] > 0.7 * rest.std_position[-1]
    bent = tip(robot.length, 1.0 / robot.length, 0.5)
    smoother.add(coil(rng, pause, bent, robot.length))
    found = smoother.advance(pause)
    assert np.linalg.norm(found.position[-1] - bent[:3, 3]) < 0.01


def squared(estimate, pose):
    """Squared errors of position and rotation of the tip in units of their covariances."""
    turn = estimate.pose[-1, :3, :3]
    errors = turn.T @ (pose[:3, 3] - estimate.position[-1]), se3.so3_log(turn.T @ pose[:3, :3])
    covs = estimate.cov[-1, :3, :3], estimate.cov[-1, 3:6, 3:6]
    return [float(e @ np.linalg.solve(c, e)) for e, c in zip(errors, covs, strict=True)]


def heard_for_a_second(robot, seed):
    """A smoother that has read the tip of an arc for a second, the arc's pose, and the draws."""
    rng = np.random.default_rng(seed)
    pose = tip(robot.length, rng.uniform(0.2, 1.0) / robot.length, rng.uniform(0.0, 6.0))
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    for time in STEP * np.arange(30):
        smoother.add(coil(rng, time, pose, robot.length))
        newest = smoother.advance(time)
    assert max(squared(newest, pose)) < LIMIT
    return smoother, pose, rng


SLOW = "extensible1m"  # 19 nodes
ROBOTS = [pytest.param(n, marks=[pytest.mark.slow] * (n == SLOW)) for n in shipped_robots()]


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_after_any_pause_what_is_claimed_is_true_and_true_readings_are_taken_at_once(name):
    robot = load_robot(name)
    heard, still, rng = heard_for_a_second(robot, 1)
    spread = []
    for pause in PAUSES:
        smoother, begin = deepcopy(heard), heard.time + pause
        silent = smoother.advance(begin)
        spread.append(silent.std_position[-1])
        pose = still
        if pause >= 100.0:  # by then it may be anywhere
            pose = tip(robot.length, rng.uniform(0.2, 1.5) / robot.length, rng.uniform(0.0, 6.0))
        assert max(squared(silent, pose)) < LIMIT
        for k in range(1, 6):
            smoother.add(coil(rng, begin + k * STEP, pose, robot.length))
            assert max(squared(smoother.advance(begin + k * STEP), pose)) < LIMIT
        assert not smoother.dropped
    assert np.all(np.diff(spread) >= -0.05 * np.array(spread[1:]))
    assert np.ptp(spread[-3:]) < 1e-9
    assert 0.2 * robot.length < spread[-1] < 2.0 * robot.length


@pytest.mark.parametrize("pause", [0.3, 0.6, 1.0, 1.6, 2.2, 4.0])
def test_a_reading_taken_just_before_the_time_asked_for_ends_a_pause(pause):
    """No node is put at it: the prior has no digits for two that close to each other."""
    spread = np.repeat([1e-8, 4.0], 3)
    prior = SeparablePrior(spread, 0.5, BaseVariance(np.repeat([1e-8, 1e-6], 3), spread))
    smoother, rng = FixedLagSmoother(prior, np.linspace(0.0, 0.4, 5)), np.random.default_rng(0)
    for now in [*np.arange(0.0, 1.001, 0.025), 1.0 + pause]:
        smoother.add(coil(rng, now - 1e-3, tip(0.4, 1e-3, 0.0), 0.4))
        newest = smoother.advance(now)
    assert smoother.time == 1.0 + pause
    assert newest.std_position[-1] < 0.02


@pytest.mark.parametrize("name", ["tdcr466", "tdcr466-segments"])
def test_what_is_predicted_is_known_the_less_the_farther_ahead_it_lies(name):
    robot = load_robot(name)
    heard, *_ = heard_for_a_second(robot, 3)
    before, ahead = heard.posterior(), np.array([0.0, 0.05, 0.2, 1.0, 5.0, 30.0, 300.0])
    spread = np.array([heard.at(robot.length, heard.time + t).std_position for t in ahead])
    assert np.all(np.diff(spread) > -1e-9)
    together = heard.at(robot.length, heard.time + ahead)  # also where some are at rest by then
    np.testing.assert_allclose(together.std_position[4:], spread[4:])
    np.testing.assert_array_equal(heard.posterior().state.pose, before.state.pose)
    with pytest.raises(OutsideGridError, match="finite"):
        heard.at(robot.length, np.nan)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdcr466", "tdcr466-segments"])
def test_a_pause_may_be_passed_at_once_or_in_any_steps(name):
    robot = load_robot(name)
    heard, *_ = heard_for_a_second(robot, 2)
    for pause in (0.1, 0.3, 2.0):
        found = []
        for steps in ([1.0], np.linspace(0.2, 1.0, 5), np.arange(1, 1 + round(pause / STEP))):
            smoother = deepcopy(heard)
            last = steps[-1]
            for share in np.asarray(steps) / last:
                newest = smoother.advance(heard.time + share * pause)
            found.append(newest.std_position[-1])
        print(f"{name} {pause:g} s: {np.round(found, 4)} m")
        np.testing.assert_allclose(found, found[-1], rtol=0.15)


@pytest.mark.parametrize("silent", [0.0, 4.0, 20.0])
def test_the_newest_state_is_the_same_by_whatever_way_it_is_asked_for(silent):
    """Also after silence, where belief is that of shapes and a tangent space reaches for metres."""
    robot = load_robot("sliding700")
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    pose = np.eye(4)[None].copy()
    pose[0, 2, 3] = robot.length
    for time in (0.0, 0.1, 0.2):
        read = {"time": [time], "arclength": [robot.length], "values": pose, "name": "tip"}
        smoother.add(PoseReadings(cov=np.repeat([1e-6, 1e-4], 3), **read))
        smoother.advance(time)
    newest = smoother.advance(0.2 + silent)
    nodes, time = robot.arclength_nodes, smoother.time
    np.testing.assert_allclose(smoother.at(nodes, time).cov, newest.cov, rtol=1e-9, atol=1e-15)
    middle = smoother.at(0.5 * (nodes[1:] + nodes[:-1]), time).std_position
    assert np.all(middle < 1.01 * robot.length)
    if silent:
        assert np.all(middle <= np.maximum(newest.std_position[1:], newest.std_position[:-1]))


def test_readings_that_come_with_the_end_of_the_pause_are_used_at_once():
    """A loop that stood still adds before it advances; stamps then lie far ahead of the window."""
    robot = load_robot("tdcr466")
    smoother, pose, rng = heard_for_a_second(robot, 3)
    end = smoother.time + 500.0
    for time in end - STEP * np.array([2.5, 1.5, 0.5]):
        smoother.add(coil(rng, time, pose, robot.length))
    assert max(squared(smoother.advance(end), pose)) < LIMIT
    assert not smoother.dropped
    assert smoother.newest().std_position[-1] < 0.05 * robot.length


@pytest.mark.parametrize("name", ["tdcr466", "sliding700", "tdcr466-segments"])
def test_a_robot_at_rest_is_predicted_as_well_at_any_time(name):
    """One step over all that time once said ± 3 m after 10 ms and ± 0.1 mm after a million s."""
    robot = load_robot(name)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=4)
    smoother.advance(0.0)
    smoother.advance(0.001)  # too close for a node of its own
    place = 0.5 * robot.length
    known = smoother.at(place, 0.001).std_position
    ahead = smoother.at(np.full(3, place), [0.01, 10.0, 1e6])
    np.testing.assert_allclose(ahead.std_position, known)
    assert smoother.at(place, 10.0).pose.shape == (4, 4)
    smoother.add(
        PoseReadings(
            time=[0.1],
            arclength=[robot.length],
            cov=1e-6,
            values=robot.prior.rest_state(robot.grid(0.0, 1.0)).pose[0, -1:],
        )
    )
    smoother.advance(0.1)
    far = smoother.at(np.full(2, place), [1e4, 1e5])
    smoother.advance(1e4)
    np.testing.assert_allclose(far.std_position, smoother.at(place, 1e4).std_position)


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


def errors_around_a_pause(rng, pause):
    """Squared errors (3, 2) of the tip before, during and after a pause of a drawn motion."""
    arclength = np.linspace(0.0, drawn.LENGTH, 21)
    before = np.arange(0.0, 1.001, 0.1)
    time = np.concatenate([before, 1.0 + pause + np.arange(0.0, 0.21, 0.1)])
    motion = draw_motion(
        rng,
        arclength,
        time,
        psd=drawn.PSD,
        base_pose_var=drawn.BASE.pose,
        base_strain_var=drawn.BASE.strain,
        time_scale=drawn.TIME_SCALE,
        rest_strain=drawn.PRIOR.rest_strain,
    )[0]
    cov = np.array([1e-6] * 3 + [1e-4] * 3)
    smoother, found = FixedLagSmoother(drawn.PRIOR, drawn.GRID.arclength), []
    for k, now in enumerate(time):
        if k != before.size:  # what is read at the end of the pause comes an update later
            for name, n in (("tip", 20), ("middle", 10)):
                noise = np.sqrt(cov) * rng.standard_normal(6)
                reading = PoseReadings(
                    time=np.full(1, now),
                    arclength=arclength[n : n + 1],
                    values=(motion[k, n] @ se3.exp(noise))[None],
                    cov=cov,
                    name=name,
                )
                smoother.add(reading)
        newest = smoother.advance(now)
        if k in (before.size - 1, before.size, before.size + 1):
            found.append(squared(newest, motion[k, -1]))
    assert not smoother.dropped
    return found


@pytest.mark.slow
@pytest.mark.parametrize("pause", [0.5, 100.0])
def test_errors_before_during_and_after_a_pause_are_as_large_as_claimed(pause):
    rng = np.random.default_rng(6)
    nees = np.array([errors_around_a_pause(rng, pause) for _ in range(30)]).mean(axis=0) / 3.0
    low, high = chi2.ppf([0.5e-3, 1 - 0.5e-3], 90) / 90
    print(f"pause {pause:g} s: {nees.round(2).tolist()} in [{low:.2f}, {high:.2f}]")
    assert np.all((low < nees) & (nees < high))


def test_times_in_milliseconds_are_said_to_be_once():
    robot, rng = load_robot("tdcr466"), np.random.default_rng(0)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    pose = tip(robot.length, 1.0, 0.0)

    def live():
        for k in range(25):
            smoother.add(coil(rng, 33.3 * k, pose, robot.length))
            smoother.advance(33.3 * k)

    with pytest.warns(FalseConfidenceWarning, match="in seconds, not milliseconds") as said:
        live()
    assert len(said) == 1
