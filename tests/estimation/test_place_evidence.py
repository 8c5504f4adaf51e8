"""An unknown offset along the robot is found without a pull towards the tip."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import CoilReadings, Grid, SensorParameter, estimate, load_robot
from glissando.evaluation.prior_predictive import PriorPredictive, noisy_values
from glissando.geometry import se3
from glissando.model.state import State

STD = np.array([1e-3] * 3 + [0.01] * 2)
OFFSET = SensorParameter("off", "arclength_offset", ("coil",), [0.0], [6e-3])


def gentle(robot):
    """The shipped robot, which bends little, from a base that hardly moves; known sensors."""
    psd, jump = np.array([1e-7, 1e-7, 1e-5, 1, 1, 0.05]), np.array([1e-9, 1e-9, 1e-4, 1, 1, 0.1])
    base = replace(robot.prior.base, strain=np.array([1e-7, 1e-7, 1e-4, 2, 2, 0.1]))
    prior = replace(
        robot.prior, psd_strain_arclength=np.stack([psd, psd]), jumps=jump[None], base=base
    )
    return replace(
        robot, prior=prior, sensor_parameters=(OFFSET,), time_rate=15.0, sensor_std={"coil": STD}
    )


def sliding(time, length, reach):
    return length - 0.05 - reach * length * (0.5 - 0.5 * np.cos(np.pi * time))


def z_score(robot, grid, readings, truth):
    found, cov = estimate(
        robot.prior, grid, [readings], sensor_parameters=robot.sensor_parameters
    ).parameter("off")
    return float((found[0, 0] - truth) / np.sqrt(cov[0, 0, 0]))


@pytest.mark.slow
def test_offsets_drawn_from_their_prior_are_inside_their_deviations():
    robot, duration = gentle(load_robot("tdcr466-segments")), 2.0
    grid = robot.grid(0.0, duration)
    time, one = grid.time, np.broadcast_to(np.eye(4), (grid.time.size, 4, 4)).copy()
    place = sliding(time, robot.length, 0.3)
    layout = CoilReadings(time=time, arclength=place, values=one, cov=STD**2, name="coil")
    drawn, rng, z = PriorPredictive(robot, grid, [layout]), np.random.default_rng(1), []
    for _ in range(8):
        session = drawn.draw(rng)
        z.append(z_score(robot, grid, session.readings[0], session.parameters[0, 0]))
    assert np.sqrt(np.mean(np.square(z))) < 1.5
    assert abs(np.mean(z)) < 0.8


@pytest.mark.slow
def test_a_prior_broader_than_motions_are_does_not_pull_offsets_to_the_base():
    shipped = load_robot("tdcr466-segments")
    robot = replace(
        shipped, sensor_parameters=(OFFSET,), sensor_loss={}, sensor_rate={}, time_rate=20.0
    )
    std, half, z = 1.5 * STD, 0.5 * robot.length, []
    for seed in range(4):
        rng, time = np.random.default_rng(seed), np.linspace(0.0, 6.0, 121)
        rate, phase = rng.uniform(0.1, 0.5, (2, 2)), rng.uniform(0.0, 2.0 * np.pi, (2, 2))
        size, off = rng.normal(0.0, 1.0, (2, 2)), 6e-3 * rng.standard_normal()
        place = sliding(time, robot.length, 0.3)
        strain = np.zeros((2, time.size, 6))
        strain[..., 2] = 1.0
        turn = 2.0 * np.pi * rate * time[:, None, None] + phase
        strain[..., 3:5] = np.moveaxis(size * np.sin(turn), 1, 0)
        near, far = np.minimum(place, half), np.maximum(place - half, 0.0)
        pose = se3.exp(near[:, None] * strain[0]) @ se3.exp(far[:, None] * strain[1])
        exact = CoilReadings(time=time, arclength=place - off, values=pose, cov=std**2, name="coil")
        still = np.zeros((time.size, 6))
        seen = exact.changed(values=noisy_values(exact, State(pose, still, still), rng))
        z.append(z_score(robot, Grid(robot.arclength_nodes, robot.grid(0.0, 6.0).time), seen, off))
    assert np.sqrt(np.mean(np.square(z))) < 1.6


def test_an_offset_that_is_all_but_known_is_left_where_it_is():
    robot, time = gentle(load_robot("tdcr466-segments")), np.linspace(0.0, 1.0, 16)
    place, pose = sliding(time, robot.length, 0.3), np.tile(np.eye(4), (16, 1, 1))
    pose[:, 2, 3] = place
    coil = CoilReadings(time=time, arclength=place, values=pose, cov=STD**2, name="coil")
    grid, sure = robot.grid(0.0, 1.0), replace(OFFSET, std=np.array([1e-7]))
    plain = estimate(robot.prior, grid, [coil])
    other = estimate(robot.prior, grid, [coil], sensor_parameters=[sure])
    np.testing.assert_allclose(other.state.pose, plain.state.pose, atol=1e-6)
    assert abs(other.parameter("off")[0][0, 0]) < 1e-7
