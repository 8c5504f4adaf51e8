"""What an estimate says of its own readings: innovations, streams left out, times between nodes."""

import re
from dataclasses import replace

import numpy as np
import pytest

from glissando import (
    BaseVariance,
    GlissandoError,
    Grid,
    PoseReadings,
    PositionReadings,
    SensorParameter,
    SeparablePrior,
    estimate,
    load_robot,
    se3,
)
from glissando.evaluation.consistency import check_readings
from glissando.evaluation.leave_out import _stretch, leave_out
from glissando.evaluation.metrics import innovations
from glissando.evaluation.plausibility.examine import after_estimate
from glissando.evaluation.prior_predictive import PriorPredictive
from glissando.evaluation.run import chosen_streams
from glissando.io.recording_folder import load_recording
from glissando.solver.gauss_newton import SolverOptions
from glissando.visualization.evaluation_figures import calibrated_quantities, calibration_figure
from scenes import sliding_scene


@pytest.mark.parametrize("tolerance", [1e-3, 0.3])
def test_squared_innovations_are_never_negative(tolerance):
    """A loosely solved estimate explains some readings by more than all of their variance."""
    prior, grid, readings = sliding_scene()
    exact = [readings[0], readings[1].changed(cov=1e-6 * readings[1].cov), readings[2]]
    posterior = estimate(prior, grid, exact, options=SolverOptions(tolerance=tolerance))
    for r in exact:
        squares = innovations(posterior, r)
        assert np.all(squares >= 0.0)
        assert np.all(np.isfinite(squares))


def test_a_known_sensor_parameter_is_applied_to_innovations():
    """A frame that is stated, and the same one as a known parameter, are judged alike."""
    prior, grid, readings = sliding_scene()
    frame = np.array([0.2, -0.1, 0.3, 0.4, 0.2, -0.9])
    moved = readings[1].changed(values=se3.exp(-frame) @ readings[1].values)
    known = SensorParameter("frame", "frame", ("coil",), frame, np.zeros(6))
    direct = check_readings(estimate(prior, grid, readings), readings)
    other = [readings[0], moved, readings[2]]
    posterior = estimate(prior, grid, other, sensor_parameters=[known])
    stated = check_readings(posterior, other, [known])
    for one, same in zip(direct, stated, strict=True):
        np.testing.assert_allclose(one.nees, same.nees, rtol=1e-4, atol=1e-6)


def test_innovations_alone_are_not_drawn_as_coverage():
    prior, grid, readings = sliding_scene()
    checks = check_readings(estimate(prior, grid, readings), readings)
    assert checks
    assert calibrated_quantities(checks) == []
    with pytest.raises(GlissandoError, match="No position or rotation was checked"):
        calibration_figure(checks)


@pytest.mark.parametrize("end", [0.3, 8.0])
def test_the_last_moment_is_of_the_last_stretch(end):
    """Readings are given to the other stretches only, so none of them anchors its own."""
    _, _, readings = sliding_scene()
    grid = Grid(np.linspace(0.0, 0.4, 3), np.linspace(0.0, end, 4))
    time = np.linspace(0.0, end, len(readings[1]))
    used = _stretch(readings[1].changed(time=time), grid)
    assert np.sum(np.diff(used)) == 7
    assert used[-1] == used[-2]


