"""A base that stays where it is: its mean over a long time is no surer than its clamp."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import Grid, PoseReadings, estimate
from glissando.errors import RobotFileError
from glissando.io.robot_file import parse_robot
from glissando.model.table import Table
from separable_sessions import PRIOR


def base_std(prior, seconds):
    """Standard deviation of the base's mean x over a time, without any reading."""
    grid = Grid([0.0, 0.5], np.linspace(0.0, seconds, round(8 * seconds) + 1))
    posterior = estimate(prior, grid, [])
    return posterior.sample(np.random.default_rng(1), 400).pose[:, :, 0, 0, 3].mean(axis=1).std()


def test_the_mean_of_a_base_that_stays_is_as_unsure_as_the_base():
    std = float(np.sqrt(PRIOR.base.pose[0]))
    restless, stays = base_std(PRIOR, 8.0), base_std(replace(PRIOR, base_time_scale=20.0), 8.0)
    assert restless < 0.6 * std
    assert 0.8 * std < stays < 1.15 * std


def test_with_the_shapes_own_time_scale_nothing_changes():
    grid = Grid([0.0, 0.2, 0.5], np.linspace(0.0, 1.0, 9))
    tip = np.tile(np.eye(4), (5, 1, 1))
    tip[:, :3, 3] = [0.1, 0.0, 0.48]
    read = PoseReadings(time=np.linspace(0, 1, 5), arclength=np.full(5, 0.5), values=tip, cov=1e-5)
    plain = estimate(PRIOR, grid, [read])
    stated = estimate(replace(PRIOR, base_time_scale=PRIOR.time_scale), grid, [read])
    assert np.allclose(plain.state.pose, stated.state.pose, atol=1e-7)
    assert np.allclose(plain.std_pose(), stated.std_pose(), rtol=1e-6)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 5.0])
def test_between_time_nodes_a_base_is_as_unsure_as_more_nodes_make_it(ratio):
    prior = replace(PRIOR, base_time_scale=ratio * PRIOR.time_scale)
    step = PRIOR.time_scale / 2.0
    time = step * np.arange(5)
    base = PoseReadings(
        time=time, arclength=np.zeros(5), values=np.tile(np.eye(4), (5, 1, 1)), cov=1e-12
    )
    coarse, fine = (
        estimate(prior, Grid([0.0, 0.2, 0.5], np.linspace(0.0, time[-1], count)), [base])
        for count in (5, 41)
    )
    for place in (0.0, 0.1, 0.5):
        found, expected = (p.at(place, 1.5 * step).std_position for p in (coarse, fine))
        assert found == pytest.approx(expected, rel=0.03)


def test_a_base_is_remembered_for_no_less_than_a_shape():
    """A time scale that was learned may exceed the one that a file states of its base."""
    grid = Grid([0.0, 0.5], np.linspace(0.0, 1.0, 5))
    shorter = replace(PRIOR, base_time_scale=0.01 * PRIOR.time_scale).on(grid)
    assert shorter.base_time_scale == PRIOR.time_scale


def test_a_robot_file_states_it_and_gets_it_back():
    prior = replace(PRIOR, base_time_scale=12.0)
    entries = {"length": 0.5, "grid": {"arclength_nodes": 3, "time_rate": 8.0}, **prior.to_table()}
    robot = parse_robot(Table(entries, "robot", RobotFileError))
    assert robot.prior.base_time_scale == pytest.approx(12.0)
