from dataclasses import replace

import numpy as np
import pytest

from glissando import (
    CoilReadings,
    FalseConfidenceWarning,
    GlissandoError,
    Grid,
    GyroReadings,
    PoseReadings,
    PositionReadings,
    estimate_static,
    load_robot,
    sample_static,
)
from glissando.errors import SensorError
from glissando.evaluation.prior_predictive import PriorPredictive
from glissando.geometry import se3

CHI2 = 7.8147  # of three degrees of freedom, 95 %


def spread(shapes, n):
    """Positions (S, 3) at a node: their mean and covariance."""
    place = shapes.pose[:, n, :3, 3]
    return place.mean(axis=0), np.cov(place.T)


@pytest.mark.slow
def test_draws_are_those_of_the_posterior_where_that_is_gaussian():
    robot = load_robot("tdcr466-segments")
    pose = np.eye(4)[None].repeat(2, axis=0)
    pose[:, 2, 3] = 0.233, 0.466
    poses = PoseReadings(time=[0, 0], arclength=[0.233, 0.466], values=pose, cov=1e-4)
    found = estimate_static(robot.prior, robot.arclength_nodes, [poses])
    drawn = sample_static(robot.prior, robot.arclength_nodes, [poses], size=400)
    for n, s in enumerate(robot.arclength_nodes):
        at, (mean, cov) = found.at(s, 0), spread(drawn, n)
        expected = at.cov_position_world
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_array_less(np.abs(cov - expected), 0.2 * scale + 1e-18)
        np.testing.assert_array_less(
            np.abs(mean - at.position), 0.17 * np.sqrt(np.diag(expected)) + 1e-9
        )


@pytest.mark.slow
@pytest.mark.parametrize("places", [(0.28,), (0.1, 0.19, 0.28, 0.37, 0.466)])
def test_draws_explain_readings_between_nodes(places):
    """The first steps from shapes of the prior bend some so far that readings have no weights."""
    robot, count = load_robot("tdcr466-segments"), len(places)
    fields = {"time": np.zeros(count), "arclength": places, "cov": [1e-6] * 3 + [1e-4] * 3}
    layout = PoseReadings(values=np.tile(np.eye(4), (count, 1, 1)), **fields)
    predictive = PriorPredictive(robot, Grid(robot.arclength_nodes, [0.0]), [layout])
    for seed in range(3):
        (read,) = predictive.draw(np.random.default_rng([1, seed])).readings
        found = estimate_static(robot.prior, robot.arclength_nodes, [read])
        drawn = sample_static(robot.prior, robot.arclength_nodes, [read], size=40)
        n = int(np.argmin(np.abs(robot.arclength_nodes - np.mean(places))))
        at = found.at(robot.arclength_nodes[n], 0)
        mean, cov = spread(drawn, n)
        off = mean - at.position
        assert off @ np.linalg.solve(at.cov_position_world, off) < 1.0
        assert 0.4 < np.trace(cov) / np.trace(at.cov_position_world) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sliding700", "extensible1m"])
def test_shapes_are_found_though_most_of_the_prior_are_far_from_the_readings(name):
    robot = load_robot(name)
    nodes, rest = robot.arclength_nodes, robot.prior.rest_state(Grid(robot.arclength_nodes, [0.0]))
    bend = np.append(rest.strain[0, 0, :3], np.array([0.8, -0.5, 0.1]) / robot.length)
    place = np.array([0.2, 0.55, 0.9]) * robot.length
    pose = rest.pose[0, 0] @ se3.exp(place[:, None] * bend)
    cov = [1e-6] * 3 + [1e-4] * 2
    read = CoilReadings(time=np.zeros(3), arclength=place, values=pose, cov=cov)
    drawn = sample_static(robot.prior, nodes, [read], size=20)
    middle = int(np.argmin(np.abs(nodes - place[1])))
    arc = rest.pose[0, 0] @ se3.exp(nodes[middle] * bend)
    assert np.abs(drawn.pose[:, middle, :3, 3] - arc[:3, 3]).max() < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["position", "coil"])
def test_shapes_of_the_prior_lie_within_the_spread_of_draws(sensor):
    """A Gaussian about the shape that is found holds half to four fifths of them."""
    robot, sessions, inside = load_robot("tdcr466-segments"), 10, 0
    grid = Grid(robot.arclength_nodes, [0.0])
    tip = {"time": [0.0], "arclength": [robot.length]}
    layout = PositionReadings(**tip, values=np.zeros((1, 3)), cov=1e-6)
    if sensor == "coil":
        layout = CoilReadings(**tip, values=np.eye(4)[None], cov=[1e-6] * 3 + [1e-4] * 2)
    predictive = PriorPredictive(robot, grid, [layout])
    middle = grid.arclength.size // 2
    at = int(np.argmin(np.abs(predictive.fine.arclength - grid.arclength[middle])))
    for seed in range(sessions):
        session = predictive.draw(np.random.default_rng([3, seed]))
        rng = np.random.default_rng(seed)
        drawn = sample_static(robot.prior, grid.arclength, session.readings, size=40, rng=rng)
        mean, cov = spread(drawn, middle)
        error = session.truth.pose[0, at, :3, 3] - mean
        inside += bool(error @ np.linalg.solve(cov, error) <= CHI2)
    assert inside >= 8  # 95 % less three standard deviations


