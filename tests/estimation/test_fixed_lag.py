"""The online estimator: equal to the batch where it can be, honest and unshaken where it cannot."""

import gc
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.stats import chi2

import separable_sessions as drawn
from draws import generators, law
from glissando import (
    CoilReadings,
    Grid,
    GyroReadings,
    PoseReadings,
    State,
    estimate,
    load_robot,
)
from glissando.cli.main import main
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.geometry import se3
from glissando.io.netcdf import load_posterior, save_posterior
from glissando.model.sensors.parameters import SensorParameter
from glissando.planning.belief import belief_of
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.outcome import Outcome
from online import PRIORS, fed
from scenes import LENGTH, sliding_scene

EXACT = SolverOptions(tolerance=1e-7)
UNKNOWNS = [
    SensorParameter("bias", "bias", ("gyro",), np.zeros(3), np.full(3, 0.1), 0.5),
    SensorParameter("frame", "frame", ("coil",), np.zeros(6), np.full(6, 0.01)),
]


@pytest.mark.slow
@pytest.mark.parametrize("sensor_parameters", [[], UNKNOWNS], ids=["known", "unknowns"])
@pytest.mark.parametrize("kind", PRIORS)
def test_a_window_as_long_as_the_recording_is_the_batch_estimate(kind, sensor_parameters):
    _, grid, readings = sliding_scene(duration=1.0)
    prior = PRIORS[kind]
    smoother = FixedLagSmoother(
        prior, grid.arclength, window=99, sensor_parameters=sensor_parameters, gate=None
    )
    fed(smoother, grid, readings)
    smoother.iterate()
    found = smoother.posterior()
    batch = estimate(prior, grid, readings, sensor_parameters=sensor_parameters, options=EXACT)
    assert np.abs(found.state.difference(batch.state)).max() < 1e-6
    mine, its = (np.einsum("kii->ki", p.marginals.cov) ** 0.5 for p in (found, batch))
    np.testing.assert_allclose(mine, its, rtol=1e-5)
    scale = np.abs(batch.system.diagonal).max()
    assert np.abs(found.system.diagonal - batch.system.diagonal).max() < 1e-6 * scale
    assert np.abs(found.system.lower - batch.system.lower).max() < 1e-6 * scale
    for unknown in sensor_parameters:
        for mine, its in zip(
            found.parameter(unknown.name), batch.parameter(unknown.name), strict=True
        ):
            np.testing.assert_allclose(mine, its, atol=1e-6)
    for s, t in ((0.3, 0.55), (LENGTH, 1.0)):
        np.testing.assert_allclose(smoother.at(s, t).pose, batch.at(s, t).pose, atol=1e-6)


STATED = {
    "nothing": [],
    "bias": [SensorParameter("own", "bias", ("gyro",), np.zeros(3), np.full(3, 0.05))],
    "drift": [SensorParameter("own", "bias", ("gyro",), np.zeros(3), np.full(3, 0.05), 2.0)],
    "mount": [SensorParameter("own", "mount", ("tip",), np.zeros(6), np.full(6, 3e-3))],
}


@pytest.mark.parametrize("stated", STATED)
@pytest.mark.parametrize("kind", PRIORS)
def test_a_linear_problem_loses_nothing_to_a_short_window(kind, stated):
    """A still, straight robot: what left the window is all in the prior on its oldest node.

    A reading is taken just when an update is asked for, and counts once.
    """
    time = np.arange(0.0, 2.01, 0.1)
    rng = np.random.default_rng(3)
    seen = se3.exp(np.array([0, 0, LENGTH, 0, 0, 0]) + 1e-6 * rng.standard_normal((time.size, 6)))
    at = {"time": time, "arclength": np.full(time.size, LENGTH)}
    tip = PoseReadings(**at, values=seen, cov=1e-6, name="tip")
    turns = 1e-4 * rng.standard_normal((time.size, 3))
    gyro = GyroReadings(**at, values=turns, cov=4e-4, name="gyro")
    grid = Grid(np.linspace(0.0, LENGTH, 4), time)
    read = [gyro] if stated in ("bias", "drift") else [tip, gyro]
    batch = estimate(PRIORS[kind], grid, read, sensor_parameters=STATED[stated])
    its = batch.at(grid.arclength, time[-1])
    for window in (1, 2, 3, 99):
        smoother = FixedLagSmoother(
            PRIORS[kind], grid.arclength, window=window, sensor_parameters=STATED[stated]
        )
        mine = fed(smoother, grid, read)[-1]
        spread, its_spread = (np.einsum("nii->ni", at.cov) ** 0.5 for at in (mine, its))
        np.testing.assert_allclose(spread, its_spread, rtol=3e-3)
        np.testing.assert_allclose(mine.pose, its.pose, atol=1e-7)
        for parameter in STATED[stated]:
            (value, cov), (its_value, its_cov) = (
                posterior.parameter(parameter.name) for posterior in (smoother.posterior(), batch)
            )
            std, its_std = (np.sqrt(np.diagonal(each[-1])) for each in (cov, its_cov))
            np.testing.assert_allclose(std, its_std, rtol=3e-3)
            assert np.abs((value[-1] - its_value[-1]) / its_std).max() < 0.01


