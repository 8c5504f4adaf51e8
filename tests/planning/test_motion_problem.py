"""One problem for robot and sensor: every slope, in one backward pass, is that of differences."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.plan_motion import motion_problem
from motion_scenes import ROBOT, any_problem, around, small_scene

WORTH = {
    "cost": (lambda p, e: e.cost, lambda p, e: p.gradients(e)[0]),
    "risk": (MotionProblem.log_risk, lambda p, e: p.gradients(e)[1]),
    "miss": (lambda p, e: p.misses(e)[0], lambda p, e: p.misses_gradient(e)[0]),
}


@pytest.fixture
def rng():
    """A generator of its own for each test."""
    return np.random.default_rng(0)


def slope_along(value, at, direction, step=2e-5):
    """Difference quotient of fourth order of a value along a direction."""
    near, far = (
        (value(at + x * direction) - value(at - x * direction)) / (2 * x) for x in (step, 2 * step)
    )
    return (4.0 * near - far) / 3.0


@pytest.mark.parametrize("name", WORTH)
@pytest.mark.parametrize("every", [1, 3])
def test_slopes_through_mechanics_and_belief_are_those_of_differences(name, every):
    rng = np.random.default_rng(every)
    problem, control = any_problem(rng, every, obstacles=around(rng, 6))
    worth, gradient = WORTH[name]
    evaluation = problem.evaluate(control)
    if name == "risk":
        assert evaluation.hits.value > 1e-9
    found, free = gradient(problem, evaluation), problem.space.free(control)

    def value(x):
        return worth(problem, problem.evaluate(problem.space.control(x)))

    for _ in range(3):
        direction = rng.standard_normal(free.size)
        true = slope_along(value, free, direction)
        scale = np.linalg.norm(found) * np.linalg.norm(direction) / np.sqrt(free.size)
        assert found @ direction == pytest.approx(true, abs=1e-6 * scale, rel=1e-6)


def test_without_sensing_what_is_known_does_not_depend_on_the_slide(rng):
    problem, control = any_problem(rng)
    blind = replace(problem, senses=False)
    moved = control.copy()
    moved[-1] = 0.1
    one, other = blind.evaluate(control), blind.evaluate(moved)
    np.testing.assert_array_equal(one.known.before, other.known.before)
    assert np.trace(problem.evaluate(control).known.before[-1]) < np.trace(one.known.before[-1])


def test_all_values_keep_the_limits_where_the_free_numbers_do(rng):
    problem, control = any_problem(rng)
    rows, centre, width = problem.space.polytope
    assert np.all(np.abs(rows @ problem.space.free(control) - centre) <= width * (1.0 + 1e-9))
    np.testing.assert_allclose(
        problem.space.control(problem.space.free(control)), control, atol=1e-12
    )
    values = problem.evaluate(control).values
    for path, column in zip(problem.space.paths, values.T, strict=True):
        assert column.min() >= path.lower - 1e-9
        assert column.max() <= path.upper + 1e-9
        assert np.abs(np.diff(column)).max() <= path.speed * problem.space.correction * (1.0 + 1e-6)


@pytest.mark.parametrize("correction", [0.1, 0.3, 0.4, 0.5, 0.6, 1.0, 1.7, 2.0])
def test_readings_are_counted_on_no_sooner_than_commands_are_corrected(correction):
    problem = motion_problem(small_scene([], horizon=8.0, correction=correction), ROBOT)
    assert correction - 1e-9 <= problem.space.correction < 1.35 * correction
