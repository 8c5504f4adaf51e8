"""What the tip of a tendon robot is by the numbers that are learned, and its slopes by them."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.calibration.robot.learn_tendons import TendonData, learn_tendons
from glissando.calibration.robot.tendon_numbers import TendonModel
from glissando.estimation.tendon_prediction import predict_tip
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


def test_each_replicate_is_what_was_learned_without_one_block():
    """So its errors on that block are those of the block left out."""
    rng, robot = np.random.default_rng(4), tendon_robot(play=1e-4)
    model = TendonModel.of(robot, 6)
    truth = 0.7 * rng.standard_normal(model.std.size) * model.std
    pulled = np.repeat(np.eye(6), 10, axis=0) * np.tile(np.linspace(0.0, 3e-3, 10), 6)[:, None]
    tip = model.tip(truth, model.reached(truth, pulled))[0] + 3e-4 * rng.standard_normal((60, 3))
    data = TendonData.of(pulled, tip)
    learned = learn_tendons(robot, data)
    replicates = list(replicated(learned.robot))
    assert len(replicates) == 6
    for block, each in enumerate(replicates):
        rows = data.block == block
        off = tip[rows] - predict_tip(each, pulled, "tip")[0][rows]
        np.testing.assert_allclose(off, learned.held_out[rows], atol=1e-8)