@pytest.mark.slow
def test_a_stream_that_contradicts_the_others_is_accused_and_a_right_one_is_not():
    """A coil that is 5 cm off explains itself by its own neighbours, but not by the others."""
    prior, grid, readings = sliding_scene(duration=1.0)
    tip = readings[1].changed(name="second", time=readings[1].time + 1e-4)
    robot = replace(load_robot("tdcr466"), prior=prior)
    off = tip.changed(values=se3.exp(np.array([0.05, 0, 0, 0, 0, 0])) @ tip.values)
    for other, least, most in ((tip, 1e-3, 3.0), (off, 30.0, np.inf)):
        streams = [readings[0], readings[1], other.inside(grid)]
        judged = {(c.quantity, c.site): c for c in leave_out(robot, grid, streams)}
        assert least < judged["by the others", "second"].mean < most
        assert 20 < judged["by other times", "coil"].nees.size < 41  # some are too vague


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "memory"),
    [
        *(("mount", 1.0), ("mount", np.inf), ("frame", 1.0), ("frame", np.inf)),
        ("time_offset", np.inf),  # which never drifts
    ],
)
def test_streams_of_sensors_that_are_estimated_are_predicted_as_surely_as_they_are(kind, memory):
    """Sessions drawn from the prior: sensor parameters go with states, and drift."""
    spread = np.repeat([1e-8, 0.02], 3)
    prior = SeparablePrior(spread, 3.0, BaseVariance(np.repeat([1e-8, 1e-6], 3), 2.0 * spread))
    std = np.repeat([3e-3, 3e-2], 3) if kind != "time_offset" else np.array([0.05])
    drift = () if kind == "time_offset" else (memory,)
    own = SensorParameter("own", kind, ("tip",), np.zeros(std.size), std, *drift)
    nodes = 5 if kind == "time_offset" else 3  # of a delay, three show false confidence less well
    robot = replace(
        load_robot("tdcr466"), prior=prior, length=0.4, sensor_parameters=(own,), time_rate=4.0,
        arclength_nodes=np.linspace(0.0, 0.4, nodes),
    )  # fmt: skip
    grid, cov = robot.grid(0.0, 6.0), np.repeat([2.5e-7, 2.5e-5], 3)
    at = {"time": grid.time}
    tip = PoseReadings(
        **at, arclength=np.full(grid.time.size, 0.4), cov=cov, name="tip",
        values=np.tile(np.eye(4), (grid.time.size, 1, 1)),
    )  # fmt: skip
    middle = PositionReadings(
        **at, arclength=np.full(grid.time.size, 0.2), cov=cov[:3], name="middle",
        values=np.zeros((grid.time.size, 3)),
    )  # fmt: skip
    predictive, found = PriorPredictive(robot, grid, [tip, middle]), {}
    for seed in range(8):
        session = predictive.draw(np.random.default_rng(seed))
        for c in leave_out(robot, grid, session.readings):
            found.setdefault((c.quantity, c.site), []).append(c.mean)
    assert 0.7 < np.mean(found["by other times", "tip"]) < 1.4
    assert 0.5 < np.mean(found["by the others", "tip"]) < 2.0
    assert 0.5 < np.mean(found["by the prior", "tip"]) < 2.0


@pytest.mark.slow
def test_readings_between_time_nodes_are_judged_by_the_state_there(spacetime):
    recording = load_recording(spacetime / "slow_free_space")
    robot, window = load_robot("tdcr466"), (19.0, 22.0)
    names = ["aurora0", "aurora1", "gyro_mid", "gyro_ee"]
    readings = recording.readings(names, robot, window)[0]
    posterior = estimate(robot.prior, robot.grid(*window), readings)
    assert not after_estimate(posterior, readings)


def swellings(robot, sensors, window):
    """What is said of confidence between the nodes of an estimate on the robot's own grid."""
    grid = robot.grid(*window)
    posterior = estimate(
        robot.prior, grid, [r.inside(grid) for r in sensors],
        sensor_parameters=robot.sensor_parameters,
    )  # fmt: skip
    found = after_estimate(posterior, sensors, robot.sensor_parameters)
    return [f.sentence for f in found if f.name == "grid"]


def test_confidence_that_swells_between_nodes_is_named_and_the_rate_it_asks_for_is_enough(session):
    robot, sensors, *_ = session
    assert swellings(robot, sensors, (1.0, 7.0)) == []
    for rate in (0.5, 1.0):
        (said,) = swellings(replace(robot, time_rate=rate), sensors, (1.0, 7.0))
        asked = float(re.search(r"time_rate = (\S+)", said)[1])
        assert 1.2 * rate < asked < 8.0 * rate
        assert swellings(replace(robot, time_rate=asked), sensors, (1.0, 7.0)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slow_free_space", "fast_contact"])
def test_confidence_of_shipped_robots_does_not_swell_between_nodes(spacetime, name):
    recording = load_recording(spacetime / name)
    for robot in (load_robot("tdcr466"), load_robot("tdcr466-segments")):
        sensors, *_ = chosen_streams(recording, robot, (19.0, 23.0), None, None)
        assert swellings(robot, sensors, (19.0, 23.0)) == []
    coarse = replace(robot, time_rate=10.0)
    assert len(swellings(coarse, sensors, (19.0, 23.0))) == 1
