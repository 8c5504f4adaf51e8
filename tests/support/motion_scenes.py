"""A small tendon robot with a sliding coil, and scenes for it."""

from dataclasses import replace

import numpy as np

from glissando import SensorParameter
from glissando.planning.scene.error_belief import ErrorBelief
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.motion_space import motion_space
from glissando.planning.scene.obstacles import HalfSpace, RoundedBox, capsule, sphere
from glissando.planning.scene.scene import Actuator, Scene, SpaceZone, Target, Weights
from glissando.planning.scene.sensor_errors import sensor_errors
from glissando.planning.scene.tendon_body import tendon_body
from glissando.planning.sliding_sensor import SlidingSensor
from tendon_robot import LENGTH, tendon_robot

ROBOT = tendon_robot(std=2e-4, psd_moment=2e-8)
HELD = replace(ROBOT, prior=replace(ROBOT.prior, var_base=np.full(6, 1e-12)))
LOOSE = replace(
    tendon_robot(std=2e-4, psd_moment=2e-8, play=[4e-4, 0.0, 0.0, 2e-4, 0.0, 0.0]),
    prior=replace(ROBOT.prior, var_base=np.repeat([1e-6, 4e-4], 3)),
)
UNSURE = replace(  # of where its coil sits, which drifts as well
    LOOSE,
    sensor_parameters=(
        SensorParameter("m", "mount", ("coil",), np.zeros(6), [1e-3] * 3 + [0.02] * 3),
        SensorParameter("d", "mount", ("coil",), np.zeros(6), [1e-3] * 3 + [0.0] * 3, 2.0),
        SensorParameter("f", "frame", ("coil",), np.zeros(6), [1e-3] * 6),
    ),
)
MOUNTED = replace(LOOSE, sensor_parameters=UNSURE.sensor_parameters[:1])
COIL = SlidingSensor(np.array([1e-3] * 3 + [0.01] * 2) ** 2, rate=20.0)
TENDON = Actuator(-2e-3, 4e-3, 4e-3, 4e-3, 0.0)
SLIDE = Actuator(0.05, LENGTH, 0.05, 0.1, 0.15)


def around(rng, count=3):
    """Obstacles of all kinds about the robot, some of them in its way."""
    placed = np.array([0.0, 0.0, 0.6 * LENGTH]) + 0.05 * rng.standard_normal((count + 4, 3))
    pose = np.eye(4)
    pose[:3, 3] = placed[0] + [0.06, 0.0, 0.0]
    return [
        HalfSpace(np.array([0.0, 0.12, 0.0]), np.array([0.0, -1.0, 0.0])),
        RoundedBox(pose, np.array([0.01, 0.02, 0.01]), 0.002),
        capsule(placed[1] - [0.07, 0.0, 0.0], placed[2] - [0.07, 0.0, 0.0], 0.004),
        *(sphere(np.add(at, [0.03, 0.0, 0.03]), 0.008) for at in placed[3 : 3 + count]),
    ]


def small_scene(obstacles, target=(0.03, 0.01, 0.19), **fields):
    """A scene of four seconds for `ROBOT`."""
    named = {"delta": 0.05, "robot_radius": 0.004, "horizon": 4.0, "correction": 0.5}
    named |= {"tendons": [TENDON] * 6, "slides": [SLIDE], "sensors": [COIL], **fields}
    return Scene(
        obstacles,
        [Target(np.array(target), 0.004, named["horizon"])],
        **named,
    )


def any_problem(rng, every=1, robot=ROBOT, **fields):
    """A problem with all terms, at a random belief, and a motion (C, S+2) within its limits.

    Commands are corrected twice a second, and motions judged at `every` times as many moments.
    """
    fields.setdefault("obstacles", around(rng))
    weights = Weights(accuracy=1.0, time=1.0, wear=0.3, information=1.0)
    zones = [
        SpaceZone(np.array([0.01, 0.01, 0.15]), 0.05),
        SpaceZone(arclength=(0.1, 0.15), weight=2.0),
    ]
    scene = small_scene(weights=weights, zones=zones, **fields)
    body = tendon_body(robot, 0.025)
    straight = body.shapes(np.zeros((1, len(body.rod.tendons)))).pose[0, -1]
    sensed, _ = sensor_errors(scene.sensors, robot, straight)
    size = body.errors + sensed.std.size
    root = 0.3 * rng.standard_normal((size, size))
    belief = ErrorBelief(0.5 * rng.standard_normal(size), root @ root.T + 0.1 * np.eye(size))
    space = motion_space(scene)
    space = space.with_moments(
        np.linspace(0.0, scene.horizon, every * (space.moments.size - 1) + 1)
    )
    times = space.paths[0].steps + 2
    pulled = rng.uniform(-1e-3, 3e-3, (6, times))
    control = space.follow(np.vstack([pulled, rng.uniform(0.05, LENGTH, (1, times))]))
    return MotionProblem(scene, body, belief, space, sensed=sensed), control
