"""What the tip of a tendon robot is by the numbers that are learned, and its slopes by them."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.calibration.robot.tendon_numbers import TendonModel
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
