"""What is left of a motion, planned again: limits hold, risk is accounted for, and it can stop."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from glissando.errors import PlanWarning
from glissando.geometry import se3
from glissando.model.sensors.sensors import CoilReadings
from glissando.planning.planners import PlannerExitedError, ProcessPlanner
from glissando.planning.scene.error_belief import ErrorBelief
from glissando.planning.scene.obstacles import sphere
from glissando.planning.scene.plan_motion import motion_problem, plan_motion
from glissando.planning.scene.replan_motion import MotionReplanner, continue_motion
from motion_scenes import COIL, ROBOT, small_scene

STEP = 0.5  # s between commands


@pytest.fixture(scope="module")
def plan():
    """A motion past a ball."""
    scene = small_scene([sphere(np.array([0.025, 0.012, 0.13]), 0.006)], horizon=6.0)
    return plan_motion(motion_problem(scene, ROBOT), candidates=1, iterations=10)


def carried_out(replanner, rng, error):
    """Times and values of all commands, of a robot that is off its model by `error` (q,)."""
    problem, end = replanner.plan.problem, replanner.plan.problem.scene.horizon
    std = np.sqrt(np.diagonal(COIL.readings(np.eye(4)[None], *np.zeros((2, 1))).cov))
    times, rows = [], []
    for time in np.arange(0.0, end + 1e-9, STEP):
        replanner.command(time)
        fine = time - STEP * np.linspace(0.9, 0.0, 10)
        values = replanner.at(fine)
        times.append(fine)
        rows.append(values)
        shape = problem.body.shapes(values[-1:, :6], error[None])
        place = np.full(round(COIL.rate * STEP), values[-1, 6])
        noise = np.pad(std * rng.standard_normal((place.size, 5)), ((0, 0), (0, 1)))
        read = shape.pose_at(place[:1])[0] @ se3.exp(noise)
        replanner.advance(time)
        replanner.add(CoilReadings(time=np.full(place.size, time), arclength=place,
                                   values=read, cov=COIL.cov))  # fmt: skip
    return np.concatenate(times), np.concatenate(rows)


class Gone:
    """A planner whose process ends."""

    def submit(self, task):
        pass

    def result(self):
        raise PlannerExitedError("The planner's process has ended.")


@pytest.mark.slow
def test_the_last_plan_goes_on_where_the_planner_ends(plan):
    replanner = MotionReplanner(plan, every=1.0, planner=Gone())
    with pytest.warns(PlanWarning, match="process has ended; the last plan goes on"):
        values = [replanner.command(time) for time in np.arange(0.0, 4.0, STEP)]
    assert np.all(np.isfinite(values))
    assert replanner.plans == 0


class Late(Gone):
    """A planner whose first plan comes when the loop has gone past where it begins."""

    asked = 0

    def result(self):
        self.asked += 1
        return SimpleNamespace(plan=None) if self.asked == 4 else None


@pytest.mark.slow
def test_a_plan_that_comes_late_is_said_and_not_followed(plan):
    replanner = MotionReplanner(plan, every=0.9, planner=Late())
    with pytest.warns(PlanWarning, match="came later than that and is not followed"):
        _ = [replanner.command(time) for time in np.arange(0.0, 4.0, STEP)]
    assert replanner.plans == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_commands_go_on_from_plan_to_plan_within_the_limits(plan, seed):
    rng = np.random.default_rng(seed)
    replanner = MotionReplanner(plan, every=1.0)
    error = 0.7 * rng.standard_normal(plan.problem.body.errors)
    time, values = carried_out(replanner, rng, error)
    assert replanner.plans >= 2
    assert 0.0 <= replanner.spent <= plan.problem.scene.delta
    actuators = [*plan.problem.scene.tendons, *plan.problem.scene.slides]
    for column, actuator in zip(values.T, actuators, strict=True):
        assert column.min() >= actuator.lower - 1e-9
        assert column.max() <= actuator.upper + 1e-9
    slide = plan.problem.scene.slides[0]
    assert np.abs(np.diff(values[:, 6])).max() <= slide.speed * np.diff(time).max() * 1.01


@pytest.mark.slow
def test_a_plan_in_another_process_begins_where_it_was_said_to(plan):
    replanner = MotionReplanner(plan, every=1.0, lead=1.0)
    with ProcessPlanner() as replanner.planner:
        for time in np.arange(0.0, 3.0, STEP):
            replanner.command(time)
            replanner.advance(time)
            if replanner._due is not None and replanner._replanned is None:
                assert replanner.planner.ready(60.0)
    assert replanner.plans == 1
    assert replanner.begun == pytest.approx(2.0)


@pytest.mark.slow
def test_the_example_closes_the_loop_with_a_robot_that_is_off_its_model():
    example = Path(__file__).parents[2] / "examples" / "scene" / "closed_loop.py"
    run = subprocess.run([sys.executable, example, "3"], capture_output=True, text=True, check=True)
    *_, last, end = run.stdout.splitlines()
    assert end.startswith("It came to rest ")
    assert float(end.split()[4]) == float(last.split()[3]) < 3.0, last  # mm


def state_at(plan, time):
    """Values and speeds (C,) of all actuators at a time of a plan."""
    commands, k = plan.commands()[1], round(20.0 * time)
    return commands[k], (commands[k] - commands[k - 1]) / 0.05


def known_well(problem):
    """A belief in which a model error is known to a tenth."""
    size = problem.body.errors
    return ErrorBelief(np.zeros(size), 0.01 * np.eye(size))


@pytest.mark.slow
def test_where_no_motion_on_is_safe_the_robot_comes_to_rest(plan):
    problem, start = plan.problem, 0.5
    ball = sphere(plan.evaluation.tip[-1], 0.006)
    blocked = replace(problem, scene=replace(problem.scene, obstacles=[ball]))
    values, speed = state_at(plan, start)
    found = continue_motion(
        replace(plan, problem=blocked), start, (values, speed), known_well(problem), 0.05
    )
    assert "stops" in found.stopped
    assert not found.exceeded
    assert found.plan.risk < 0.05
    sharpest = np.array([a.acceleration for a in (*problem.scene.tendons, *problem.scene.slides)])
    moved = np.abs(found.plan.evaluation.values[-1] - values)
    step = found.plan.problem.space.paths[0].step
    np.testing.assert_array_less(moved, speed**2 / sharpest + np.abs(speed) * step + 1e-9)


@pytest.mark.slow
def test_what_is_known_better_lets_the_rest_be_no_riskier(plan):
    found = continue_motion(plan, 1.0, state_at(plan, 1.0), known_well(plan.problem), 0.05)
    assert not found.stopped
    assert not found.exceeded
    assert found.plan.risk <= 0.05
    assert 0.0 <= found.spent <= plan.risk + 0.01


@pytest.mark.slow
def test_where_to_stop_is_no_safer_it_goes_on_and_says_so(plan):
    problem, start = plan.problem, 0.5
    values, speed = state_at(plan, start)
    here = problem.body.shapes(values[None, :6]).place[0, -1]
    blocked = replace(problem, scene=replace(problem.scene, obstacles=[sphere(here, 0.004)]))
    found = continue_motion(
        replace(plan, problem=blocked), start, (values, speed), known_well(problem), 0.05
    )
    assert "no safer" in found.exceeded
    assert not found.stopped
    assert found.plan.risk > 0.05
