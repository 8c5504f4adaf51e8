"""Fibres whose cores are stated wrong are found beside a tracked body, and sound ones pass."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glissando import FbgReadings, PositionReadings, load_robot, se3
from glissando.evaluation.plausibility.examine import examine
from glissando.evaluation.plausibility.fibre import check_fibres
from glissando.evaluation.plausibility.session import Streams

ROBOT = load_robot("tdcr466")
LOADED = Path(__file__).parents[2] / "benchmarks" / "real.toml"  # loads act at a point of it
TIME = np.arange(0.0, 4.0, 0.1)
PLACES = (np.arange(20) + 0.5) * ROBOT.length / 20
STEPS = 100
RADIUS, ANGLE = np.array([35e-6] * 3 + [0.0]), np.array([0.0, 2.0, 4.0, 0.0]) * np.pi / 3.0
ROTATED = [1, 2, 0, 3]
MISTAKES = {
    "columns are probably of other cores, those of 2, 0, 1, 3": lambda fibre: {
        "values": fibre.values[:, ROTATED]
    },
    "core angles probably run from x to −y": lambda fibre: {"core_angle": -ANGLE},
    "strains probably have the other sign": lambda fibre: {"values": -fibre.values},
    "core angles are probably 90 degrees too large": lambda fibre: {
        "core_angle": ANGLE + np.pi / 2.0
    },
    "core radii should probably be 0.5 times as large": lambda fibre: {"core_radius": 2.0 * RADIUS},
    "core radii should probably be 10 times as large": lambda fibre: {"core_radius": 0.1 * RADIUS},
}


def session(seed, twist=0.0, warm=0.0):
    """A fibre along a robot that bends at random, and where its tip is; twisted by a total."""
    rng = np.random.default_rng(seed)
    sizes = np.array([3.0, 1.5, 0.7]) * rng.standard_normal((2, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, 3))

    def bends(time, place):
        waves = np.cos(np.pi * np.arange(3) * place[..., None, None] / ROBOT.length)
        return np.sum(sizes * (1.0 + 0.5 * np.sin(time[..., None, None] + phase)) * waves, axis=-1)

    step = ROBOT.length / STEPS
    strain = np.zeros((TIME.size, STEPS, 6))
    strain[..., 2], strain[..., 5] = 1.0, twist / ROBOT.length
    middle = step * (np.arange(STEPS) + 0.5)
    strain[..., 3:5] = bends(*np.broadcast_arrays(TIME[:, None], middle))
    tip = np.tile(np.eye(4), (TIME.size, 1, 1))
    for k in range(STEPS):
        tip = tip @ se3.exp(step * strain[:, k])
    time, place = np.repeat(TIME, PLACES.size), np.tile(PLACES, TIME.size)
    u = bends(time, place)[:, None]
    values = warm + RADIUS * (u[..., 0] * np.sin(ANGLE) - u[..., 1] * np.cos(ANGLE))
    values += 2e-6 * rng.standard_normal(values.shape)
    cores = {"core_radius": RADIUS, "core_angle": ANGLE, "cov": (2e-6) ** 2, "name": "fibre"}
    fibre = FbgReadings(time=time, arclength=place, values=values, **cores)
    seen = tip[:, :3, 3] + 1e-3 * rng.standard_normal((TIME.size, 3))
    at = {"time": TIME, "arclength": np.full(TIME.size, ROBOT.length), "name": "tip"}
    return fibre, PositionReadings(**at, values=seen, cov=np.full(3, 1e-6))


@pytest.mark.parametrize("cause", MISTAKES)
def test_cores_that_are_stated_wrong_are_named(cause):
    for seed in range(1, 5):
        fibre, tip = session(seed)
        wrong = replace(fibre, **MISTAKES[cause](fibre))
        (finding,) = check_fibres(Streams(ROBOT, (wrong,), (tip,)))
        assert cause in finding.sentence
        assert finding.refusal


@pytest.mark.parametrize(
    "robot", ["tdcr466", "tdcr466-segments", LOADED], ids=["one", "two", "rod"]
)
def test_robots_of_every_prior_are_checked(robot):
    fibre, tip = session(1)
    wrong = replace(fibre, core_angle=-ANGLE)
    assert len(list(check_fibres(Streams(load_robot(robot), (wrong,), (tip,))))) == 1


def test_sound_fibres_pass_warm_and_twisted_and_without_a_body():
    for seed in range(20):
        fibre, tip = session(seed, twist=(-0.4, 0.0, 0.4)[seed % 3], warm=1e-4)
        assert not list(check_fibres(Streams(ROBOT, (fibre, tip))))
        assert not list(check_fibres(Streams(ROBOT, (fibre,))))


def test_the_guard_asks_and_a_name_allows_it():
    fibre, tip = session(1)
    wrong = replace(fibre, core_angle=-ANGLE)
    assert [f.name for f in examine(ROBOT, [wrong], [tip])] == ["fibre"]
    assert examine(ROBOT, [wrong], [tip], allow=["fibre"]) == []
