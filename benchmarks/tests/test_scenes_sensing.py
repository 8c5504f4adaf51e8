"""The slits of `benchmarks/scenes.py sensing`: what a slide knows there, and given actuators."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import scenes_sensing
from glissando import load_robot
from glissando.planning.scene.motion_starts import reach_target
from glissando.planning.scene.plan_motion import motion_problem
from scenes_sensing import GAPS, drawn_passage, with_given

ROBOT = load_robot(Path(scenes_sensing.__file__).with_suffix(".toml"))


def straight(problem):
    """Straight to the target, the slide at its start."""
    space = problem.space
    ends = np.append(reach_target(problem, 0), space.paths[-1].start)
    start = np.array([path.start for path in space.paths])
    share = np.clip(space.paths[0].control_times / problem.scene.horizon, 0.0, 1.0)
    return space.follow(start[:, None] + np.outer(ends - start, share))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_by_way_of_the_middle_both_slits_are_known_and_from_no_fixed_place(seed):
    """Standard deviations over clearances: below one half by way, above it in one slit if held."""
    problem = motion_problem(drawn_passage(ROBOT, seed), ROBOT)
    control, length = straight(problem), ROBOT.length
    time = problem.space.paths[-1].control_times

    def widest(slide):
        moved = control.copy()
        moved[-1] = slide
        at = problem.evaluate(moved)
        std, mean = at.clearances.std()[:, -1], at.clearances.mean[:, -1]
        nearest = np.argmin(mean, axis=1)
        return max(std[k, nearest[k]] / gap for k, gap in zip((0, 2), GAPS, strict=True))

    way = np.interp(time, [0.0, 2.0, 4.0, 8.0], np.array([0.7, 0.5, 0.5, 1.0]) * length)
    held = min(widest(np.full(time.size, share * length)) for share in np.linspace(0.4, 1.0, 13))
    assert widest(problem.space.follow(np.vstack([control[:-1], way]))[-1]) < 0.5
    assert held > 0.6


def test_given_actuators_stay_and_have_no_slope():
    problem = motion_problem(replace(drawn_passage(ROBOT, 1), obstacles=[]), ROBOT)
    control = straight(problem)
    given = with_given(problem, [0, -1], control)
    free = given.space.free(control) + 0.01
    moved = given.space.control(free)
    assert np.array_equal(moved[[0, -1]], control[[0, -1]])
    assert not np.allclose(moved[1], control[1])
    slope = given.gradients(given.evaluate(moved))[0].reshape(len(control), -1)
    assert np.all(slope[[0, -1]] == 0.0)
    assert np.all(np.any(slope[1:-1] != 0.0, axis=1))
