"""What the tip of a tendon robot is by the numbers that are learned, and its slopes by them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from glissando.calibration.robot.learn_tendons import TendonData, _fit, learn_tendons
from glissando.calibration.robot.tendon_numbers import TendonModel
from glissando.estimation.tendon_prediction import predict, predict_tip
from glissando.model.tendons.tendon_rod import replicated
from tendon_robot import tendon_robot


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_slopes_by_every_number_are_differences(friction):
    rng, robot = np.random.default_rng(2), tendon_robot()
    count = len(robot.tendons)
    robot = replace(robot, tendons=replace(robot.tendons, friction=np.full(count, friction)))
    model = TendonModel.of(robot, count)
    numbers = model.start() + 0.1 * rng.standard_normal(model.std.size) * model.std
    pulled = np.abs(rng.standard_normal((4, count))) * 1e-3
    _, shape = model.tip(numbers, model.reached(numbers, pulled))
    slope = model.slope(numbers, pulled, np.arange(4), shape)
    differences = np.empty_like(slope)
    for i, step in enumerate(1e-4 * np.diag(model.std)):
        ends = (
            model.tip(each, model.reached(each, pulled), shape.strain)[0]
            for each in (numbers + step, numbers - step)
        )
        differences[..., i] = np.subtract(*ends) / (2e-4 * model.std[i])
    for name, where in model.where.items():
        found, expected = slope[..., where], differences[..., where]
        assert np.abs(found - expected).max() <= 1e-4 * np.abs(expected).max(), name


def test_commands_that_pull_alike_are_left_out_together():
    """Nine patterns, each held, slackened and pulled again, farther; at rest a row goes on."""
    patterns = np.repeat(np.concatenate([np.eye(6), -np.eye(6)[:3]]), 8, axis=0)
    size = np.tile([0.0, 2.0, 9.0, 9.0, 1.0, 0.0, 5.0, 0.1], 9)[:, None]
    pulled = 1e-3 * size * patterns + 1e-5
    block = TendonData.of(pulled, np.zeros((72, 3))).block.reshape(9, 8)
    assert np.all(block[:, 1:] == block[:, 1:2])
    np.testing.assert_array_equal(block[:, 1], np.arange(9) % 6)
    circling = TendonData.of(np.abs(pulled) + 1e-3, np.zeros((72, 3))).block
    assert set(circling) == set(range(6))


def test_learning_goes_on_after_a_step_that_gains_little_while_the_next_promises_much():
    """It ended 4.4 mm off the tip here, on the way round a valley's bend."""
    rng, robot = np.random.default_rng(24), tendon_robot(play=1e-4)
    model = TendonModel.of(robot, 6)
    truth = rng.standard_normal(model.std.size) * model.std
    pulled = np.repeat(np.eye(6), 10, axis=0) * np.tile(np.linspace(0.0, 3e-3, 10), 6)[:, None]
    tip = model.tip(truth, model.reached(truth, pulled))[0] + 3e-4 * rng.standard_normal((60, 3))
    data, every = TendonData.of(pulled, tip), np.ones(60, dtype=bool)
    found = _fit(model, model.start(), data, every, "all", lambda text: None)
    miss = tip - model.tip(found, model.reached(found, pulled))[0]
    assert np.sqrt(np.mean(np.sum(miss**2, axis=1))) < 1e-3


@pytest.fixture(scope="module")
def taught():
    """A true robot, the data of its marker, and what was learned from them."""
    rng, robot = np.random.default_rng(4), tendon_robot(play=1e-4)
    model = TendonModel.of(robot, 6)
    truth = 0.7 * rng.standard_normal(model.std.size) * model.std
    pulled = np.repeat(np.eye(6), 10, axis=0) * np.tile(np.linspace(0.0, 3e-3, 10), 6)[:, None]
    tip = model.tip(truth, model.reached(truth, pulled))[0] + 3e-4 * rng.standard_normal((60, 3))
    data = TendonData.of(pulled, tip)
    return model.robot_of(truth, np.full(3, 1e-4)), data, learn_tendons(robot, data)


def test_each_replicate_is_what_was_learned_without_one_block(taught):
    """So its errors on that block are those of the block left out."""
    _, data, learned = taught
    replicates = list(replicated(learned.robot, learned.robot.tendons.replicates))
    assert len(replicates) == 6
    for block, each in enumerate(replicates):
        rows = data.block == block
        off = data.tip[rows] - predict_tip(each, data.displacement, "tip")[0][rows]
        np.testing.assert_allclose(off, learned.held_out[rows], atol=1e-8)


def test_what_the_marker_leaves_open_of_the_robots_own_frame_is_in_its_covariance(taught):
    """How the tracker is turned against a rod bent at rest moves the robot, not what is seen."""
    truth, data, learned = taught
    robot, at = learned.robot, (np.arange(60.0), data.displacement, np.array([0.1, 0.2]))
    seen = predict_tip(robot, data.displacement, "tip")[0]
    for other in replicated(robot, robot.tendons.left_open):
        moved = predict_tip(other, data.displacement, "tip")[0] - seen
        assert np.sqrt(np.mean(moved**2)) < 5e-4
    silent = replace(robot, tendons=replace(robot.tendons, left_open=()))
    true, stated, before = (predict(each, *at) for each in (truth, robot, silent))
    error = np.einsum("mnji,mnj->mni", stated.pose[..., :3, :3], true.position - stated.position)
    honest, false = (
        np.einsum("mni,mnij,mnj->mn", error, np.linalg.inv(each.position_covariance()), error)
        for each in (stated, before)
    )
    assert np.mean(honest < chi2.ppf(0.95, 3)) > 0.9
    assert np.mean(false) > 10.0 * np.mean(honest)
