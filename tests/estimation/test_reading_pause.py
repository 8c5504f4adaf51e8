"""Pauses: belief grows, saturates, claims no more than is true, and takes true readings back."""

from copy import deepcopy

import numpy as np
import pytest
from scipy.stats import chi2

import separable_sessions as drawn
from glissando import (
    BaseVariance,
    PoseReadings,
    SeparablePrior,
    load_robot,
)
from glissando.errors import FalseConfidenceWarning, OutsideGridError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.geometry import se3
from glissando.io.shipped_robots import shipped_robots
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
