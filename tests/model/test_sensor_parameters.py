"""Unknowns of the sensors: what is found of them, and how sure that is."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import (
    BaseVariance,
    GlissandoError,
    GyroReadings,
    PositionReadings,
    SeparablePrior,
    estimate,
)
from glissando.geometry import se3
from glissando.io.netcdf import load_posterior, save_posterior
from glissando.model.grid import Grid
from glissando.model.sensors.accelerometer import AccelerometerReadings
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.parameters import SIZES, SensorParameter
from glissando.model.slide_track import slide_motion
from oracles import dense
from scenes import LENGTH, angular_velocity, arc, sliding_scene
from unknown_scenes import COARSE, SOFT, STEADY, TIMES, consistent, tracker, unknown


def anchors(rng):
    """Trackers without any unknown: base, middle, tip."""
    base = np.full(TIMES.size, 0.0)
    return [
        tracker(rng, "base", base),
        tracker(rng, "middle", LENGTH / 2),
        tracker(rng, "tip", LENGTH),
    ]


TRUE = {
    "frame": np.r_[0.02, -0.01, 0.015, 0.05, -0.1, 0.08],
    "mount": np.r_[-0.01, 0.01, 0.02, -0.1, 0.05, 0.2],
    "bias": np.r_[0.05, -0.1, 0.08],
    "arclength_offset": np.r_[-0.006],
    "time_offset": np.r_[0.015],
    "slide_lag": np.r_[0.02],
    "slide_play": np.r_[0.008],
}


def to_and_fro(rng, name):
    """A tracker that slides to and fro."""
    place = LENGTH * (0.75 - 0.15 * np.abs(np.linspace(-1.0, 1.0, TIMES.size)))
    return replace(tracker(rng, name, place, 4e-3), **slide_motion(TIMES, place))


def miscalibrated(rng):
    """Anchors, and a noisier stream for each kind of unknown that is off by it."""
    framed = tracker(rng, "framed", LENGTH, 4e-3)
    mounted = tracker(rng, "mounted", LENGTH / 2, 4e-3)
    slid = tracker(rng, "slid", np.linspace(0.6, 0.9, TIMES.size) * LENGTH, 4e-3)
    late = tracker(rng, "late", LENGTH, 4e-3)
    behind, tight = (to_and_fro(rng, name) for name in ("behind", "tight"))
    lag = TRUE["slide_lag"] * behind.slide_speed
    play = 0.5 * TRUE["slide_play"] * tight.slide_way
    place = np.full(TIMES.size, LENGTH / 2)
    rate = angular_velocity(place, TIMES) + 0.3 * rng.standard_normal((TIMES.size, 3))
    gyro = GyroReadings(time=TIMES, arclength=place, values=rate, cov=0.09, name="gyro")
    frame, mount = se3.exp(-TRUE["frame"]), se3.exp(TRUE["mount"])
    return [
        *anchors(rng),
        replace(framed, values=frame @ framed.values),
        replace(mounted, values=mounted.values @ mount),
        replace(gyro, values=gyro.values + TRUE["bias"]),
        replace(slid, arclength=slid.arclength - TRUE["arclength_offset"]),
        replace(late, time=late.time + TRUE["time_offset"]),
        replace(behind, arclength=behind.arclength + lag),
        replace(tight, arclength=tight.arclength + play),
    ]


STREAM = {
    "frame": "framed",
    "mount": "mounted",
    "bias": "gyro",
    "arclength_offset": "slid",
    "time_offset": "late",
    "slide_lag": "behind",
    "slide_play": "tight",
}
STD = dict.fromkeys(SIZES, 0.3) | {"slide_play": 0.1}
ASKED = [unknown(kind, STREAM[kind], std=STD[kind]) for kind in SIZES]


@pytest.fixture(scope="module")
def calibrations():
    found, start = [], None
    for seed in range(20):
        readings = miscalibrated(np.random.default_rng(seed))
        found.append(estimate(STEADY, COARSE, readings, sensor_parameters=ASKED, initial=start))
        start = found[0].state
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kind", SIZES)
def test_what_sensors_are_off_by_is_found_as_surely_as_stated(calibrations, kind):
    squares, wrong = [], []
    for posterior in calibrations:
        values, cov = posterior.parameter(kind)
        np.testing.assert_allclose(values, np.tile(values[:1], (6, 1)), atol=5e-4)
        error, cov = values[2] - TRUE[kind], cov[2]
        assert np.all(np.abs(error) < 3.5 * np.sqrt(np.diagonal(cov)))
        squares.append(error @ np.linalg.solve(cov, error))
        wrong.append(9.0 * squares[-1])
    dof = SIZES[kind] * len(calibrations)
    assert consistent(squares, dof)
    assert not consistent(wrong, dof)


@pytest.mark.slow
def test_the_stated_confidence_is_small_enough_to_mean_something(calibrations):
    for kind, most in (
        ("frame", 0.05),
        ("mount", 0.05),
        ("bias", 0.15),
        ("arclength_offset", 0.003),
    ):
        cov = calibrations[0].parameter(kind)[1][2]
        assert np.sqrt(np.diagonal(cov)).max() < most


@pytest.mark.slow
def test_covariances_are_those_of_the_dense_inverse(calibrations):
    posterior = calibrations[0]
    system = posterior.system
    k_count, size, _ = system.diagonal.shape
    whole = dense.matrix_of(system)
    scale = np.sqrt(np.diagonal(whole))
    inverse = np.linalg.inv(whole / np.outer(scale, scale)) / np.outer(scale, scale)
    inverse = inverse.reshape(k_count, size, k_count, size)
    cov = np.array([inverse[k, :, k] for k in range(k_count)])
    std = np.sqrt(np.einsum("kii->ki", cov))
    by_std = std[:, :, None] * std[:, None, :]
    np.testing.assert_allclose(posterior.marginals.cov / by_std, cov / by_std, atol=1e-5)
    first = size - sum(SIZES.values())
    for kind in SIZES:
        at = slice(first, first + SIZES[kind])
        np.testing.assert_array_equal(
            posterior.parameter(kind)[1], posterior.marginals.cov[:, at, at]
        )
        first += SIZES[kind]


# Drift: what sensor errors have in common over time.


def wandering(rng, time, std, memory):
    """An Ornstein-Uhlenbeck process (M, 3) at these times."""
    out = [std * rng.standard_normal(3)]
    for step in np.diff(time):
        keep = np.exp(-step / memory)
        out.append(keep * out[-1] + std * np.sqrt(1 - keep**2) * rng.standard_normal(3))
    return np.array(out)


def test_a_drift_must_be_estimated_for_the_confidence_to_be_true():
    std, memory, time, seeds = 4e-3, 0.5, np.linspace(0.0, 1.0, 21), 15
    place = np.full(time.size, LENGTH)
    with_drift, without = [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        seen = arc(place, time)[:, :3, 3] + 3e-4 * rng.standard_normal((time.size, 3))
        seen += wandering(rng, time, std, memory)
        tip = PositionReadings(time=time, arclength=place, values=seen, cov=9e-8, name="tip")
        readings = [tracker(rng, "base", 0.0), tip]
        drift = unknown("bias", "tip", std=std, memory=memory)
        for sensor_parameters, squares in (([drift], with_drift), ([], without)):
            at = estimate(SOFT, COARSE, readings, sensor_parameters=sensor_parameters).at(
                LENGTH, 0.4
            )
            error = at.position - arc(LENGTH, 0.4)[:3, 3]
            squares.append(error @ np.linalg.solve(at.cov_position_world, error))
    assert consistent(with_drift, 3 * seeds)
    assert np.mean(without) / 3.0 > 10.0


def test_a_memory_far_longer_than_the_recording_is_a_constant():
    readings = miscalibrated(np.random.default_rng(1))
    constant, long, short = (
        estimate(
            STEADY,
            COARSE,
            readings,
            sensor_parameters=[replace(u, correlation_time=t) for u in ASKED],
        )
        for t in (np.inf, 3e6, 1.0)
    )
    for kind in SIZES:
        values, cov = constant.parameter(kind)
        std = np.sqrt(np.einsum("kii->ki", cov))
        assert np.all(np.abs(long.parameter(kind)[0] - values) < 0.1 * std)
        assert np.all(np.abs(np.ptp(values, axis=0)) < 0.2 * std)
        np.testing.assert_allclose(np.sqrt(np.einsum("kii->ki", long.parameter(kind)[1])), std,
                                   rtol=0.05)  # fmt: skip
        assert np.sqrt(np.einsum("kii->ki", short.parameter(kind)[1])).min() > 1.2 * std.min()


@pytest.mark.parametrize("memory", [1e-4, 0.05, 3.0, 1e6])
def test_between_nodes_a_drift_is_the_conditional_of_its_covariance(memory):
    grid = Grid([0.0, 0.1], [0.0, 0.1, 0.2, 1.0])
    drift = SensorParameter("b", "bias", ("g",), np.zeros(3), np.full(3, 0.2), memory)
    process, time = EstimatedParameters(grid, [drift]), np.array([0.0, 0.05, 0.17, 0.6, 0.9997])
    lower, weights, left = process.between(time)
    for t, k, w, var in zip(time, lower, weights[..., 0], left[:, 0], strict=True):
        ends = grid.time[k : k + 2]
        known = np.exp(-np.abs(ends[:, None] - ends) / process.memory[0])
        cross = np.exp(-np.abs(t - ends) / process.memory[0])
        np.testing.assert_allclose(w, np.linalg.solve(known, cross), atol=1e-6)
        np.testing.assert_allclose(var, 0.04 * (1.0 - cross @ w), atol=1e-8)


# Known unknowns, and those of nobody.


@pytest.mark.filterwarnings("ignore::glissando.errors.FalseConfidenceWarning")
def test_what_is_known_is_put_right_and_not_estimated():
    readings = miscalibrated(np.random.default_rng(2))
    base, middle, tip, framed, mounted, gyro, slid, late, behind, tight = readings
    lag = TRUE["slide_lag"] * behind.slide_speed
    play = 0.5 * TRUE["slide_play"] * tight.slide_way
    known = [unknown(k, STREAM[k], value=TRUE[k], std=0.0) for k in SIZES]
    by_hand = [
        base,
        middle,
        tip,
        replace(framed, values=se3.exp(TRUE["frame"]) @ framed.values),
        replace(mounted, mount=se3.exp(TRUE["mount"])),
        replace(gyro, values=gyro.values - TRUE["bias"]),
        replace(slid, arclength=slid.arclength + TRUE["arclength_offset"]),
        replace(late, time=late.time - TRUE["time_offset"]),
        replace(behind, arclength=behind.arclength - lag),
        replace(tight, arclength=tight.arclength - play),
    ]
    told = estimate(STEADY, COARSE, readings, sensor_parameters=known)
    plain = estimate(STEADY, COARSE, by_hand)
    assert told.sensor_parameters == [] or len(told.sensor_parameters) == 0
    assert np.abs(told.state.difference(plain.state)).max() < 1e-12
    np.testing.assert_allclose(told.marginals.cov, plain.marginals.cov, rtol=1e-9, atol=1e-15)
    off = estimate(STEADY, COARSE, readings)
    assert off.solve.cost > 3.0 * plain.solve.cost


def test_unknowns_of_streams_that_are_not_there_change_nothing():
    rods, grid, readings = sliding_scene(nodes=3, rate=5.0)
    strangers = [unknown(kind, "nobody") for kind in SIZES]
    plain = estimate(rods, grid, readings)
    other = estimate(rods, grid, readings, sensor_parameters=strangers)
    for field in ("pose", "strain", "velocity"):
        np.testing.assert_array_equal(getattr(plain.state, field), getattr(other.state, field))
    np.testing.assert_array_equal(plain.marginals.cov, other.marginals.cov)
    assert len(other.sensor_parameters) == 0
    assert plain.log_evidence == other.log_evidence


# Files.


@pytest.mark.slow
def test_a_posterior_with_unknowns_is_read_back_as_it_was_written(calibrations, tmp_path):
    posterior = estimate(
        STEADY,
        COARSE,
        miscalibrated(np.random.default_rng(4)),
        sensor_parameters=[
            replace(u, correlation_time=2.0) if u.kind == "bias" else u for u in ASKED
        ],
    )
    save_posterior(posterior, tmp_path / "posterior.nc")
    again = load_posterior(tmp_path / "posterior.nc")
    for (was, values), (now, same) in zip(
        posterior.sensor_parameters, again.sensor_parameters, strict=True
    ):
        assert (was.name, was.kind, was.streams) == (now.name, now.kind, now.streams)
        assert was.correlation_time == now.correlation_time
        np.testing.assert_array_equal(was.std, now.std)
        np.testing.assert_array_equal(was.value, now.value)
        np.testing.assert_array_equal(values, same)
        before, after = posterior.parameter(was.name)[1], again.parameter(was.name)[1]
        np.testing.assert_allclose(before, after, rtol=1e-4, atol=1e-6 * np.abs(before).max())
    here, there = (p.at([0.1, 0.3], [0.33, 0.7]) for p in (posterior, again))
    np.testing.assert_allclose(here.pose, there.pose, atol=1e-12)
    np.testing.assert_allclose(here.cov, there.cov, atol=1e-5 * np.abs(here.cov).max())
    draw = again.sample(np.random.default_rng(0))
    assert draw.pose.shape == (1, *COARSE.shape, 4, 4)


@pytest.mark.slow
def test_an_unknown_that_was_not_estimated_is_answered_with_those_that_were(calibrations):
    names = ", ".join(SIZES)
    with pytest.raises(GlissandoError, match=f"No sensor parameter 'nose' was .*: {names}"):
        calibrations[0].parameter("nose")
    with pytest.raises(GlissandoError, match=r"those that were: none\."):
        replace(calibrations[0], sensor_parameters=()).parameter("nose")


def test_a_constant_keeps_for_an_hour_where_a_window_says_nothing_of_how_long():
    constant = SensorParameter("zero", "arclength_offset", ("coil",), [0.0], [2e-3])
    window = Grid([0.0, 0.4], [0.1, 0.2], before=0.0)
    process = EstimatedParameters(window, [constant])
    walked = np.sqrt(2.0 * 3600.0 / process.memory[0])  # of its standard deviation
    assert walked < 0.01


@pytest.mark.parametrize("std", [0.01, 0.1, 1.0, 10.0])
def test_a_constant_is_as_well_known_as_its_readings_say_however_little_was_before(std):
    """A rigid robot in a known place: the mean of its readings, less the constant."""
    stiff = np.full(6, 1e-12)
    rigid = SeparablePrior(stiff, 1.0, BaseVariance(stiff, stiff))
    rng, time, count = np.random.default_rng(0), np.linspace(0.0, 1.0, 11), 440
    seen = np.array([0.0, 0.0, 0.4]) + 1e-3 * rng.standard_normal((count, 3))
    place = {"time": np.repeat(time, count // 11), "arclength": np.full(count, 0.4)}
    read = PositionReadings(**place, values=seen, cov=1e-6, name="marker")
    bias = SensorParameter("bias", "bias", ("marker",), np.zeros(3), np.full(3, std))
    found = estimate(rigid, Grid([0.0, 0.2, 0.4], time), [read], sensor_parameters=[bias])
    values, cov = found.parameter("bias")
    exact = (count / 1e-6 + std**-2.0) ** -0.5
    np.testing.assert_allclose(np.sqrt(np.einsum("kii->ki", cov)), exact, rtol=0.1)
    assert np.ptp(values, axis=0).max() < 0.3 * exact


def test_what_reads_in_its_own_frame_has_no_frame_in_the_world():
    """Else metres would be added to radians a second."""
    shift = SensorParameter("f", "frame", ("g",), np.array([0.5, 0, 0, 0, 0, 0]), np.zeros(6))
    read = {"time": [0.0], "arclength": [0.1], "values": np.zeros((1, 3)), "cov": np.ones(3)}
    assert shift.shift(PositionReadings(**read), shift.value).values[0, 0] == 0.5
    for cls in (GyroReadings, AccelerometerReadings):
        with pytest.raises(GlissandoError, match="has no frame"):
            shift.shift(cls(**read), shift.value)