@pytest.mark.slow
@settings(law, max_examples=10)
@given(generators)
def test_the_order_in_which_readings_come_does_not_matter_inside_the_window(rng):
    prior, grid, readings = sliding_scene(duration=0.5)
    smoothers = [FixedLagSmoother(prior, grid.arclength, window=99, gate=None) for _ in range(2)]
    fed(smoothers[0], grid, readings)
    delay = [rng.uniform(0.0, 0.2, len(r)) for r in readings]
    for stream, late in zip(readings, delay, strict=True):
        late[stream.time <= 0.15] = 0.0  # where motion is hardly known, silence begins anew
    for time in np.append(grid.time, grid.time[-1] + 0.2):
        for stream, late in zip(readings, delay, strict=True):
            came = stream.time + late
            now = np.flatnonzero(
                (came <= time) & (came > time - 0.1 if time < 0.65 else came > 0.5)
            )
            now = rng.permutation(now)
            if now.size:
                smoothers[1].add(stream.select(now))
        smoothers[1].advance(min(time, grid.time[-1]))
    for stream in readings:
        smoothers[1].add(stream)  # all again: repeats
    smoothers[1].advance(grid.time[-1])
    means = []
    for smoother in smoothers:
        smoother.iterate()
        means.append(smoother.posterior().state)
    assert np.abs(means[0].difference(means[1])).max() < 1e-6
    again = sum(count["repeated"] for count in smoothers[1].dropped.values())
    assert again >= sum(map(len, readings))


def test_prediction_grows_less_sure_and_goes_on_as_it_moved():
    prior, grid, readings = sliding_scene()
    smoother = FixedLagSmoother(prior, grid.arclength, window=4)
    newest = fed(smoother, grid, readings)[-1]
    np.testing.assert_allclose(smoother.at(LENGTH, 1.0).cov, newest.cov[-1], rtol=1e-6, atol=1e-12)
    ahead = [smoother.at(LENGTH, 1.0 + wait) for wait in (0.01, 0.05, 0.2)]
    spread = [newest.std_position[-1], *(a.std_position for a in ahead)]
    assert np.all(np.diff(spread) > 0.0)
    onward = newest.pose[-1] @ se3.exp(0.01 * newest.velocity[-1])
    np.testing.assert_allclose(ahead[0].pose, onward, atol=2e-3)
    assert smoother.time == grid.time[-1]  # looking ahead changes nothing


def newest_errors(window, trials):
    """NEES (trials, updates) of the tip's state at the newest node, on draws of the prior."""
    rng, found = np.random.default_rng(5), []
    for _ in range(trials):
        truth = drawn.draw(rng)
        readings = [r.select(np.argsort(r.time)) for r in drawn.read(rng, truth, 1.0)]
        smoother = FixedLagSmoother(drawn.PRIOR, drawn.GRID.arclength, window=window, gate=None)
        nees = []
        for k, at in enumerate(fed(smoother, drawn.GRID, readings)):
            true = truth.take((drawn.ON_NODES[k], drawn.FINE_S))
            miss = true.difference(State(at.pose[-1], at.strain[-1], at.velocity[-1]))
            nees.append(miss @ np.linalg.solve(at.cov[-1], miss))
        found.append(nees)
    return np.array(found)


