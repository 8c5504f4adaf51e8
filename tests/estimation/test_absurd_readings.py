"""Readings that no shape of the robot explains: a live loop outlives them, and soon."""

import warnings
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from draws import generators, law
from glissando import (
    BaseVariance,
    CoilReadings,
    PoseReadings,
    PositionReadings,
    SeparablePrior,
    load_robot,
)
from glissando.estimation import gated_update, several_starts
from glissando.estimation.batch import estimate_in_passing
from glissando.estimation.bent_starts import bent_starts
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.geometry import se3
from glissando.io.shipped_robots import shipped_robots

REAL = Path(__file__).parents[2] / "benchmarks" / "real.toml"  # of a real robot, with mechanics
UPDATES = 12


def straight(place):
    """Poses (M, 4, 4) at places (M,) of a straight robot."""
    return se3.exp(np.multiply.outer(place, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))


def strange(rng, time, length, count, wild):
    """Readings of a sensor of any kind, some right, the others anywhere and turned any way."""
    place = rng.uniform(0.0, length, count)
    off = np.concatenate([wild * length * np.ones(3), rng.uniform(0.0, np.pi) * np.ones(3)])
    off = off * (rng.uniform(size=(count, 1)) < 0.5) + 1e-3
    pose = straight(place) @ se3.exp(off * rng.standard_normal((count, 6)))
    at = {"time": np.sort(time - rng.uniform(0.0, 0.2, count)), "arclength": place}
    readings = (
        PoseReadings(**at, values=pose, cov=1e-6, name="pose"),
        CoilReadings(**at, values=pose, cov=1e-6, name="coil"),
        PositionReadings(**at, values=pose[:, :3, 3], cov=1e-6, name="marker"),
    )
    return readings[rng.integers(3)]


def test_arclengths_in_millimetres_are_named_once():
    robot = load_robot("tdcr466")
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for time in np.arange(5) / 10.0:
            smoother.add(
                PositionReadings(
                    time=[time], arclength=[466.0], values=[[0.0, 0.0, 0.466]], cov=1e-6, name="tip"
                )
            )
            smoother.advance(float(time))
    (said,) = (str(w.message) for w in caught)
    assert said == (
        "tip reads at 466 m of a robot of 0.466 m and is left out; give metres, not millimetres."
    )
    assert smoother.dropped["tip"]["off the robot"] == 5


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The window began again", "ignore:The estimate is")
@pytest.mark.parametrize("seed", range(6))
def test_no_reading_ends_a_loop_and_each_is_counted(seed):
    rng = np.random.default_rng(seed)
    robot = load_robot(shipped_robots()[seed % len(shipped_robots())])
    gate = 1e-6 if seed % 3 else None
    window, wild, time = int(rng.integers(1, 6)), 10.0 ** rng.uniform(-2.0, 1.0), 0.0
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=window, gate=gate)
    smoother.add(strange(rng, time, robot.length, 1, 0.0))
    smoother.advance(time)
    for _ in range(UPDATES):
        time += 10.0 ** rng.uniform(-2.0, 0.5)
        if count := int(rng.integers(0, 5)):
            smoother.add(strange(rng, time, robot.length, count, wild))
        newest = smoother.advance(time)
        assert np.isfinite(newest.pose).all()
        assert np.linalg.eigvalsh(newest.cov).min() > -1e-9 * np.abs(newest.cov).max()


@pytest.mark.slow
def test_a_tracker_in_another_frame_has_other_shapes_tried_rarely(monkeypatch):
    """They cost hundreds of updates, and such readings come at every update."""
    tried = []

    def counted(*given):
        tried.append(given)
        return bent_starts(*given)

    monkeypatch.setattr(several_starts, "bent_starts", counted)
    robot = load_robot("tdcr466-segments")
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=2)
    place = np.array([0.1, robot.length])
    for k, side in zip(range(30), cycle([0.2, -0.2]), strict=False):
        pose = straight(place)
        pose[:, :3, 3] += [0.3, side, 0.0]
        both = {"time": [0.1 * k, 0.1 * k], "arclength": place, "values": pose}
        smoother.add(PoseReadings(**both, cov=1e-6, name="tip"))
        smoother.advance(0.1 * k)
    assert 1 <= len(tried) <= 4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdcr466", "sliding700"])
