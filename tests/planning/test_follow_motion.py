"""A plan in a loop: readings make the model error known, and commands correct for it."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.model.sensors.sensors import CoilReadings
from glissando.planning.scene.follow import MotionFollower
from glissando.planning.scene.motion_space import motion_space
from glissando.planning.scene.plan_motion import MotionPlan, correction_speed
from motion_scenes import COIL, MOUNTED, ROBOT, any_problem


def followed(seed, corrects, error_seed=None, robot=ROBOT):
    """Errors of the places from the plan, what was stated of them, and changes of corrections.

    The robot is the model with an error of its own, of another seed if one is given; its coil reads
    it twice a second.
    """
    rng = np.random.default_rng(seed)
    problem, control = any_problem(rng, robot=robot, obstacles=[])
    problem = replace(problem, body=replace(problem.body, time_scale=20.0))
    evaluation = problem.evaluate(control)
    rng = rng if error_seed is None else np.random.default_rng([seed, error_seed])
    root = np.linalg.cholesky(problem.belief.cov)
    true = problem.belief.mean + root @ rng.standard_normal(len(root))
    follower = MotionFollower(MotionPlan(problem, evaluation, 0.0, 0.0, 0.05))
    std, body = (
        np.sqrt(np.diagonal(COIL.readings(np.eye(4)[None], *np.zeros((2, 1))).cov)),
        problem.body,
    )
    out = []
    for k, time in enumerate(problem.space.moments):
        values = follower.command(time)
        shapes = body.shapes(values[None, :6], true[None, : body.errors])
        off = shapes.place[0] - evaluation.shapes.place[k]
        out.append((off, evaluation.cov[k], np.diff(follower._corrections, axis=0)[0]))
        place = np.full(round(COIL.rate * problem.space.correction), values[6])
        noise = np.pad(std * rng.standard_normal((place.size, 5)), ((0, 0), (0, 1)))
        sits = np.resize(problem.sensed.std * true[body.errors :], 6)  # none, or one mount
        reading = shapes.pose_at(place[:1])[0] @ se3.exp(sits) @ se3.exp(noise)
        follower.advance(time)
        kept = np.exp(-problem.space.correction / problem.time_scale)
        drift = np.sqrt(1.0 - kept**2) * rng.standard_normal(true.size)
        moved = kept * true + drift
        if corrects:
            follower.add(CoilReadings(time=np.full(place.size, time), arclength=place,
                                      values=reading, cov=COIL.cov))  # fmt: skip
        true = moved
    return out, follower, true


@pytest.mark.slow
def test_readings_bring_the_robot_back_to_its_plan():
    gained = []
    for seed in range(4):
        without, with_readings = (followed(seed, corrects)[0] for corrects in (False, True))
        last = [np.linalg.norm(run[-1][0][-1]) for run in (without, with_readings)]
        gained.append(last[1] / last[0])
    assert np.median(gained) < 0.7


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "seeds"), [(ROBOT, 8), (MOUNTED, 16)])
def test_errors_from_the_plan_are_as_large_as_it_states(robot, seeds):
    squares = []
    for seed in range(seeds):
        for off, cov, _ in followed(seed, True, robot=robot)[0][4::2]:
            squares.append([off[-1] @ off[-1], np.trace(cov[-1])])
    true, stated = np.sum(squares, axis=0)
    assert 0.6 < true / stated < 1.6


def test_commands_keep_the_limits_whatever_is_read():
    _, follower, _ = followed(1, True)
    follower.belief = replace(follower.belief, mean=5.0 * follower.belief.mean)
    for time in np.linspace(0.0, 10.0, 15):  # beyond the end, without readings
        values = follower.command(time)
        tendons = follower.problem.scene.tendons
        assert np.all(values[:6] >= [tendon.lower for tendon in tendons])
        assert np.all(values[:6] <= [tendon.upper for tendon in tendons])
    at_rest = follower.planned(20.0)
    np.testing.assert_array_equal(at_rest, follower.planned(30.0))
    assert at_rest == pytest.approx(follower.plan.evaluation.values[-1])


@pytest.mark.parametrize("seed", range(3))
def test_commands_are_no_faster_than_the_tendons_whatever_is_known(seed):
    rng = np.random.default_rng(seed)
    problem, control = any_problem(rng, obstacles=[])
    plan = MotionPlan(problem, problem.evaluate(control), 0.0, 0.0, 0.05)
    follower, tendons = MotionFollower(plan), problem.scene.tendons
    limit = np.array([tendon.speed for tendon in tendons])
    before, fastest = 0.0, 0.0
    for time in np.append(0.0, np.cumsum(rng.uniform(0.1, 0.9, 12))):
        mean = 8.0 * rng.standard_normal(problem.body.errors)
        follower.belief = replace(follower.belief, mean=mean)
        follower.command(time)
        when = np.linspace(before, time, 21)
        speed = (
            np.diff(follower.at(when)[:, : len(tendons)], axis=0) * 20.0 / max(time - before, 1e-9)
        )
        fastest, before = max(fastest, np.abs(speed / limit).max()), time
    assert 0.9 < fastest < 1.0 + 1e-6


@pytest.mark.slow
def test_corrections_are_as_fast_as_is_predicted_where_nothing_slows_them():
    """Changes of commands of robots that are drawn as the belief says, and the largest of them."""
    runs = [followed(3, True, seed) for seed in range(12)]
    changes = np.array([[change for _, _, change in run[0]] for run in runs])
    follower = runs[0][1]
    fastest = (
        2.0
        * np.sqrt(np.mean(changes[:, 1:] ** 2, axis=0)).max()
        / follower.problem.space.correction
    )
    stated = correction_speed(follower.problem, follower.plan.evaluation)
    assert 0.6 < fastest / stated < 1.6
    assert not follower.plan.warning
    slow = replace(follower.problem.scene, reserve=0.01)
    plan = replace(follower.plan, problem=replace(follower.problem, scene=slow))
    assert "hits may be more frequent than is stated. Raise reserve" in plan.warning


@pytest.mark.parametrize("seed", range(3))
def test_plans_leave_speed_and_stroke_to_corrections(seed):
    kept = 5e-4
    scene = any_problem(np.random.default_rng(seed), obstacles=[])[0].scene
    held = replace(scene.tendons[0], lower=-1e-4)  # starts nearer to its limit than that
    scene = replace(scene, tendons=[held, *scene.tendons[1:]], stroke_reserve=kept, reserve=0.3)
    space = motion_space(scene)
    count, wide = len(scene.tendons), np.full((7, space.paths[0].steps + 2), 1.0)
    wide[:, ::3] = -1.0
    moved = space.follow(wide)[:count]
    low, high = (np.array([getattr(t, end) for t in scene.tendons]) for end in ("lower", "upper"))
    assert np.all(moved.min(axis=1) >= np.minimum(low + kept, 0.0) - 1e-9)
    assert np.all(moved.max(axis=1) <= high - kept + 1e-9)
    speed = np.abs(np.diff(moved, axis=1)).max() / space.paths[0].step
    assert speed == pytest.approx(0.7 * held.speed, rel=0.01)


@pytest.fixture
def follower():
    problem, control = any_problem(np.random.default_rng(0), obstacles=[])
    return MotionFollower(MotionPlan(problem, problem.evaluate(control), 0.0, 0.0, 0.05))


def coil(place, height, time=0.4):
    pose = np.eye(4)[None].copy()
    pose[:, 2, 3] = height
    return CoilReadings(time=[time], arclength=[place], values=pose, cov=COIL.cov)


@pytest.mark.parametrize(("place", "height"), [(0.15, 150.0), (0.15, 0.65), (150.0, 0.15)])
def test_readings_that_no_such_robot_gives_are_counted_and_move_no_command(follower, place, height):
    follower.command(0.5)
    follower.advance(0.5)
    before = follower.belief
    follower.add(coil(place, height))
    assert follower.dropped == 1
    np.testing.assert_allclose(follower.belief.mean, before.mean, atol=1e-12)
    follower.add(coil(0.15, 0.15).select(slice(0, 0)))
    follower.command(1.0)


def test_time_does_not_go_back_and_is_the_plans(follower):
    follower.advance(1.0)
    before = follower.belief
    follower.advance(0.5)
    assert follower.belief is before
    for call in (follower.advance, follower.command):
        for time in (5e3, -1e9, float("nan")):
            with pytest.raises(GlissandoError, match="give seconds from its start"):
                call(time)


def test_a_robot_that_has_come_to_rest_may_be_left_alone_for_long(follower):
    horizon = follower.problem.scene.horizon
    at_rest = follower.command(horizon)
    follower.advance(3600.0)
    np.testing.assert_allclose(follower.command(3600.0), follower.planned(horizon), atol=1e-3)
    np.testing.assert_allclose(at_rest, follower.planned(horizon), atol=1e-3)
