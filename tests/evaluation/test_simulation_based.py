"""Simulation-based calibration: uniform ranks pass as often as they should, others are found."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from draws import generators, law, states
from glissando import CoilReadings, Grid, SensorParameter, load_robot, simulate
from glissando.cli.main import main
from glissando.errors import GlissandoError
from glissando.evaluation.prior_predictive import PriorPredictive, noisy_values, session_layout
from glissando.evaluation.simulation_based import (
    QUANTITIES,
    _estimated,
    bands,
    rank_checks,
    rank_points,
    scaled_prior,
    simulate_and_rank,
)
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.inertia import Inertia
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.sensors.parameter_process import ParameterValues
from glissando.model.sensors.readings import SENSORS
from glissando.model.tendons.channel import Channel
from glissando.simulation import write_session

ROBOT = Path(__file__).parents[2] / "benchmarks" / "sbc.toml"


@pytest.mark.parametrize("count", [50, 1000])
def test_uniform_ranks_leave_simultaneous_bands_as_rarely_as_stated(count):
    rng = np.random.default_rng(count)
    low, high = bands(count, 0.05)
    points, left = rank_points(), 0
    for k in range(400):
        ranks = rng.uniform(size=count)
        check = rank_checks({"it": ranks})[0] if k < 40 else None
        off = np.searchsorted(np.sort(ranks), points, side="right") / count - points
        outside = bool(np.any((off < low - 1e-12) | (off > high + 1e-12)))
        left += outside
        if check is not None:
            assert np.allclose(check.ecdf_difference, off)
            assert (check.p_value < 0.05) == outside or abs(check.p_value - 0.05) < 0.01
    assert 0.02 <= left / 400 <= 0.075


@pytest.mark.parametrize("scale", [1.3, 1 / 1.3])
def test_a_standard_deviation_misjudged_by_a_third_leaves_the_bands(scale):
    rng = np.random.default_rng(3)
    found = [
        rank_checks({"it": norm.cdf(scale * rng.standard_normal(1000))})[0].p_value
        for _ in range(20)
    ]
    assert max(found) < 0.01


@law
@given(generators, st.sampled_from(["pose", "coil", "position", "orientation", "gyro", "strain"]))
def test_values_are_read_with_the_noise_that_is_stated(rng, kind):
    """The residual of what is read is the noise: with next to none it is next to nothing."""
    robot = load_robot(ROBOT)
    cls, at = SENSORS[kind], states(rng, 5)
    shape = cls.value_shape or (cls.rows,)
    one = np.eye(shape[0]) if len(shape) == 2 else np.zeros(shape)
    blank = cls(
        time=np.zeros(5),
        arclength=np.full(5, robot.length),
        values=np.broadcast_to(one, (5, *shape)),
        cov=np.full(cls.rows, 1e-12),
    )
    read = blank.changed(values=noisy_values(blank, at, rng))
    gap = read.residual(at)
    assert 1e-7 < np.abs(gap).max() < 1e-5
    if kind == "coil":
        with pytest.raises(GlissandoError, match="a sensor in a channel are not drawn"):
            noisy_values(blank.changed(channel=Channel(0.02)), at, rng)


def test_sliding_sensors_are_where_they_are_as_surely_as_stated():
    robot, at = load_robot(ROBOT), np.linspace(0.0, 0.5, 5)
    slides = CoilReadings(
        time=at, arclength=np.full(5, 0.375), values=np.tile(np.eye(4), (5, 1, 1)),
        cov=np.repeat([1e-8, 1e-6], [3, 2]), arclength_std=5e-3,
    )  # fmt: skip
    predictive = PriorPredictive(robot, robot.grid(0.0, 0.5), [slides])
    rng, misses = np.random.default_rng(0), []
    for _ in range(100):
        session = predictive.draw(rng)
        (read,) = session.readings
        k = np.abs(predictive.fine.time[:, None] - read.time).argmin(axis=0)
        n = np.abs(predictive.fine.arclength[:, None] - read.arclength).argmin(axis=0)
        misses.append(read.residual(session.truth.take((k, n)))[:, 2])
    assert np.std(misses) == pytest.approx(5e-3, rel=0.1)


@pytest.mark.slow
def test_sessions_have_the_prior_and_the_parameters_that_the_robot_file_states():
    """Base strain and drifts over many draws; corrected readings are those of the true motion."""
    robot = load_robot(ROBOT)
    offset = SensorParameter("place", "arclength_offset", ("coil",), np.zeros(1), np.array([0.01]))
    late = SensorParameter("late", "time_offset", ("gyro",), np.zeros(1), np.array([0.01]))
    robot = type(robot)(
        **{**vars(robot), "sensor_parameters": (*robot.sensor_parameters, offset, late)}
    )
    grid, layout = session_layout(robot)
    predictive = PriorPredictive(robot, grid, layout)
    rng, strain, values = np.random.default_rng(0), [], []
    for _ in range(200):
        session = predictive.draw(rng)
        strain.append(session.truth.strain[-1, 0])
        values.append(session.parameters[-1])
    rest = robot.prior.rest_strain
    ratio = np.var(strain - rest, axis=0) / robot.prior.base.strain
    assert np.all((ratio > 0.65) & (ratio < 1.45))
    ratio = np.var(values, axis=0) / np.maximum(predictive.process.std, 1e-12) ** 2
    assert np.all((ratio > 0.65) & (ratio < 1.45))
    drawn = ParameterValues(predictive.process, session.parameters)
    for readings in session.readings:
        put_right = drawn.corrected(readings, drawn.at(readings.time))
        put_right = drawn.displaced(put_right)
        k = np.abs(predictive.fine.time[:, None] - put_right.time).argmin(axis=0)
        n = np.abs(predictive.fine.arclength[:, None] - put_right.arclength).argmin(axis=0)
        white = put_right.residual(session.truth.take((k, n))) / np.sqrt(np.diag(readings.cov))
        inner = (put_right.time > 0.05) & (put_right.arclength < robot.length - 0.05)
        assert np.abs(white[inner]).max(initial=0.0) < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("stream", ["gyro", "coil"])
def test_sessions_with_an_unknown_delay_converge_and_confidence_is_no_smaller_than_true(stream):
    """Where a delayed reading meets a node the cost has a kink, and no step stays in its lowest."""
    robot = load_robot(ROBOT)
    late = SensorParameter("late", "time_offset", (stream,), np.zeros(1), np.array([0.02]))
    robot = replace(robot, sensor_parameters=(*robot.sensor_parameters, late))
    for check in simulate_and_rank(robot, 30, seed=5):
        assert check.not_converged == 0
        for each in check.checks:  # of one number on both sides, of several above alone
            far = np.maximum(each.ranks, 1.0 - each.ranks if each.name in QUANTITIES[:18] else 0.0)
            assert np.mean(far > (0.975 if each.name in QUANTITIES[:18] else 0.95)) < 0.3, each.name


def test_a_prior_scaled_by_a_factor_has_so_many_times_its_deviations():
    prior = load_robot("tdcr466-segments").prior
    wide = scaled_prior(prior, 1.3)
    for name in ("psd_strain_arclength", "jumps"):
        assert np.allclose(getattr(wide, name), 1.69 * getattr(prior, name))
    assert np.allclose(wide.base.strain, 1.69 * prior.base.strain)
    assert wide.time_scale == prior.time_scale


@pytest.mark.slow
def test_the_command_writes_verdict_and_figure_and_says_what_it_lacks(tmp_path, capsys):
    out = tmp_path / "ranks"
    words = ["check", "--draws", "20", "--robot", str(ROBOT), "--json", "--out", str(out)]
    assert main(words) == 0
    (batch, online) = json.loads(capsys.readouterr().out)["simulation"]
    assert batch["estimator"] == "batch"
    assert online["sessions"] == 20
    assert (out / "ranks.png").stat().st_size > 1000
    for wrong, said in (
        (["--draws", "20"], "needs a robot"),
        (["--draws", "2", "--robot", str(ROBOT)], "draw 20 or more"),
        (["--draws", "20", "--prior-factor", "0", "--robot", str(ROBOT)], "above zero"),
        ([], "Nothing to check"),
    ):
        assert main(["check", *wrong]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.slow
def test_sessions_of_a_recording_have_its_middle_and_say_what_reads_nothing_then(tmp_path, capsys):
    folder = tmp_path / "gap"
    session = simulate("sliding700", shape="C", slide="oscillate", cycles=6)
    write_session(session, folder, "sliding700")
    rows = (folder / "coil.csv").read_text().splitlines()
    last = float(rows[-1].split(",")[0])
    early = [r for r in rows[1:] if float(r.split(",")[0]) < 0.1 * last]
    (folder / "coil.csv").write_text("\n".join([rows[0], *early, rows[-1], ""]))
    assert main(["check", str(folder), "--draws", "20"]) == 2
    said = capsys.readouterr().err
    middle = 0.5 * last
    first, end = (
        float(said.split("readings of ")[1].split(" s;")[0].split(" to ")[k]) for k in (0, 1)
    )
    assert first < middle < end
    assert end - first == pytest.approx(60.0 / load_robot("sliding700").time_rate, abs=0.01)
    assert "has no readings from" in said


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "uniform"), [(1.0, True), (1.3, False), (1 / 1.3, False)])
def test_ranks_are_uniform_and_a_prior_wrong_by_a_third_is_found(factor, uniform):
    found = simulate_and_rank(load_robot(ROBOT), 80, prior_factor=factor, estimators=["batch"])
    assert found[0].not_converged == 0
    assert (not found[0].outside) == uniform


@pytest.mark.slow
def test_ranks_are_uniform_where_the_base_is_remembered_for_longer_than_dense_nodes_allow():
    """A base of 10 s, which factors on the fine grid shorten: drawn and believed alike."""
    robot = load_robot(ROBOT)
    prior = replace(robot.prior, base_time_scale=10.0)
    robot = replace(robot, prior=prior, time_rate=30.0, sensor_parameters=())
    for found in simulate_and_rank(robot, 60):
        assert not found.outside, found.estimator


@pytest.mark.slow
def test_ranks_of_a_shipped_file_that_winds_robots_up_are_uniform():
    """In one of five of its sessions a search from rest ends a turn off."""
    (found,) = simulate_and_rank(load_robot("tdcr466-segments"), 20, estimators=["batch"])
    assert found.not_converged == 0
    assert not found.outside


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdcr466", "sliding700"])
def test_a_prior_far_from_its_linearisation_is_refused(name):
    with pytest.raises(GlissandoError, match="times what it allows"):
        simulate_and_rank(load_robot(name), 20)


def test_a_prior_without_a_base_cannot_be_drawn_from():
    robot = load_robot("tdcr466")
    robot = replace(robot, prior=replace(robot.prior, base=None))
    grid = Grid(robot.arclength_nodes, [0.0, 0.1])
    with pytest.raises(GlissandoError, match="no \\[base\\]"):
        PriorPredictive(robot, grid, [])


@pytest.mark.slow
def test_the_smoother_has_read_a_long_session_to_its_end():
    robot, time = load_robot(ROBOT), np.arange(0.05, 4.0, 0.1)
    layout = [r.select(np.arange(time.size) % len(r)) for r in session_layout(robot)[1]]
    layout = [r.changed(time=time) for r in layout]
    grid = robot.grid(0.0, 4.0)
    read = PriorPredictive(robot, grid, layout).draw(np.random.default_rng(0)).readings
    batch, online = (_estimated(robot, grid, read, online=o).at(robot.length, 4.0) for o in (0, 1))
    assert np.allclose(np.diag(batch.cov)[:6], np.diag(online.cov)[:6], rtol=0.5)


def test_a_prior_that_is_misjudged_is_so_in_all_its_standard_deviations():
    stiffness = np.array([1e3, 1e3, 1e4, 0.01, 0.01, 0.008])
    ones, inertia = np.ones(6), Inertia(3, 1e-3, 0.0, 0.1)
    given = 1e-3 * ones, 1e-6 * ones, 1e-2 * ones, 0.5, 1e-6 * ones
    prior = MechanicalPrior(Mechanics(stiffness, 0.05), *given, inertia=inertia)
    wrong = scaled_prior(prior, 2.0)
    np.testing.assert_allclose(wrong.var_tip, 4.0 * prior.var_tip)
    assert wrong.inertia.std_release == pytest.approx(2.0 * inertia.std_release)
    assert wrong.inertia.retardation == inertia.retardation
