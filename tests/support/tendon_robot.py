"""A small tendon robot for tests, and the same one for the simulator."""

from dataclasses import replace

import numpy as np

from glissando.errors import RobotFileError
from glissando.io.robot_file import parse_robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.table import Table
from glissando.model.tendons.replicate import Replicate
from glissando.simulation import Rod, Tendon

LENGTH, ENDS = 0.2, (0.1, 0.2)
STIFFNESS = [5e3, 5e3, 1e4, 3e-3, 3e-3, 2.3e-3]
NAMES = [f"servo_{j}" for j in range(6)]


def document(**tendons):
    """A robot file of two segments with three tendons each, as a dictionary."""
    return {
        "name": "pair",
        "length": LENGTH,
        "rest_strain": [0, 0, 1, 0, 0, 0],
        "mechanics": {"joints": [0.1], "stiffness": [STIFFNESS, STIFFNESS]},
        "tendons": {
            "names": NAMES,
            "radius": 0.0045,
            "angle": [0.0, 2.1, 4.2, 0.5, 2.6, 4.7],
            "end": [ENDS[0]] * 3 + [ENDS[1]] * 3,
            "stiffness": 1e4,
            "softness": 2e-4,
            **tendons,
        },
        "base": {"var_pose": [1e-8, 1e-6]},
        "prior": {
            "kind": "mechanical",
            "time_scale": 1.0,
            "psd_load": [1e-3, 1e-7],
            "psd_strain_error": [1e-9, 1e-3],
            "var_tip": [1e-3, 1e-8],
        },
        "grid": {"arclength_nodes": 9, "time_rate": 10.0},
        "sensors": {"position": {"std": [1e-3, 1e-3, 1e-3]}, "tendon": {"std": [2e-5]}},
        "sensor_parameters": [
            {"name": "m", "kind": "mount", "streams": ["tip"], "value": [0, 0, 0.008, 0, 0, 0]}
        ],
    }


def tendon_robot(**tendons):
    """The robot of that file."""
    return parse_robot(Table(document(**tendons), "pair.toml", RobotFileError))


def with_replicates(robot, count, seed):
    """A robot with replicates of its numbers, and the robots that these are, built by hand."""
    rng, tendons, prior = np.random.default_rng(seed), robot.tendons, robot.prior
    replicates, robots = [], []
    for _ in range(count):
        numbers = {
            "radius": tendons.radius * np.exp(0.03 * rng.standard_normal(6)),
            "angle": tendons.angle + 0.1 * rng.standard_normal(6),
            "stiffness": tendons.stiffness * np.exp(0.2 * rng.standard_normal(6)),
            "slack": 3e-4 * rng.standard_normal(6),
            "play": 1e-4 * np.abs(rng.standard_normal(6)),
            "softness": 2e-4 * np.exp(0.2 * rng.standard_normal()),
        }
        stiffness = prior.mechanics.stiffness * np.exp(0.1 * rng.standard_normal((2, 6)))
        rest = np.tile(prior.rest_strain, (2, 1)) + 0.3 * rng.standard_normal((2, 6))
        mount, frame = 0.01 * rng.standard_normal((2, 6))
        replicates.append(
            Replicate(
                **numbers, section_stiffness=stiffness, rest_strain=rest, mount=mount, frame=frame
            )
        )
        mechanics = replace(prior.mechanics, stiffness=stiffness)
        marker = [
            SensorParameter(name, name, ("tip",), value, np.zeros(6))
            for name, value in (("mount", mount), ("frame", frame))
        ]
        robots.append(
            replace(
                robot,
                tendons=replace(tendons, **numbers),
                mechanics=mechanics,
                prior=replace(prior, mechanics=mechanics, rest_strain=rest),
                sensor_parameters=tuple(marker),
            )
        )
    return replace(robot, tendons=replace(tendons, replicates=tuple(replicates))), robots


def simulated(robot):
    """Its rod and its tendons for the simulator."""
    t = robot.tendons
    tendons = []
    for radius, angle, pitch, end, mu in zip(
        t.radius, t.angle, t.pitch, t.end, t.friction, strict=True
    ):
        if np.isinf(pitch):
            place = radius * np.array([np.cos(angle), np.sin(angle)])
            tendons.append(Tendon(place, end, mu))
        else:
            tendons.append(Tendon.helical(radius, angle, pitch, end, mu))
    return Rod(LENGTH, np.array(STIFFNESS)), tendons


def pulls(rng, count, size=2e-3):
    """Displacements (count, 6) that pull some tendons and let others go, m."""
    return size * rng.uniform(-1.0, 1.0, (count, 6))
