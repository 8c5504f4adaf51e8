import numpy as np
import pytest

from glissando import (
    CoilReadings,
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