def test_a_robot_beyond_its_reach_is_said_to_be_so_once_and_does_not_fit(name):
    """A coil in a frame 0.6 m off is followed as closely as a right one, and as sure."""
    robot, rng = load_robot(name), np.random.default_rng(0)
    std = np.sqrt(np.repeat([5e-7, 4e-5], [3, 2]))
    bent = se3.exp(robot.length * np.array([0.0, 0.0, 1.0, 0.0, 1.0, 0.0]))
    for off in (0.0, 0.6):
        smoother, said = FixedLagSmoother(robot.prior, robot.arclength_nodes), []
        for now in np.arange(30) / 30.0:
            noise = np.append(std * rng.standard_normal(5), 0.0)
            seen = bent @ se3.exp(noise)
            seen[0, 3] += off
            smoother.add(CoilReadings(
                time=[now], arclength=[robot.length], values=seen[None], cov=std**2, name="coil"
            ))  # fmt: skip
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                smoother.advance(now)
            said += [str(each.message) for each in caught]
        assert smoother.fits == (not off)
        assert len([text for text in said if "beyond its reach" in text]) == bool(off)


@settings(law, max_examples=3)
@given(generators)
def test_a_base_that_moves_as_far_as_stated_is_within_reach(rng):
    """Beyond reach is counted from where the base may be, not from where it is expected."""
    psd, std = np.array([1e-7] * 3 + [10.0, 10.0, 1.0]), rng.uniform(0.02, 0.1)
    base = BaseVariance(np.array([std**2] * 3 + [1e-4] * 3), np.array([1e-7] * 3 + [10.0] * 3))
    smoother = FixedLagSmoother(SeparablePrior(psd, 0.5, base), np.linspace(0.0, 0.3, 5))
    way = rng.standard_normal(3)
    way *= 2.5 * std / np.linalg.norm(way)
    for now in np.arange(12) / 20.0:
        for name, place in (("base", 0.0), ("tip", 0.3)):
            pose = straight([place])
            pose[0, :3, 3] += way * np.sin(3.0 * now)
            smoother.add(
                PoseReadings(time=[now], arclength=[place], values=pose, cov=1e-6, name=name)
            )
        smoother.advance(now)
        assert smoother.fits


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The window began again", "ignore:The estimate is")
@pytest.mark.parametrize("seed", [1, 5, 6])
def test_a_loop_that_was_misled_returns_without_a_detour(seed):
    """Steps that diverge are no estimate: the tip is never farther away than what was read."""
    robot, rng = load_robot("sliding700"), np.random.default_rng(seed)
    std = np.sqrt(np.repeat([5e-7, 4e-5], [3, 2]))
    smoother, off = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=4), []
    for k, now in enumerate(np.arange(30) / 20.0):
        seen = straight([robot.length]) @ se3.exp(np.append(std * rng.standard_normal(5), 0.0))
        if k < 10:  # twice as far as the robot reaches
            seen[:, :3, 3] *= 2.0
        smoother.add(CoilReadings(
            time=[now], arclength=[robot.length], values=seen, cov=std**2, name="coil"
        ))  # fmt: skip
        tip = smoother.advance(now).position[-1]
        assert np.linalg.norm(tip) < 2.2 * robot.length
        off.append(np.linalg.norm(tip - seen[0, :3, 3]))
    assert max(off[-5:]) < 5e-3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The window began again", "ignore:The estimate is")
def test_a_loop_that_nothing_explains_searches_rarely(monkeypatch):
    """A search costs as much as many updates, so that one at every update delays the loop."""
    searches = []

    def counted(*given, **options):
        searches.append(given)
        return estimate_in_passing(*given, **options)

    monkeypatch.setattr(gated_update, "estimate_in_passing", counted)
    robot = load_robot(REAL)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=4)
    rng, std = np.random.default_rng(0), np.sqrt(np.repeat([5e-7, 4e-5], [3, 2]))
    for k in range(40):
        time = 0.075 * k + np.array([-0.05, -0.025, 0.0])
        seen = straight(np.full(3, robot.length))
        seen[:, :3, 3] *= 2.0
        seen = seen @ se3.exp(
            np.append(std * rng.standard_normal((3, 5)), np.zeros((3, 1)), axis=1)
        )
        smoother.add(
            CoilReadings(time=time, arclength=robot.length, values=seen, cov=std**2, name="tip")
        )
        smoother.advance(time[-1])
    assert 1 <= len(searches) <= 12
