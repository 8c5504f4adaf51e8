"""The weight of a robot is learned from how it bends while it hangs."""

from types import SimpleNamespace

import numpy as np
import pytest

from glissando import PoseReadings, uniform_grid
from glissando.calibration.robot.hyperparameters import expanded, learnable, moved
from glissando.calibration.robot.objective import Objective
from glissando.geometry import se3
from glissando.simulation import Loads, Rod, Wrench, solve_shape
from tendon_robot import LENGTH, STIFFNESS, document

MASS, LINEAR = 0.03, 0.3
NOISE = np.repeat([3e-4, 3e-3], 3)
DOWN = [0.0, 0.0, 9.81]


def hanging_robot(mass, linear, gravity=DOWN):
    """A robot file of one segment that knows its weight, and no tendons."""
    file = document()
    weight = {"mass_per_length": linear, "gravity": gravity, "tip": {"mass": mass}}
    weight["tip"]["center"] = [0.0, 0.0, 0.0]
    file["mechanics"] = {"stiffness": STIFFNESS, **weight}
    file["prior"] |= {"psd_load": [1e-7, 1e-11], "psd_strain_error": [1e-10, 1e-6]}
    file["prior"]["var_tip"] = [1e-6, 1e-4]
    file["base"] = {"position": [0, 0, 0], "quaternion": [1, 0, 0, 0], "var_pose": [1e-8, 1e-8]}
    return expanded({k: v for k, v in file.items() if k not in ("tendons", "sensor_parameters")})


def hanging(seed):
    """Tip and middle of a hanging rod that slow moments at its tip bend: readings and truth."""
    rng, time = np.random.default_rng(seed), np.linspace(0.0, 4.0, 17)
    rod = Rod(LENGTH, np.array(STIFFNESS), mass_per_length=LINEAR)
    angle = 2.0 * np.pi * rng.uniform(size=2)
    streams = ([], [])
    for t in time:
        moment = 0.02 * np.array([np.sin(1.2 * t + angle[0]), np.cos(0.9 * t + angle[1]), 0.0])
        weight = Wrench(LENGTH, MASS * np.array(DOWN), moment)
        shape = solve_shape(rod, [], Loads(gravity=np.array(DOWN), wrenches=[weight]))
        for stream, pose in zip(streams, shape.at([LENGTH, 0.5 * LENGTH]).pose, strict=True):
            stream.append(pose @ se3.exp(NOISE * rng.standard_normal(6)))
    tip, middle = (
        PoseReadings(
            time=time, arclength=np.full(17, s), values=np.array(v), cov=NOISE**2, name=name
        )
        for name, s, v in (("tip", LENGTH, streams[0]), ("middle", 0.5 * LENGTH, streams[1]))
    )
    return SimpleNamespace(
        grid=lambda robot: uniform_grid(LENGTH, 5, 0.0, 4.0, 4.0),
        readings=lambda robot: [tip],
        truth=lambda robot: [middle],
    )


@pytest.mark.slow
@pytest.mark.parametrize("label", ["mass of the tip", "mass per length"])
def test_a_wrong_weight_makes_the_truth_less_likely(label):
    start = hanging_robot(MASS, LINEAR)
    (number,) = (p for p in learnable(start, []) if p.label == label)
    objective = Objective([hanging(seed) for seed in range(2)], calibrate=False)
    factors = np.log([0.5, 1.0, 2.0])
    found = [
        objective.score(moved(start, [number], [x]), objective.start()).score.value for x in factors
    ]
    assert found[1] > max(found[0], found[2]) + 0.05


def test_weight_is_not_learned_where_it_does_not_show():
    labels = [p.label for p in learnable(hanging_robot(MASS, LINEAR), [])]
    assert {"mass of the tip", "mass per length"} <= set(labels)
    floating = hanging_robot(MASS, LINEAR, gravity=[0.0, 0.0, 0.0])
    assert not any("mass" in p.label for p in learnable(floating, []))
