"""What is thinner than the gap between two places of the body is seen by starts, risk and bound."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.errors import GlissandoError
from glissando.planning.scene.motion_starts import require_possible_start
from glissando.planning.scene.obstacles import sphere
from glissando.planning.scene.plan_motion import motion_problem
from glissando.planning.scene.sampled_risk import sample_risk
from motion_scenes import ROBOT, any_problem, small_scene


@pytest.mark.parametrize("radius", [0.004, 5e-4])
@pytest.mark.parametrize("along", np.linspace(0.1, 0.106, 7))
def test_a_speck_in_the_body_is_found_at_the_start(along, radius):
    speck = sphere(np.array([0.9 * radius, 0.0, along]), 1e-5)
    problem = motion_problem(small_scene([speck], robot_radius=radius), ROBOT)
    with pytest.raises(GlissandoError, match="starts in collision"):
        require_possible_start(problem)


def beside_a_gap(rng):
    """A problem with a speck beside the middle between two places, and the motion it is near."""
    problem, control = any_problem(rng, obstacles=[])
    at = problem.evaluate(control)
    moment, body = len(at.values) - 1, problem.body
    n = len(body.step) - 1 - int(rng.integers(0, 3))
    pose = at.shapes.pose_at(body.arclength[n : n + 1] + 0.5 * body.step[n])[moment, 0]
    across = pose[:3, :2] @ rng.standard_normal(2)
    away = problem.scene.robot_radius + rng.uniform(0.0, 3e-3)
    speck = sphere(pose[:3, 3] + away * across / np.linalg.norm(across), 2e-4)
    return replace(problem, scene=replace(problem.scene, obstacles=[speck])), control


@pytest.mark.parametrize("seed", range(4))
def test_the_risk_is_that_of_many_more_places_and_the_bound_is_above_it(seed):
    problem, control = beside_a_gap(np.random.default_rng(seed))
    at = problem.evaluate(control)
    closer = replace(problem, body=replace(problem.body, steps=200 * problem.body.steps))
    risk, std = sample_risk(problem, at)
    true = sample_risk(closer, closer.evaluate(control))[0]
    assert true > 5e-3
    assert risk == pytest.approx(true, rel=0.1, abs=1e-3)
    assert at.hits.value > risk - 4.0 * std
