"""Receding horizon: plan after plan from a running smoother, within the limits, after the zone."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from glissando import FixedLagSmoother
from glissando.errors import PlanWarning
from glissando.planning import PathSpace, Replanner, Zone, sliding_sensor
from plans import LENGTH, ROBOTS, SEPARABLE

REACH, SPEED, ACCELERATION, EVERY = (0.3, LENGTH), 0.06, 0.3, 0.5


def read_straight(replanner, since, until):
    time = np.arange(since + 0.0125, until + 1e-9, 0.025)
    place = replanner.at(time)[0]
    pose = np.tile(np.eye(4), (time.size, 1, 1))
    pose[:, 2, 3] = place
    return replanner.sensor.readings(pose, place, time)


def followed(robot, zone, until, every=EVERY):
    """Times, places and speeds of the sensor every 20 ms, planned anew after every update."""
    track = PathSpace(*REACH, SPEED, ACCELERATION, 0.1, 30, LENGTH)
    replanner = Replanner(sliding_sensor(robot), track, [zone], node_step=0.5)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=3, gate=None)
    out = []
    for update in np.arange(0.0, until, every):
        smoother.add(read_straight(replanner, update - every, update))
        smoother.advance(update)
        replanner.next(smoother)
        time = update + np.arange(0.0, every - 1e-9, 0.02)
        out.append([time, *replanner.at(time)])
    return np.concatenate(out, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "every"), [("separable", 0.5), ("kinematic", 0.37)])
def test_plans_that_follow_each_other_keep_every_limit_and_follow_the_zone(kind, every):
    """Also when they begin between the knots of the one before."""

    def moving(time):
        middle = 0.6 - 0.5 * SPEED * np.maximum(time - 2.0, 0.0)
        return middle - 0.02, middle + 0.02

    time, place, speed = followed(ROBOTS[kind], Zone(moving), 8.0, every)
    assert place.min() >= REACH[0] - 1e-9
    assert place.max() <= REACH[1] + 1e-9
    assert np.abs(speed).max() <= SPEED * (1 + 1e-6)
    step = np.diff(time)
    assert np.abs(np.diff(speed) / step).max() <= ACCELERATION * (1 + 1e-5)
    np.testing.assert_allclose(np.diff(place), 0.5 * step * (speed[1:] + speed[:-1]), atol=1e-5)
    late = time > 4.0
    off = place[late] - np.mean(moving(time[late]), axis=0)
    assert np.sqrt(np.mean(off**2)) < 0.04


def test_a_plan_that_comes_late_goes_on_and_comes_to_rest_on_the_slide():
    track = PathSpace(*REACH, SPEED, ACCELERATION, 0.1, 30, LENGTH)
    replanner = Replanner(sliding_sensor(SEPARABLE), track, [Zone((0.3, 0.4))], node_step=0.5)
    smoother = FixedLagSmoother(SEPARABLE.prior, SEPARABLE.arclength_nodes, gate=None)
    smoother.advance(0.0)
    plan = replanner.next(smoother)
    place, speed = plan.at([plan.start + 3.0, plan.start + 99.0])
    assert speed == pytest.approx(0.0, abs=1e-12)
    assert place[0] == place[1]
    assert REACH[0] <= place[0] <= REACH[1]


def test_zones_that_are_over_are_told_in_a_sentence():
    track = PathSpace(*REACH, SPEED, ACCELERATION, 0.1, 30, LENGTH)
    replanner = Replanner(sliding_sensor(SEPARABLE), track, [Zone((0.3, 0.4), (0.0, 1.0))])
    smoother = FixedLagSmoother(SEPARABLE.prior, SEPARABLE.arclength_nodes, gate=None)
    smoother.advance(5.0)
    with pytest.warns(PlanWarning, match="No zone counts between 5 and 8 s"):
        assert replanner.next(smoother) is None
    assert replanner.next(smoother) is None  # and says it once
    assert replanner.at(7.0)[0] == LENGTH


@pytest.mark.slow
def test_the_example_of_a_closed_loop_runs_and_gains_on_a_sensor_that_oscillates():
    script = Path(__file__).parents[2] / "examples" / "closed_loop.py"
    assert len(script.read_text().splitlines()) <= 40
    command = [sys.executable, str(script), "4"]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    planned, blind = ([float(w) for w in re.findall(r"[\d.]+ ", o)] for o in out.splitlines())
    assert planned[0] < blind[0]
    assert planned[1] < 3.0 * planned[0]


@pytest.mark.slow
def test_the_example_on_simulated_devices_closes_the_loop():
    script = Path(__file__).parents[2] / "examples" / "closed_loop_rig.py"
    command = [sys.executable, "-W", "ignore", str(script), "6"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if "did not answer" in ran.stderr:
        pytest.skip("the host is too busy for devices that keep time")
    assert ran.returncode == 0, ran.stderr
    known = [float(sigma) for sigma in re.findall(r"± ([\d.]+) mm", ran.stdout)]
    assert len(known) > 5
    assert min(known) < 0.01 * known[0]
