"""Lag and compliance of a drive tube, found again by the estimator as parameters of the sensor."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import CoilReadings, Grid, SensorParameter, estimate, load_robot
from glissando.io.shipped_robots import robot_file
from glissando.model.slide_track import slide_motion
from glissando.simulation import SlideLimits, SlidePath, load_bench
from glissando.simulation.tracker import coil_rows
from unknown_scenes import consistent

BENCH = load_bench(robot_file("sliding700"))
STD = np.repeat([7e-4, 7e-3], [3, 2])  # of a common tracker
NOISE = {"jitter": np.sqrt(3) * STD[0], "jitter_angle": np.sqrt(2) * STD[-1], "field_size": 1e6}
RIGID = replace(BENCH.flaws.without("all"), **NOISE)
SOFT = {
    "drive_stiffness": 200.0,
    "drive_friction": 0.1,
    "drive_damping": 2.0,
    "drive_stiction": 1.0,
}
ASKED = [
    SensorParameter("lag", "slide_lag", ("coil",), [0.0], [0.05]),
    SensorParameter("play", "slide_play", ("coil",), [0.0], [5e-3]),
]


@pytest.fixture(scope="module")
def motion():
    return BENCH.move(BENCH.shape("C"), RIGID, 0)


def session(flaws, seed, motion):
    """A coil that slides to and fro on a robot that holds still, fast and slowly."""
    path = SlidePath.waypoints(
        [0.0, 2.0, 4.0, 8.0, 12.0], [0.0, 0.5, 0.0, 0.5, 0.1], SlideLimits(0.7, 0.5, 0.6)
    )
    time, rng = np.arange(0.0, path.duration, 1 / 40), np.random.default_rng(seed)
    rows = coil_rows(motion, path, time, 0.0, np.eye(4), flaws, rng)
    slide = {"arclength": rows.arclength, **slide_motion(rows.time, rows.arclength)}
    return CoilReadings(time=rows.time, values=rows.values, cov=STD**2, name="coil", **slide)


def answer(readings, asked):
    """The posterior of a robot that is believed to hold still."""
    prior = load_robot("sliding700").prior
    names = ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength")
    still = replace(prior, **{name: 1e-6 * getattr(prior, name) for name in names})
    grid = Grid(np.linspace(0.0, 0.7, 15), np.linspace(0.0, readings.time[-1], 8))
    return estimate(still, grid, [readings], sensor_parameters=asked)


def found(readings):
    """Values (2,) of lag and play, and their covariance's diagonal."""
    posterior = answer(readings, ASKED)
    each = [posterior.parameter(p.name) for p in ASKED]
    return np.array([(value[0, 0], cov[0, 0, 0]) for value, cov in each]).T


@pytest.mark.slow
def test_lag_and_play_of_drawn_sessions_are_found_as_surely_as_stated(motion):
    rng, squares = np.random.default_rng(0), []
    for seed in range(10):
        true = rng.uniform(0.0, [0.03, 2e-3])
        flaws = replace(RIGID, latency=true[0], backlash=true[1])  # of a tracker: it holds still
        value, variance = found(session(flaws, seed, motion))
        squares.append((value - true) ** 2 / variance)
    assert consistent(np.array(squares), 20)
    assert np.sqrt(variance[0]) < 2e-3
    assert np.sqrt(variance[1]) < 3e-4


@pytest.mark.slow
def test_a_soft_drive_tube_lags_by_its_damping_and_plays_by_its_friction(motion):
    value, variance = found(session(replace(RIGID, **SOFT), 0, motion))
    expected = np.array([2.0 / 200.0, 2.0 * 0.1 / 200.0])
    assert np.all(np.abs(value - expected) < 4.0 * np.sqrt(variance))
    assert np.all(value > 5.0 * np.sqrt(variance))


@pytest.mark.slow
def test_of_a_rigid_tube_neither_is_found_and_the_shape_stays(motion):
    readings = session(RIGID, 0, motion)
    value, variance = found(readings)
    assert np.all(np.abs(value) < 4.0 * np.sqrt(variance))
    where = np.linspace(0.0, 0.7, 8)
    with_it, without = (answer(readings, asked).at(where, 6.0) for asked in (ASKED, []))
    gap = np.linalg.norm(with_it.position - without.position, axis=1)
    assert np.all(gap[1:] < without.std_position[1:])
