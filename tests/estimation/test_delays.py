"""A delay is known by the streams that do not have it, and by nothing else."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from glissando import FixedLagSmoother, PoseReadings, SensorParameter, estimate, load_robot
from glissando.evaluation.prior_predictive import PriorPredictive
from unknown_scenes import consistent

ROBOT = Path(__file__).parents[2] / "benchmarks" / "sbc.toml"
RATE, UNTIL, STD = 16.0, 1.5, 0.02
NOISE = np.repeat([1e-3, 1e-2], 3) ** 2
LATE = {"both": ("middle", "tip"), "tip": ("tip",), "middle": ("middle",)}


@cache
def scene(which):
    """The delay, and sessions of two trackers that have it or not, drawn from the prior."""
    robot = load_robot(str(ROBOT))
    late = SensorParameter("late", "time_offset", LATE[which], np.zeros(1), np.array([STD]))
    nodes = np.linspace(0.0, robot.length, 3)
    robot = replace(robot, sensor_parameters=(late,), arclength_nodes=nodes, time_rate=RATE)
    time = np.arange(0.1, UNTIL - 0.1, 1.0 / RATE)
    layout = [
        PoseReadings(
            time=time,
            arclength=np.full(time.size, place),
            values=np.tile(np.eye(4), (time.size, 1, 1)),
            cov=NOISE,
            name=name,
        )
        for name, place in (("middle", robot.length / 2), ("tip", robot.length))
    ]
    return late, PriorPredictive(robot, robot.grid(0.0, UNTIL), layout)


def estimated(which, seed, stated=STD, shift=0.0, *, online=False):
    """The delay that was drawn, the estimated one and its standard deviation."""
    late, predictive = scene(which)
    session = predictive.draw(np.random.default_rng(seed))
    readings = [r.changed(time=r.time + shift) for r in session.readings]
    late = replace(late, std=np.array([stated]))
    prior, grid = predictive.robot.prior, predictive.robot.grid(-0.3, UNTIL + 0.3)
    if online:
        posterior = heard(prior, grid, readings, late)
    else:
        posterior = estimate(prior, grid, readings, sensor_parameters=[late], gate=None)
    values, cov = posterior.parameter("late")
    middle = len(values) // 2
    return session.parameters[0, 0], values[middle, 0], np.sqrt(cov[middle, 0, 0])


def heard(prior, grid, readings, late):
    """The window at the end of a session that came in as it was measured."""
    smoother = FixedLagSmoother(
        prior, grid.arclength, window=8, sensor_parameters=[late], gate=None
    )
    before = -np.inf
    for now in grid.time:
        for r in readings:
            new = (r.time > before) & (r.time <= now)
            if new.any():
                smoother.add(r.select(np.flatnonzero(new)))
        smoother.advance(now)
        before = now
    return smoother.posterior()


@pytest.mark.parametrize("online", [False, True])
@pytest.mark.parametrize(("stated", "shift"), [(0.02, 0.0), (0.2, 0.1)])
def test_a_delay_that_all_streams_share_stays_as_uncertain_as_before(stated, shift, online):
    _, value, std = estimated("both", 0, stated, shift, online=online)
    assert std == pytest.approx(stated, rel=0.1)
    assert abs(value) < stated


@pytest.mark.slow
@pytest.mark.parametrize(("which", "online"), [("tip", False), ("middle", False), ("tip", True)])
def test_a_delay_that_another_stream_shows_is_as_uncertain_as_stated(which, online):
    found = [estimated(which, seed, online=online) for seed in range(100, 114)]
    drawn, values, std = np.array(found).T
    squares = ((values - drawn) / std) ** 2
    assert std.max() < STD / 2.0
    assert consistent(squares, squares.size)
    assert not consistent(9.0 * squares, squares.size)