def test_the_first_state_is_no_surer_than_that_moment_is_one_update_later(tmp_path):
    robot, places = load_robot("tdcr466"), np.array([0.0, 0.233, 0.466])
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    straight = np.eye(4)[None].copy()
    straight[0, 2, 3] = robot.length
    smoother.add(
        CoilReadings(time=[0.0], arclength=[0.466], values=straight, cov=[5e-7] * 3 + [4e-5] * 2)
    )
    smoother.advance(0.0)
    first = smoother.posterior().at(places, 0.0).std_position
    save_posterior(smoother.posterior(), tmp_path / "first.nc")
    between = np.array([0.05, 0.4])
    again = load_posterior(tmp_path / "first.nc").at(between, 0.0).std_position
    np.testing.assert_allclose(again, smoother.posterior().at(between, 0.0).std_position, rtol=1e-6)
    assert np.linalg.eigvalsh(belief_of(smoother).information()).min() > -1e-6
    smoother.advance(1.0 / 30.0)
    later = smoother.posterior().at(places, 0.0).std_position
    assert np.all((first > 0.95 * later) & (first < 1.5 * later))  # it was 0.13 of it


@pytest.mark.slow
@pytest.mark.parametrize("window", [4, 1])
def test_the_newest_state_errs_as_much_as_it_says(window):
    nees = newest_errors(window, 40) / 18
    low, high = chi2.ppf([0.5e-4, 1 - 0.5e-4], 18 * len(nees)) / 18 / len(nees)
    mean = nees.mean(axis=0)
    print(f"window {window}:", *(f"{m:.3f}" for m in mean), f"in [{low:.3f}, {high:.3f}]")
    assert np.all((low <= mean) & (mean <= high))


@pytest.mark.slow
def test_the_example_loop_runs_and_is_sure_of_what_it_says():
    script = Path(__file__).parents[2] / "examples" / "control_loop.py"
    assert len(script.read_text().splitlines()) <= 30
    command = [sys.executable, str(script), "1"]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert "tip at" in out.splitlines()[-1]


@pytest.mark.slow
def test_memory_does_not_grow_while_it_runs():
    prior, _, readings = sliding_scene(duration=20.0)
    smoother = FixedLagSmoother(prior, np.linspace(0.0, LENGTH, 3), window=2)
    held = []
    tracemalloc.start()
    try:
        for k, time in enumerate(np.arange(0.1, 20.0, 0.1)):
            for stream in readings:
                smoother.add(stream.select((stream.time > time - 0.1) & (stream.time <= time)))
            smoother.advance(time)
            if k % 7 == 6:  # an update holds on to more or less
                gc.collect()  # and what is free, but kept by Python for the next one
                held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert np.mean(held[16:]) < 1.05 * np.mean(held[4:16])


@pytest.mark.slow
def test_a_saved_window_is_sound_and_commands_take_it(tmp_path, capsys):
    _, grid, readings = sliding_scene(duration=0.5)
    smoother = FixedLagSmoother(PRIORS["kinematic"], grid.arclength, window=4)
    fed(smoother, grid, readings)
    save_posterior(smoother.posterior(), tmp_path / "posterior.nc")
    again = load_posterior(tmp_path / "posterior.nc")
    assert again.solve.outcome is Outcome.UPDATED
    assert again.solve.converged
    assert main(["view", str(tmp_path), "--html", str(tmp_path / "view.html")]) == 0
    assert "updated online" in (tmp_path / "view.html").read_text()
    capsys.readouterr()


HANDED = {
    "advance": lambda smoother, newest: newest,
    "newest": lambda smoother, newest: smoother.newest(),
    "at": lambda smoother, newest: smoother.at(smoother.arclength, smoother.time + 0.2),
    "newest_node": lambda smoother, newest: smoother.newest_node()[0],
    "posterior": lambda smoother, newest: smoother.posterior().state,
}


@pytest.mark.parametrize("handed", HANDED)
@pytest.mark.parametrize("read", [True, False])
def test_what_a_caller_writes_to_an_estimate_does_not_reach_the_smoother(handed, read):
    """As in millimetres: `newest.pose[:, :3, 3] *= 1e3` displaced the next prediction, too."""
    found, robot = [], load_robot("tdcr466-segments")
    pose = np.eye(4)[None].copy()
    pose[0, 2, 3] = robot.length
    for written in (False, True):
        smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
        for time in (0.0, 0.1, 0.2):
            if read:
                smoother.add(PoseReadings(time=[time], arclength=[0.466], values=pose, cov=1e-6))
            given_out = HANDED[handed](smoother, smoother.advance(time))
            if written:
                for values in vars(given_out).values():
                    if values is not None:
                        values[...] = 3.0
        found.append(smoother.newest())
    for mine, its in zip(*(vars(each).values() for each in found), strict=True):
        np.testing.assert_array_equal(mine, its)
