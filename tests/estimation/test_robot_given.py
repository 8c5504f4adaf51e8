"""Estimators take a robot with what it knows of its sensors, or a prior without."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import (
    FixedLagSmoother,
    PoseReadings,
    SensorParameter,
    estimate,
    estimate_static,
    load_robot,
    se3,
)
from glissando.errors import SensorError


def test_a_robot_brings_its_sensor_parameters_and_a_prior_none():
    """A frame that a robot file knows of is not forgotten where the robot is given."""
    robot = load_robot("tdcr466")
    off = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
    frame = SensorParameter("tracker", "frame", ("coil",), off, np.zeros(6))
    robot = replace(robot, sensor_parameters=(frame,))
    time, tip = np.linspace(0.0, 1.0, 11), np.eye(4)
    tip[2, 3] = robot.length
    read = np.tile(se3.inverse(se3.exp(off)) @ tip, (11, 1, 1))
    fields = {"arclength": robot.length, "values": read, "cov": 1e-6, "name": "coil"}
    coil = PoseReadings(time=time, **fields)
    grid, nodes = robot.grid(0.0, 1.0), robot.arclength_nodes
    known = estimate(robot, grid, [coil])
    assert np.linalg.norm(known.state.pose[-1, -1, :3, 3] - tip[:3, 3]) < 1e-3
    for other in (
        estimate(robot.prior, grid, [coil], sensor_parameters=[frame]),
        estimate(replace(robot, sensor_parameters=()), grid, [coil], sensor_parameters=[frame]),
    ):
        np.testing.assert_array_equal(other.state.pose, known.state.pose)
    forgotten = estimate(robot, grid, [coil], sensor_parameters=())
    assert forgotten.state.pose[-1, -1, 0, 3] == pytest.approx(-0.02, abs=2e-3)
    smoother = FixedLagSmoother(robot, nodes)
    smoother.add(coil)
    assert np.linalg.norm(smoother.advance(1.0).position[-1] - tip[:3, 3]) < 1e-3
    shape = PoseReadings(time=[0], **{**fields, "values": read[:1]})
    still = estimate_static(robot, nodes, [shape]).state.pose[0, -1, :3, 3]
    assert np.linalg.norm(still - tip[:3, 3]) < 1e-3
    unsure = replace(robot, sensor_parameters=(replace(frame, std=np.full(6, 1e-3)),))
    with pytest.raises(
        SensorError, match="'tracker' is uncertain, and static shapes estimate none"
    ):
        estimate_static(unsure, nodes, [shape])
