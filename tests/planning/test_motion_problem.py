"""One problem for robot and sensor: every slope, in one backward pass, is that of differences."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from draws import generators, law
from glissando import SensorParameter
from glissando.errors import FalseConfidenceWarning, PlanWarning
from glissando.geometry import se3
from glissando.model.sensors.parameters import corrected
from glissando.model.state import State
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.plan_motion import motion_problem
from glissando.planning.scene.scene_checks import unsure_numbers
from glissando.planning.scene.sensor_errors import sensor_errors
from glissando.planning.scene.tendon_body import tendon_body
from motion_scenes import COIL, HELD, LOOSE, ROBOT, UNSURE, any_problem, around, small_scene
from tendon_robot import LENGTH, NAMES, tendon_robot, with_replicates

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
@pytest.mark.parametrize(("every", "robot"), [(1, ROBOT), (3, LOOSE), (3, UNSURE)])
def test_slopes_through_mechanics_and_belief_are_those_of_differences(name, every, robot):
    rng = np.random.default_rng(every)
    problem, control = any_problem(rng, every, robot, obstacles=around(rng, 6))
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
    np.testing.assert_array_equal(one.known.off, other.known.off)
    assert np.trace(problem.evaluate(control).known.off[-1]) < np.trace(one.known.off[-1])


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


@pytest.mark.parametrize("column", range(3))
def test_places_move_as_shapes_on_another_base_or_with_other_displacements_do(rng, column):
    body, pulled = tendon_body(LOOSE, 0.025), rng.uniform(-1e-3, 3e-3, (1, 6))
    error = np.zeros((1, body.errors))
    error[0, (0, -6, -1)[column]] = 1e-3  # of a tendon with play, and of the base's pose
    there, back = (body.shapes(pulled, sign * error).place for sign in (1.0, -1.0))
    moved = (body.shapes(pulled).moves @ error[0])[0]
    np.testing.assert_allclose(moved, 0.5 * (there - back)[0], atol=5e-3 * np.abs(moved).max())


@law
@given(rng=generators)
def test_what_corrections_leave_is_what_tendons_cannot_do_about_a_known_error(rng):
    three = {"names": NAMES[:3], "angle": [0.0, 2.1, 4.2], "end": [LENGTH] * 3}
    few = tendon_robot(std=2e-4, psd_moment=2e-8, **three)  # for four bends
    for each in (LOOSE, few):
        body = tendon_body(each, 0.025)
        count = len(each.tendons)
        shapes = body.shapes(rng.uniform(-1e-3, 3e-3, (1, count)))
        pulled = shapes.balance.strain_by_displacement()[0, :, 3:5].reshape(-1, count)
        bends = shapes.strain_by_error[0, :, 3:5].reshape(len(pulled), -1)
        tip = shapes.tip_by_displacement()[0]
        moved = shapes.moves[0, -1]
        true = moved - tip @ np.linalg.pinv(pulled, rcond=1e-3) @ bends
        np.testing.assert_allclose(moved @ body.left, true, atol=0.05 * np.abs(moved).max())
        assert np.abs(true).max() > 0.2 * np.abs(moved).max()  # of the base, or of the moments


def test_play_counts_as_half_of_it_either_way_and_a_known_base_as_nothing():
    loose, tight = tendon_body(LOOSE, 0.025), tendon_body(HELD, 0.025)
    np.testing.assert_allclose(loose.std[:3], [np.hypot(2e-4, 2e-4), 2e-4, 2e-4])
    assert loose.errors == tight.errors + 6


def test_what_is_unknown_of_a_sensor_and_left_out_is_named():
    late = SensorParameter("coil delay", "time_offset", ("coil",), [0.0], [0.02])
    with pytest.warns(FalseConfidenceWarning, match="leaves out that coil delay is not known"):
        motion_problem(small_scene([]), replace(ROBOT, sensor_parameters=(late,)))


def test_a_parameter_of_no_sensor_of_the_scene_is_named():
    mount = SensorParameter("tip mount", "mount", ("aurora0",), np.zeros(6), [1e-3] * 6)
    with pytest.warns(PlanWarning, match="slides as aurora0, give it that name"):
        motion_problem(small_scene([]), replace(ROBOT, sensor_parameters=(mount,)))


def test_slopes_of_a_sensor_are_those_about_its_expected_value(rng):
    value, std = 0.3 * rng.standard_normal((2, 6)), rng.uniform(0.1, 1.0, 6)
    parameters = tuple(
        SensorParameter(kind, kind, ("coil",), x, std)
        for kind, x in zip(("frame", "mount"), value, strict=True)
    )
    pose = se3.exp(rng.standard_normal(6))
    sensed, _ = sensor_errors([COIL], replace(ROBOT, sensor_parameters=parameters), pose)
    raw = COIL.readings(pose[None], np.zeros(1), np.zeros(1))
    at = State(pose[None], np.zeros((1, 6)), np.zeros((1, 6)))
    expected = sensed.expected(raw)

    def residual(k, x):
        moved = [replace(p, value=p.value + x * (j == k)) for j, p in enumerate(parameters)]
        return corrected(raw, moved).residual(at)[0]

    true = [
        (residual(k, 1e-6 * d) - residual(k, -1e-6 * d)) / 2e-6
        for k in range(2)
        for d in np.diag(std)
    ]
    found = sensed.slopes(expected, at, expected.jacobian(at))[0]
    np.testing.assert_allclose(found, np.stack(true, axis=1), atol=1e-6)


def test_weight_that_a_plan_leaves_out_is_named():
    mechanics = replace(ROBOT.prior.mechanics, gravity=np.array([9.81, 0.0, 0.0]), tip_mass=0.002)
    heavy = replace(ROBOT, prior=replace(ROBOT.prior, mechanics=mechanics))
    with pytest.warns(FalseConfidenceWarning, match=r"moves it by .* mm when no tendon pulls"):
        motion_problem(small_scene([]), heavy)


@pytest.mark.parametrize("key", ["replicates", "left_open"])
def test_how_surely_tendons_were_learned_is_named_as_the_risk_leaves_it_out(key):
    others = with_replicates(tendon_robot(), 6, seed=0)[0].tendons.replicates
    learned = {"learned_to": np.full(6, 2e-3), key: others}
    robot = replace(ROBOT, tendons=replace(ROBOT.tendons, **learned))
    with pytest.warns(FalseConfidenceWarning, match=r"leave the tip unsure by .* mm, beside"):
        motion_problem(small_scene([]), robot)
    sure = replace(ROBOT, tendons=replace(ROBOT.tendons, learned_to=np.full(6, 2e-3)))
    assert not unsure_numbers(sure)
    vague = replace(robot, tendons=replace(robot.tendons, psd_moment=1.0))
    assert not unsure_numbers(vague)