@pytest.mark.slow
def test_draws_are_the_same_again_and_of_any_number():
    robot = load_robot("tdcr466-segments")
    tip = PositionReadings(time=[4.0], arclength=[0.466], values=[[0.1, 0.0, 0.4]], cov=1e-6)
    one, again = (sample_static(robot.prior, robot.arclength_nodes, [tip], size=7) for _ in "ab")
    np.testing.assert_array_equal(one.pose, again.pose)
    assert one.pose.shape == (7, robot.arclength_nodes.size, 4, 4)
    assert not one.velocity.any()


@pytest.mark.slow
def test_what_cannot_be_drawn_is_said():
    robot = load_robot("tdcr466-segments")
    nodes = robot.arclength_nodes
    tip = PositionReadings(time=[0.0], arclength=[0.466], values=[[0.1, 0.0, 0.4]], cov=1e-6)
    with pytest.raises(GlissandoError, match="size is 0; draw 1 to 10,000"):
        sample_static(robot.prior, nodes, [tip], size=0)
    gyro = GyroReadings(time=[0.0], arclength=[0.466], values=np.zeros((1, 3)), cov=1e-4)
    with pytest.raises(SensorError, match="no velocity to read"):
        sample_static(robot.prior, nodes, [gyro])
    far = PositionReadings(time=[0.0], arclength=[0.466], values=[[3.0, 0.0, 0.0]], cov=1e-12)
    with pytest.raises(GlissandoError, match="that explains the readings"):
        sample_static(robot.prior, nodes, [far], size=5)


def tips(robot, seeds, places=(1.0,)):
    """Coil readings at places (shares of the length) of shapes drawn from the robot's prior."""
    fields = {"arclength": np.array(places) * robot.length, "cov": [1e-6] * 3 + [1e-4] * 2}
    values = np.tile(np.eye(4), (len(places), 1, 1))
    layout = CoilReadings(time=np.zeros(len(places)), values=values, **fields)
    predictive = PriorPredictive(robot, Grid(robot.arclength_nodes, [0.0]), [layout])
    drawn = [predictive.draw(np.random.default_rng([1, seed])).readings[0] for seed in seeds]
    return CoilReadings(
        time=np.repeat(np.arange(len(seeds)), len(places)),
        values=np.concatenate([r.values for r in drawn]),
        arclength=np.tile(fields["arclength"], len(seeds)),
        cov=fields["cov"],
    )


@pytest.mark.slow
def test_shapes_of_which_others_are_probable_are_those_of_which_draws_lie_elsewhere():
    robot = load_robot("tdcr466-segments")
    nodes, read = robot.arclength_nodes, tips(robot, [9, 1, 18])
    with pytest.warns(FalseConfidenceWarning, match="Shapes 0, 2 are not the only probable: the"):
        found = estimate_static(robot.prior, nodes, [read])
    assert set(found.others) == {0, 2}
    for k in range(3):
        drawn = sample_static(robot.prior, nodes, [read.select(read.time == k)], size=60)
        middle = nodes.size // 2
        at = found.at(nodes[middle], k)
        away = np.linalg.norm(drawn.pose[:, middle, :3, 3] - at.position, axis=1)
        elsewhere = np.mean(away > 5.0 * at.std_position)
        assert (elsewhere > 0.05) == (k in found.others)


@pytest.mark.slow
def test_a_shape_is_not_named_where_a_likelier_one_replaced_it_and_no_other_is_probable():
    robot = load_robot("tdcr466-segments")
    read = tips(robot, [104, 123])  # a warning would be an error
    found = estimate_static(robot.prior, robot.arclength_nodes, [read])
    assert not found.others
    assert found.converged.all()


def test_no_other_shapes_are_sought_where_readings_leave_none_or_no_prior_draws_them():
    robot = load_robot("tdcr466-segments")
    read = tips(robot, [0, 1], places=(0.25, 0.5, 0.75, 1.0))
    assert not estimate_static(robot.prior, robot.arclength_nodes, [read]).others
    arm = load_robot("sliding700")
    free, tip = replace(arm.prior, base=None), np.eye(4)[None].repeat(2, axis=0)
    tip[:, 2, 3] = 0.0, 0.7
    ends = PoseReadings(time=[0, 0], arclength=[0.0, 0.7], values=tip, cov=[1e-6] * 3 + [0.3] * 3)
    assert not estimate_static(free, arm.arclength_nodes, [ends]).others
