"""Readings that share a time step share the error of its bridge, unless they have nodes."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import CoilReadings, estimate, load_robot
from glissando.model.grid import Grid

READINGS = 4  # a time step
STEPS = 16


def sweep(robot):
    """A coil that traverses a robot at rest within four time steps."""
    step = 1.0 / robot.time_rate
    time = (np.arange(READINGS * STEPS) + 0.5) * step / READINGS
    place = robot.length * (0.55 + 0.45 * np.cos(0.25 * np.pi * time / step))
    pose = np.tile(np.eye(4), (time.size, 1, 1))
    pose[:, 2, 3] = place
    std = np.repeat([1.2e-3, 1e-2], [3, 2])
    coil = CoilReadings(time=time, arclength=place, values=pose, cov=std**2, name="coil")
    return coil, STEPS * step


def deviations(robot, rate, time=()):
    """Standard deviations of positions at nodes of the robot's own rate, and at further times."""
    coil, stop = sweep(robot)
    grid = replace(robot, time_rate=rate).grid(0.0, stop, [coil])
    posterior = estimate(robot.prior, grid, [coil])
    place = robot.length * np.array([0.25, 0.5, 0.75, 1.0])
    nodes = np.arange(4, 13) / robot.time_rate
    return posterior.at(place, np.append(nodes, time)[:, None]).std_position


@pytest.mark.parametrize("name", ["sliding700", "tdcr466"])
def test_half_the_step_changes_no_standard_deviation_where_readings_have_nodes(name):
    for at_readings in (False, True):
        robot = replace(load_robot(name), nodes_at_readings=at_readings)
        coarse, fine = (deviations(robot, n * robot.time_rate) for n in (1, 2))
        change = np.abs(fine / coarse - 1.0).max()
        assert change < 0.03 if at_readings else change > 0.04


def test_under_the_separable_prior_half_the_step_changes_nothing_anywhere():
    robot = load_robot("tdcr466-segments")
    prior = replace(robot.prior, base_time_scale=None)  # a longer one depends on the nodes
    robot = replace(robot, prior=prior, nodes_at_readings=True)
    time = sweep(robot)[0].time[20:40] + 1e-3
    coarse, fine = (deviations(robot, n * robot.time_rate, time) for n in (1, 2))
    np.testing.assert_allclose(fine, coarse, rtol=1e-5)


def test_only_readings_that_share_an_interval_get_nodes_and_none_beside_another():
    grid = Grid([0.0, 0.1], [0.0, 1.0, 2.0, 3.0])
    time = [0.01, 0.4, 0.42, 0.9, 1.5, 2.0, 2.2, 2.97, 3.0]
    assert grid.with_nodes_at(time).time.tolist() == [0.0, 0.4, 0.9, 1.0, 2.0, 2.2, 3.0]
    np.testing.assert_array_equal(grid.with_nodes_at([]).time, grid.time)
