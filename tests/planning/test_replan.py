"""Receding horizon: plan after plan from a running smoother, within the limits, after the zone."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from glissando import FixedLagSmoother
from glissando.planning import Zone
from plans import ROBOTS, SPEED, read_between, replanner_of, require_limits

EXAMPLES = Path(__file__).parents[2] / "examples"


def followed(robot, zone, until, every):
    """Times, places and speeds of the sensor every 20 ms, planned anew after every update."""
    replanner = replanner_of(robot, [zone])
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=3, gate=None)
    out = []
    for now in np.arange(0.0, until, every):
        smoother.add(read_between(replanner.sensor, lambda t: replanner.at(t)[0], now - every, now))
        smoother.advance(now)
        replanner.next(smoother)
        time = now + np.arange(0.0, every - 1e-9, 0.02)
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
    require_limits(time, place, speed, slack=1e-5)
    late = time > 4.0
    off = place[late] - np.mean(moving(time[late]), axis=0)
    assert np.sqrt(np.mean(off**2)) < 0.04


@pytest.mark.slow
def test_the_example_of_a_closed_loop_runs_and_gains_on_a_sensor_that_oscillates():
    script = EXAMPLES / "closed_loop.py"
    assert len(script.read_text().splitlines()) <= 40
    command = [sys.executable, str(script), "4"]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    planned, blind = ([float(w) for w in re.findall(r"[\d.]+ ", o)] for o in out.splitlines())
    assert planned[0] < blind[0]
    assert planned[1] < 3.0 * planned[0]


@pytest.mark.slow
def test_the_example_on_simulated_devices_closes_the_loop():
    command = [sys.executable, "-W", "ignore", str(EXAMPLES / "closed_loop_rig.py"), "6"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if "did not answer" in ran.stderr:
        pytest.skip("the host is too busy for devices that keep time")
    assert ran.returncode == 0, ran.stderr
    known = [float(sigma) for sigma in re.findall(r"± ([\d.]+) mm", ran.stdout)]
    assert len(known) > 5
    assert known[0] < 700.0  # before any reading the tip may be as far as the robot is long
    assert min(known) < 0.03 * known[0]
