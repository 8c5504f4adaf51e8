"""Scenes that are none are refused in a sentence, whoever makes them."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.errors import GlissandoError
from glissando.planning.scene.obstacles import sphere
from glissando.planning.scene.plan_motion import motion_problem, plan_motion
from glissando.planning.scene.scene import Actuator, SpaceZone, Target
from glissando.planning.scene.scene_checks import idle_obstacles
from motion_scenes import ROBOT, TENDON, small_scene

(SENSOR,) = small_scene([]).sensors
HERE, THERE = (0.03, 0.01, 0.19), (-0.03, 0.01, 0.19)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"delta": 5.0}, "delta of the scene is 5; give a probability"),
        ({"robot_radius": -0.004}, "robot_radius of the scene is -0.004"),
        ({"correction": 0.0}, "correction of the scene is 0.0"),
        ({"correction": 3.0}, "from 0.01 to half of it"),
        ({"horizon": float("nan")}, "horizon of the scene is nan"),
        ({"tendons": [TENDON] * 10}, "limits of 10 tendons, and robot .* has 6"),
        ({"sensors": []}, "1 slides and 0 sensors"),
        ({"targets": []}, "no target"),
        ({"targets": [Target(HERE, 0.004, 9.0)]}, "target is 9 s, and the motion lasts 4 s"),
        ({"targets": [Target(HERE, 0.004, 0.0)]}, "target is 0 s"),
        ({"targets": [Target((0.1, 0.2), 0.004, 4.0)]}, "give three numbers"),
        ({"targets": [Target(HERE, 4e-3, 4.0), Target(THERE, 3e-3, 4.0)]}, "60 mm apart are due"),
        ({"zones": [SpaceZone([5.0, 2.0, 9.0], 2.0)]}, "Zone 1 .* out of reach"),
        ({"tendons": [*[TENDON] * 5, replace(TENDON, start=0.01)]}, "Tendon 5 starts at 0.01 m"),
        ({"tendons": [*[TENDON] * 5, replace(TENDON, speed=0.0)]}, "a speed of 0 m/s"),
        (
            {"targets": [Target(HERE, 0.004, 4.0), Target(THERE, 0.004, 2.0)]},
            "in the order of time",
        ),
        ({"slides": [Actuator(0.0, 0.9, 0.05, 0.1, 0.8)]}, "0.9 m along a robot of 0.2 m"),
        ({"slides": [Actuator(-0.1, 0.1, 0.05, 0.1, 0.1)]}, "slide 1 go from -0.1 to 0.1 m"),
        ({"sensors": [replace(SENSOR, arclength_std=0.02)]}, "an arclength_std of 0.02 m"),
        ({"slides": [Actuator(0.15, 0.05, 0.05, 0.1, 0.1)]}, "limits of slide 1"),
    ],
)
def test_a_mistake_is_one_sentence(changes, sentence):
    with pytest.raises(GlissandoError, match=sentence):
        motion_problem(replace(small_scene([]), **changes), ROBOT)


def test_a_search_of_nothing_is_refused():
    with pytest.raises(GlissandoError, match="candidates and iterations are 0 and 60"):
        plan_motion(motion_problem(small_scene([]), ROBOT), candidates=0)


def test_an_obstacle_in_another_unit_is_said_to_be_out_of_reach():
    scene = small_scene([sphere(np.array([0.03, 0.0, 0.1]), 0.01), sphere([3.0, 0.8, 8.5], 1.2)])
    (said,) = idle_obstacles(scene, ROBOT)
    assert said.startswith("Obstacle 2 is 7.8")
    assert "are its numbers metres?" in said
