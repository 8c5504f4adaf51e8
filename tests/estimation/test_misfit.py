"""An estimate says so where its readings contradict it, and only there."""

import tomllib
import warnings
from dataclasses import replace

import numpy as np
import pytest

from glissando import Grid, Huber, PoseReadings, estimate, load_robot, se3, uniform_grid
from glissando.calibration.robot.hyperparameters import expanded
from glissando.errors import FalseConfidenceWarning, GlissandoError, OutsideGridError
from glissando.estimation.outliers import CHANCE
from glissando.estimation.solve_report import SolveReport
from glissando.io.robot_file import parse_robot
from glissando.io.robot_template import RobotOutline, robot_text
from glissando.model.table import Table
from learn_drawn import NOISE, readings, shipped
from scenes import LENGTH

TIME = np.linspace(0.0, 1.0, 41)


def streams(seed, cov, spoiled=0.0):
    """Poses at the base, the middle and the tip, of which a share of the last is 30 σ off."""
    rng = np.random.default_rng([seed, 9])
    places = enumerate((0.0, 0.5 * LENGTH, LENGTH))
    out = [readings(PoseReadings, f"p{i}", s, TIME, cov=cov, seed=[seed, i]) for i, s in places]
    off = rng.random(TIME.size) < spoiled
    out[2].values[off, :3, 3] += 30.0 * NOISE[:3] * rng.standard_normal((off.sum(), 3))
    return out


def slow():
    """A robot that moves about as slowly as the arc."""
    document = expanded(shipped("tdcr466"))
    for key in ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength"):
        document["prior"][key] = [1e-3 * v for v in document["prior"][key]]
    return parse_robot(Table(document, "slow", GlissandoError))


def estimated(given, robot=None, gate=None):
    """The estimate, and its warnings of false confidence."""
    robot = robot or slow()
    grid = uniform_grid(LENGTH, 3, 0.0, 1.0, 10.0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        posterior = estimate(robot.prior, grid, given, gate=gate)
    return posterior, [w for w in caught if issubclass(w.category, FalseConfidenceWarning)]


@pytest.mark.parametrize("seed", range(3))
def test_readings_as_noisy_as_they_say_are_no_reason_for_doubt(seed):
    posterior, caught = estimated(streams(seed, NOISE**2))
    assert not posterior.solve.doubt
    assert not caught


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_noise_that_is_said_to_be_four_times_smaller_is_named(seed):
    posterior, (caught,) = estimated(streams(seed, (0.25 * NOISE) ** 2))
    assert posterior.solve.doubt == str(caught.message)
    assert "its confidence is too small" in posterior.solve.doubt
    assert all(f"% of p{i}" in posterior.solve.doubt for i in range(3))
    table = posterior.solve.to_table()
    assert SolveReport.from_table(dict(table)).doubt == posterior.solve.doubt


@pytest.mark.parametrize(("stretch", "doubtful"), [(0.3, False), (0.02, True)])
def test_a_robot_that_is_squeezed_more_than_its_file_says_contradicts_it(stretch, doubtful):
    outline = RobotOutline("rod", LENGTH, 1, 0.01, np.pi, ["pose"], stretch=stretch)
    robot = parse_robot(Table(tomllib.loads(robot_text(outline)), "rod", GlissandoError))
    given = streams(0, NOISE**2)
    for stream in given:
        stream.values[:, 2, 3] *= 0.8
    posterior = estimated(given, robot)[0]
    assert bool(posterior.solve.doubt) == doubtful


def test_spoiled_readings_do_not_count_where_they_are_refused_or_forgiven():
    assert not estimated(streams(0, NOISE**2, spoiled=0.05), gate=CHANCE)[0].solve.doubt
    first, middle, tip = streams(0, NOISE**2, spoiled=0.3)
    tip = replace(tip, loss=Huber())
    assert not estimated([first, middle, tip])[0].solve.doubt


@pytest.mark.slow
def test_time_nodes_that_are_too_close_are_named():
    robot, time = load_robot("tdcr466-segments"), np.linspace(0.0, 1.0, 21)
    tip = readings(PoseReadings, "tip", robot.length, time, cov=1e-4, seed=3)
    for apart, close in ((1e-4, True), (5e-3, False)):
        grid = Grid(robot.arclength_nodes, np.sort(np.append(time, 0.4 + apart)))
        if not close:
            assert estimate(robot.prior, grid, [tip]).solve.converged
            continue
        with pytest.raises(OutsideGridError, match=r"nodes 8 and 9 at 0\.4 s are 0\.0001 s apart"):
            estimate(robot.prior, grid, [tip])


@pytest.mark.parametrize("count", [1, 3, 8])
def test_few_readings_that_an_estimate_misses_by_far_are_named(count):
    robot = slow()
    place = np.linspace(LENGTH / count, LENGTH, count)
    bent = se3.exp(place[:, None] * np.array([0.0, 0.0, 1.0, 0.0, 60.0, 0.0]))
    for poses, doubted in ((bent, True), (se3.exp(place[:, None] * [0, 0, 1.0, 0, 0, 0]), False)):
        grid = Grid(np.linspace(0.0, LENGTH, 3), [0.0])
        at = {"time": np.zeros(count), "arclength": place}
        given = PoseReadings(**at, values=poses, cov=NOISE**2, name="tip")
        stiff = replace(robot.prior, psd_strain_arclength=np.full(6, 1e-8))
        stiff = replace(stiff, base=replace(stiff.base, strain=np.full(6, 1e-8)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            posterior = estimate(stiff, grid, [given])
        assert bool(posterior.solve.doubt) == doubted
