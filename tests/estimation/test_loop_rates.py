"""A control loop may ask more often than sensors read: belief stays what was read."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import separable_sessions
from draws import law
from glissando import CoilReadings, FixedLagSmoother, load_robot, se3

BEND = np.array([0.0, 0.0, 1.0, 0.0, 2.0, 0.0])  # strain of the shape, which holds still
STD = np.repeat([7e-4, 6e-3], [3, 2])
READ = 40.0  # Hz


def told_by_a_loop(name, rate, seconds=1.0, off=0.0):
    """The smoother and the states at the times of readings, of a loop at a rate in Hz.

    Readings of a coil at the tip are stamped `off` s beside these times.
    """
    robot, rng, states, number = load_robot(name), np.random.default_rng(0), [], 0
    nodes = robot.arclength_nodes
    smoother = FixedLagSmoother(
        robot.prior,
        nodes if nodes.size < 10 else nodes[::3],  # along the rod, how many do not matter here
        window=4,
        sensor_parameters=robot.sensor_parameters,
    )
    tip = se3.exp(robot.length * BEND)
    for k in range(round(seconds * rate) + 1):
        read = number / READ <= k / rate + 1e-9
        if read:
            noise = se3.exp(np.append(STD * rng.standard_normal(5), 0.0))
            at = {"time": [number / READ + off], "arclength": [robot.length]}
            smoother.add(CoilReadings(**at, values=[tip @ noise], cov=STD**2, name="coil"))
            number += 1
        state = smoother.advance(k / rate)
        if read:
            states.append(state)
    return smoother, states


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdcr466", "tdcr466-segments", "sliding700", "extensible1m"])
def test_belief_after_a_reading_does_not_depend_on_how_often_is_asked(name):
    """The roll of a coil that holds still is never read, and is no reason to begin anew."""
    _, usual = told_by_a_loop(name, READ)
    for rate in (100.0, 1000.0):
        smoother, states = told_by_a_loop(name, rate)
        assert smoother.restarts == 0
        assert sum(sum(why.values()) for why in smoother.dropped.values()) == 0
        tip = se3.exp(load_robot(name).length * BEND)[:3, 3]
        if rate < 1000.0:  # every reading is of a time of the loop, and of a node
            ratio = states[-1].std_position[1:] / usual[-1].std_position[1:]
            assert np.all((ratio > 0.5) & (ratio < 2.0))
            assert np.linalg.norm(states[-1].position[-1] - tip) < 4e-3
        assert np.linalg.norm(smoother.newest().position[-1] - tip) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdcr466", "tdcr466-segments"])
@pytest.mark.parametrize("off", [-1e-12, -2e-12, 1e-13])
def test_a_reading_a_hair_beside_a_node_is_read_there(name, off):
    """Stamps that add up differ from the loop's by rounding; those before were lost."""
    exact, _ = told_by_a_loop(name, 200.0, 0.6125)
    beside, _ = told_by_a_loop(name, 200.0, 0.6125, off)
    assert beside.restarts == 0
    np.testing.assert_allclose(
        beside.newest().std_position[1:], exact.newest().std_position[1:], rtol=0.05
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdcr466", "sliding700"])
def test_going_on_in_silence_makes_belief_no_wider_than_was_predicted(name):
    smoother, _ = told_by_a_loop(name, READ)
    length = float(smoother.arclength[-1])
    for ahead in (1e-3, 5e-3, 0.02):
        predicted = smoother.at(length, 1.0 + ahead).std_position
        state = smoother.advance(1.0 + ahead)
        assert state.std_position[-1] < 1.3 * predicted  # it jumped twentyfold
        assert smoother.at(length, 1.0 + ahead).std_position == pytest.approx(
            state.std_position[-1], rel=1e-9
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdcr466", "tdcr466-segments"])
@pytest.mark.parametrize("begin", [0.0, 1.7e9])  # as time.time() counts, to 2e-7 s
@pytest.mark.parametrize(("rate", "every"), [(400.0, 1), (500.0, 1), (1000.0, 5), (2000.0, 1)])
def test_a_loop_faster_than_nodes_may_follow_each_other_is_answered(name, begin, rate, every):
    robot = load_robot(name)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=4)
    tip, rng = se3.exp(robot.length * BEND), np.random.default_rng(1)
    for k in range(120):
        time = begin + k / rate
        if k % every == 0:
            noise = se3.exp(np.append(STD * rng.standard_normal(5), 0.0))
            at = {"time": [time], "arclength": [robot.length], "values": [tip @ noise]}
            smoother.add(CoilReadings(**at, cov=STD**2, name="coil"))
        state = smoother.advance(time)
    assert np.linalg.norm(state.position[-1] - tip[:3, 3]) < 5.0 * state.std_position[-1]


@law
@given(scale=st.floats(0.1, 1e4))
def test_every_time_scale_of_a_prior_runs_in_a_loop(scale):
    """A robot whose errors last for minutes is told of at any rate, as one that forgets at once."""
    prior = replace(separable_sessions.PRIOR, time_scale=scale)
    nodes = np.linspace(0.0, separable_sessions.LENGTH, 3)
    FixedLagSmoother(prior, nodes)
