"""Places of the body known together: their covariance with one another, and how they lie."""

import numpy as np
import pytest

from glissando import Grid, PoseReadings, estimate, load_robot, se3
from glissando.errors import OutsideGridError
from tip_coil import tip

ROBOTS = ["tdcr466", "tdcr466-segments"]


def bent(name, nodes=5, read=(1.0,)):
    """The posterior of a bent robot that trackers read at shares of its length."""
    robot = load_robot(name)
    place = np.union1d(np.linspace(0.0, robot.length, nodes), robot.prior.joints)
    grid, streams = Grid(place, np.arange(6) / 5), []
    for share in read:
        pose = np.tile(tip(share * robot.length, 2.0, 0.3), (6, 1, 1))
        fields = {"arclength": share * robot.length, "values": pose, "name": f"at {share}"}
        streams.append(PoseReadings(time=grid.time, cov=[1e-6] * 3 + [1e-4] * 3, **fields))
    return estimate(robot.prior, grid, streams)


@pytest.fixture(scope="module", params=ROBOTS)
def posterior(request):
    return bent(request.param)


def test_each_place_is_known_as_it_is_alone(posterior):
    nodes, time = posterior.grid.arclength, posterior.grid.time[3]
    places = np.array([nodes[0], 0.3 * nodes[1], nodes[2], nodes[2] + 0.01, nodes[-1]])
    joint, alone = posterior.joint(places, time), posterior.at(places, time)
    np.testing.assert_allclose(joint.pose, alone.pose, atol=1e-14)
    np.testing.assert_allclose(joint.strain, alone.strain, atol=1e-12)
    np.testing.assert_allclose(joint.velocity, alone.velocity, atol=1e-12)
    for m in range(places.size):
        scale = np.sqrt(np.diagonal(alone.cov[m]))
        gap = (joint.cov[m, :, m] - alone.cov[m]) / (scale[:, None] * scale)
        assert np.abs(gap).max() < 1e-9
    whole = joint.cov.reshape(places.size * 18, -1)
    assert np.linalg.eigvalsh(whole).min() > -1e-9 * np.trace(whole)


@pytest.mark.parametrize("name", ROBOTS)
def test_nodes_lie_to_each_other_as_draws_do(name):
    posterior, k = bent(name, read=(0.25, 0.5, 0.75, 1.0)), 3
    draws = posterior.sample(np.random.default_rng(2), 4000)
    joint = posterior.joint(posterior.grid.arclength, posterior.grid.time[k])
    for first, second in [(1, 2), (2, 4), (1, 4)]:
        pose, cov = joint.relative_pose(first, second)
        drawn = se3.inverse(draws.pose[:, k, first]) @ draws.pose[:, k, second]
        off = se3.log(se3.inverse(pose) @ drawn)
        std = np.sqrt(np.diagonal(cov))
        assert std[:3].max() < 0.005
        np.testing.assert_allclose(np.std(off, axis=0) / std, 1.0, atol=0.08)


def test_a_place_between_nodes_is_known_as_a_node_there_would_be():
    coarse, fine = bent("tdcr466-segments", 5), bent("tdcr466-segments", 9)
    place = fine.grid.arclength[[3, 8]]
    assert np.abs(coarse.grid.arclength - place[0]).min() > 0.01
    time = coarse.grid.time[2]
    mine, its = (p.joint(place, time).relative_pose(0, 1) for p in (coarse, fine))
    np.testing.assert_allclose(mine[0], its[0], atol=2e-3)
    np.testing.assert_allclose(np.diagonal(mine[1]), np.diagonal(its[1]), rtol=0.05)


def test_neighbours_move_together(posterior):
    """The distance of neighbours is known far better than where each of them is."""
    joint = posterior.joint(posterior.grid.arclength[2:4], posterior.grid.time[3])
    distance, std = joint.distance(0, 1)
    assert distance == pytest.approx(np.linalg.norm(np.diff(joint.pose[:, :3, 3], axis=0)))
    alone = np.sqrt(np.trace(joint.cov[0, :3, 0, :3]) + np.trace(joint.cov[1, :3, 1, :3]))
    assert 0.0 < std < 0.5 * alone
    assert joint.distance(1, 0) == pytest.approx((distance, std))
    assert joint.distance(0, 0) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    ("place", "time", "words"),
    [
        ([0.1, 0.2], 0.55, "0.55 s is none; the nearest is 0.6 s"),
        ([0.01, 0.02], 0.6, "between the same arclength nodes"),
        ([0.1, 0.9], 0.6, "has arclength 0.9 m"),
        (0.1, 0.6, "takes a list of places"),
        ([], 0.6, "takes a list of places"),
        ([0.1, 0.2], [0.6, 0.4], "and one time"),
    ],
)
def test_what_is_not_known_together_is_a_sentence(posterior, place, time, words):
    with pytest.raises(OutsideGridError, match=words):
        posterior.joint(place, time)


@pytest.mark.parametrize("number", [0.2, 2, -1])
def test_a_place_that_was_not_asked_for_is_named(posterior, number):
    joint = posterior.joint([0.1, 0.2], posterior.grid.time[3])
    for pair in ((number, 0), (0, number)):
        with pytest.raises(OutsideGridError, match=rf"Place {number} is none of the 2"):
            joint.distance(*pair)
