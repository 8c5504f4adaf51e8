"""Unknowns of the sensors: their slopes, what is found of them, and how sure that is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from draws import motion, prior
from glissando import (
    CoilReadings,
    GlissandoError,
    Grid,
    GyroReadings,
    PoseReadings,
    PositionReadings,
    RobotFileError,
    SensorError,
    State,
    estimate,
    load_robot,
    se3,
    uniform_grid,
)
from glissando.factors import linearize
from glissando.placed import PlacedReadings, states_at
from glissando.posterior import Posterior
from glissando.robot import robot_file
from glissando.separable import BaseVariance, SeparablePrior
from glissando.sums import slab_shape
from glissando.unknowns import SIZES, Unknown
from scenes import LENGTH, angular_velocity, arc, sliding_scene

GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25, 0.35])
K, N = GRID.shape
SURE = 1e-4  # chance that a true law fails, each side
SEPARABLE = SeparablePrior(
    np.r_[1e-3, 1.2e-3, 2e-3, 3.0, 4.0, 2.0],
    0.7,
    BaseVariance(np.full(6, 1e-3), np.r_[1e-3, 1e-3, 1e-3, 2.0, 2.0, 2.0]),
)


def consistent(squares, dof):
    """Whether the sum of these squared errors is one of a chi-square with so many degrees."""
    low, high = chi2.ppf([SURE, 1.0 - SURE], dof)
    return low < np.sum(squares) < high


def unknown(kind, *streams, value=None, std=0.05, memory=np.inf, name=None):
    value = np.zeros(SIZES[kind]) if value is None else value
    return Unknown(name or kind, kind, streams, value, np.full(SIZES[kind], std), memory)


# Slopes.


def scattered(rng, count=6):
    """Readings of four kinds, none on a node nor near one."""

    def where():
        inside = [np.sort(rng.uniform(0.05, 0.95, count)) for _ in "st"]
        cells = rng.integers(0, 3, (2, count))
        nodes = GRID.arclength, GRID.time
        s, t = (
            np.sort(n[c] + u * np.diff(n)[c]) for n, c, u in zip(nodes, cells, inside, strict=True)
        )
        return {"arclength": rng.permutation(s), "time": t}

    pose = motion(rng, Grid([0.2], np.linspace(0, 1, count))).pose[:, 0]
    mount = se3.exp(0.1 * rng.standard_normal((2, 6)))
    three = rng.standard_normal((2, count, 3))
    return [
        PoseReadings(**where(), values=pose, cov=1e-2, name="pose", mount=mount[0]),
        CoilReadings(**where(), values=pose, cov=1e-2, name="coil", mount=mount[1]),
        GyroReadings(**where(), values=three[0], cov=1e-2, name="gyro"),
        PositionReadings(**where(), values=three[1], cov=1e-2, name="point", mount=mount[0]),
    ]


def all_kinds(rng):
    small = 0.1 * rng.standard_normal((2, 6))
    return [
        unknown("world", "pose", "coil", "point", value=small[0]),
        unknown("mount", "coil", "point", "gyro", value=small[1], memory=0.5),
        unknown("bias", "gyro", memory=0.3, name="gyro bias"),
        unknown("bias", "point", name="point bias"),
        unknown("slide", "coil", "gyro", value=[0.003]),
        unknown("delay", "pose", value=[0.002]),  # of nothing that drifts: that is second order
    ]


@pytest.mark.parametrize("kind", ["kinematic", "separable"])
def test_system_and_right_hand_side_are_those_of_the_residuals_slopes(kind):
    rng = np.random.default_rng(3)
    state, rods = motion(rng, GRID), prior()
    if kind == "separable":
        rate = rng.standard_normal(state.strain.shape)
        state, rods = State(state.pose, state.strain, state.velocity, rate), SEPARABLE
    placed = PlacedReadings(GRID, scattered(rng), all_kinds(rng))
    extras, wander = placed.unknowns.size, np.ones((K, 1))
    constant = placed.unknowns.memory > 1e3
    wander = np.where(constant, wander, rng.uniform(0.5, 1.5, (K, extras)))
    placed = placed.moved(1e-3 * wander * rng.standard_normal(extras))
    room = np.empty(slab_shape(GRID, state.dof, extras))

    def at(step, held):
        nodes, moved = here.split(step)
        there = linearize(
            rods, placed.moved(moved), state.retract(nodes), state, np.empty_like(room), held
        )
        pairs = zip(held, there.terms, strict=True)
        return np.concatenate([t.whiten(u.residual).ravel() for t, u in pairs])

    here = linearize(rods, placed, state, state, room)
    of_nodes = N * state.dof
    size = of_nodes + extras
    directions = []
    for columns in placed.unknowns.columns:  # a constant moves as one: its chain is stiff
        way, mine = np.zeros((K, size)), np.zeros((K, extras))
        mine[:, columns] = rng.standard_normal((K, columns.stop - columns.start))
        way[:, of_nodes:] = np.where(constant, mine[:1], mine)
        directions.append(way)
    for _ in range(2):
        way = np.zeros((K, size))
        way[:, :of_nodes] = rng.standard_normal((K, of_nodes))
        directions.append(way)
    slopes = []
    for way in directions:
        ahead, behind = (at(h * way, here.terms) for h in (1e-6, -1e-6))
        slopes.append((ahead - behind) / 2e-6)
    slopes = np.array(slopes)

    products = []
    system = here.system
    for way in directions:
        product = np.einsum("kij,kj->ki", system.diagonal, way)
        product[1:] += np.einsum("kij,kj->ki", system.lower, way[:-1])
        product[:-1] += np.einsum("kji,kj->ki", system.lower, way[1:])
        products.append(product.ravel())
    found = np.array(products) @ np.array([way.ravel() for way in directions]).T
    wanted = slopes @ slopes.T
    scale = np.sqrt(np.diagonal(wanted))
    np.testing.assert_allclose(found / np.outer(scale, scale), wanted / np.outer(scale, scale),
                               atol=2e-5)  # fmt: skip

    residual = np.concatenate([t.whiten(t.residual).ravel() for t in here.terms])
    pull = np.array([np.sum(here.right * way) for way in directions])
    np.testing.assert_allclose(pull / scale, -(slopes @ residual) / scale,
                               atol=2e-5 * np.linalg.norm(residual))  # fmt: skip


# What is found of them.

TIMES = np.linspace(0.08, 0.92, 10)
SOFT = load_robot("tdcr466").prior
_SLOW = ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength")
STEADY = replace(SOFT, **{name: 1e-4 * getattr(SOFT, name) for name in _SLOW})  # as the arc is
COARSE = uniform_grid(LENGTH, 3, 0.0, 1.0, 5.0)


def tracker(rng, name, place, std=1e-3, time=TIMES):
    place = np.broadcast_to(place, time.shape)
    noise = std * np.r_[1.0, 1.0, 1.0, 5.0, 5.0, 5.0] * rng.standard_normal((time.size, 6))
    cov = (std * np.r_[1.0, 1.0, 1.0, 5.0, 5.0, 5.0]) ** 2
    return PoseReadings(
        time=time, arclength=place, values=arc(place, time) @ se3.exp(noise), cov=cov, name=name
    )


def anchors(rng):
    """Trackers without any unknown: base, middle, tip."""
    base = np.full(TIMES.size, 0.0)
    return [
        tracker(rng, "base", base),
        tracker(rng, "middle", LENGTH / 2),
        tracker(rng, "tip", LENGTH),
    ]


TRUE = {
    "world": np.r_[0.02, -0.01, 0.015, 0.05, -0.1, 0.08],
    "mount": np.r_[-0.01, 0.01, 0.02, -0.1, 0.05, 0.2],
    "bias": np.r_[0.05, -0.1, 0.08],
    "slide": np.r_[-0.006],
    "delay": np.r_[0.015],
}


def miscalibrated(rng):
    """Anchors, and a noisier stream for each kind of unknown that is off by it."""
    framed = tracker(rng, "framed", LENGTH, 4e-3)
    mounted = tracker(rng, "mounted", LENGTH / 2, 4e-3)
    slid = tracker(rng, "slid", np.linspace(0.6, 0.9, TIMES.size) * LENGTH, 4e-3)
    late = tracker(rng, "late", LENGTH, 4e-3)
    place = np.full(TIMES.size, LENGTH / 2)
    rate = angular_velocity(place, TIMES) + 0.3 * rng.standard_normal((TIMES.size, 3))
    gyro = GyroReadings(time=TIMES, arclength=place, values=rate, cov=0.09, name="gyro")
    frame, mount = se3.exp(-TRUE["world"]), se3.exp(TRUE["mount"])
    return [
        *anchors(rng),
        replace(framed, values=frame @ framed.values),
        replace(mounted, values=mounted.values @ mount),
        replace(gyro, values=gyro.values + TRUE["bias"]),
        replace(slid, arclength=slid.arclength - TRUE["slide"]),
        replace(late, time=late.time + TRUE["delay"]),
    ]


STREAM = {
    "world": "framed", "mount": "mounted", "bias": "gyro", "slide": "slid", "delay": "late"
}  # fmt: skip
ASKED = [unknown(kind, STREAM[kind], std=0.3) for kind in SIZES]


@pytest.fixture(scope="module")
def calibrations():
    found, start = [], None
    for seed in range(20):
        readings = miscalibrated(np.random.default_rng(seed))
        found.append(estimate(STEADY, COARSE, readings, unknowns=ASKED, initial=start))
        start = found[0].state
    return found


@pytest.mark.parametrize("kind", SIZES)
def test_what_sensors_are_off_by_is_found_as_surely_as_stated(calibrations, kind):
    squares, wrong = [], []
    for posterior in calibrations:
        values, cov = posterior.unknown(kind)
        np.testing.assert_allclose(values, np.tile(values[:1], (6, 1)), atol=5e-4)
        error, cov = values[2] - TRUE[kind], cov[2]
        assert np.all(np.abs(error) < 3.5 * np.sqrt(np.diagonal(cov)))
        squares.append(error @ np.linalg.solve(cov, error))
        wrong.append(9.0 * squares[-1])
    dof = SIZES[kind] * len(calibrations)
    assert consistent(squares, dof)
    assert not consistent(wrong, dof)


def test_the_stated_confidence_is_small_enough_to_mean_something(calibrations):
    for kind, most in (("world", 0.05), ("mount", 0.05), ("bias", 0.15), ("slide", 0.003)):
        cov = calibrations[0].unknown(kind)[1][2]
        assert np.sqrt(np.diagonal(cov)).max() < most


def test_covariances_are_those_of_the_dense_inverse(calibrations):
    posterior = calibrations[0]
    system = posterior.system
    k_count, size, _ = system.diagonal.shape
    whole = np.zeros((k_count, size, k_count, size))
    for k in range(k_count):
        whole[k, :, k] = system.diagonal[k]
    for k in range(k_count - 1):
        whole[k + 1, :, k], whole[k, :, k + 1] = system.lower[k], system.lower[k].T
    whole = whole.reshape(k_count * size, -1)
    scale = np.sqrt(np.diagonal(whole))
    dense = np.linalg.inv(whole / np.outer(scale, scale)) / np.outer(scale, scale)
    dense = dense.reshape(k_count, size, k_count, size)
    dense = np.array([dense[k, :, k] for k in range(k_count)])
    std = np.sqrt(np.einsum("kii->ki", dense))
    by_std = std[:, :, None] * std[:, None, :]
    np.testing.assert_allclose(posterior.marginals.cov / by_std, dense / by_std, atol=1e-5)
    first = size - sum(SIZES.values())
    for kind in SIZES:
        at = slice(first, first + SIZES[kind])
        np.testing.assert_array_equal(
            posterior.unknown(kind)[1], posterior.marginals.cov[:, at, at]
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
        for unknowns, squares in (([drift], with_drift), ([], without)):
            at = estimate(SOFT, COARSE, readings, unknowns=unknowns).at(LENGTH, 0.4)
            error = at.position - arc(LENGTH, 0.4)[:3, 3]
            squares.append(error @ np.linalg.solve(at.cov_position_world, error))
    assert consistent(with_drift, 3 * seeds)
    assert np.mean(without) / 3.0 > 10.0


def test_a_memory_far_longer_than_the_recording_is_a_constant():
    readings = miscalibrated(np.random.default_rng(1))
    constant, long, short = (
        estimate(STEADY, COARSE, readings, unknowns=[replace(u, correlation_time=t) for u in ASKED])
        for t in (np.inf, 3e6, 1.0)
    )
    for kind in SIZES:
        values, cov = constant.unknown(kind)
        std = np.sqrt(np.einsum("kii->ki", cov))
        assert np.all(np.abs(long.unknown(kind)[0] - values) < 0.1 * std)
        assert np.all(np.abs(np.ptp(values, axis=0)) < 0.2 * std)
        np.testing.assert_allclose(np.sqrt(np.einsum("kii->ki", long.unknown(kind)[1])), std,
                                   rtol=0.05)  # fmt: skip
        assert np.sqrt(np.einsum("kii->ki", short.unknown(kind)[1])).min() > 1.2 * std.min()


# Known unknowns, and those of nobody.


def test_what_is_known_is_put_right_and_not_estimated():
    base, middle, tip, framed, mounted, gyro, slid, late = miscalibrated(np.random.default_rng(2))
    readings = [base, middle, tip, framed, mounted, gyro, slid, late]
    known = [unknown(k, STREAM[k], value=TRUE[k], std=0.0) for k in SIZES]
    by_hand = [
        base,
        middle,
        tip,
        replace(framed, values=se3.exp(TRUE["world"]) @ framed.values),
        replace(mounted, mount=se3.exp(TRUE["mount"])),
        replace(gyro, values=gyro.values - TRUE["bias"]),
        replace(slid, arclength=slid.arclength + TRUE["slide"]),
        replace(late, time=late.time - TRUE["delay"]),
    ]
    told = estimate(STEADY, COARSE, readings, unknowns=known)
    plain = estimate(STEADY, COARSE, by_hand)
    assert told.unknowns == [] or len(told.unknowns) == 0
    assert np.abs(told.state.difference(plain.state)).max() < 1e-12
    np.testing.assert_allclose(told.marginals.cov, plain.marginals.cov, rtol=1e-9, atol=1e-15)
    off = estimate(STEADY, COARSE, readings)
    assert off.solve.cost > 3.0 * plain.solve.cost


def test_unknowns_of_streams_that_are_not_there_change_nothing():
    rods, grid, readings = sliding_scene(nodes=3, rate=5.0)
    strangers = [unknown(kind, "nobody") for kind in SIZES]
    plain, other = estimate(rods, grid, readings), estimate(rods, grid, readings,
                                                            unknowns=strangers)  # fmt: skip
    for field in ("pose", "strain", "velocity"):
        np.testing.assert_array_equal(getattr(plain.state, field), getattr(other.state, field))
    np.testing.assert_array_equal(plain.marginals.cov, other.marginals.cov)
    assert len(other.unknowns) == 0
    assert plain.solve.log_evidence == other.solve.log_evidence


# Where on the robot a reading was taken is not known exactly (equation 16).


def test_an_uncertain_arclength_is_as_honest_as_certain_noise_is_not():
    slip, seeds, honest, bold = 8e-3, 15, [], []
    time = np.linspace(0.0, 1.0, 11)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        place = np.full(time.size, LENGTH / 2)
        seen = arc(place + slip * rng.standard_normal(time.size), time)[:, :3, 3]
        seen += 3e-4 * rng.standard_normal(seen.shape)
        coil = PositionReadings(time=time, arclength=place, values=seen, cov=9e-8, name="coil")
        base = tracker(rng, "base", 0.0)
        for std, squares in ((slip, honest), (0.0, bold)):
            readings = [base, replace(coil, arclength_std=std)]
            at = estimate(SOFT, COARSE, readings).at(LENGTH / 2, 0.4)
            error = at.position - arc(LENGTH / 2, 0.4)[:3, 3]
            squares.append(error @ np.linalg.solve(at.cov_position_world, error))
    assert consistent(honest, 3 * seeds)
    assert np.mean(bold) / 3.0 > 10.0


def test_an_uncertain_arclength_adds_the_slope_along_the_robot_to_the_covariance():
    rng = np.random.default_rng(7)
    state = motion(rng, GRID)
    plain = scattered(rng)
    spread = rng.uniform(3e-2, 6e-2, 6)
    by_hand = []
    for r in plain:
        ends = [
            r.residual(states_at(prior(), GRID, state, r.arclength + h, r.time))
            for h in (1e-6, -1e-6)
        ]
        slope = (ends[0] - ends[1]) / 2e-6
        more = spread[:, None, None] ** 2 * slope[:, :, None] * slope[:, None, :]
        assert np.abs(more).max() > 0.1 * np.abs(r.cov).max()
        by_hand.append(replace(r, cov=r.cov + more))

    def system(readings):
        room = np.empty(slab_shape(GRID, state.dof))
        found = linearize(prior(), PlacedReadings(GRID, readings), state, state, room)
        return [found.system.diagonal, found.system.lower, found.right]

    told = system([replace(r, arclength_std=spread) for r in plain])
    unmoved = system([replace(r, arclength_std=0.0) for r in plain])
    for one, other, none, zero in zip(told, system(by_hand), system(plain), unmoved, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-7 * np.abs(other).max())
        np.testing.assert_array_equal(none, zero)
    assert np.abs(told[0] - system(plain)[0]).max() > 1e-3 * np.abs(told[0]).max()


@pytest.mark.parametrize("bad", [-1e-3, [1e-3, 1e-3], np.nan])
def test_an_arclength_std_that_makes_no_sense_is_refused(bad):
    reading = sliding_scene()[2][1]
    with pytest.raises(SensorError, match=r"coil: arclength_std must be one number from 0"):
        replace(reading, arclength_std=bad)


# Files.


def test_a_posterior_with_unknowns_is_read_back_as_it_was_written(calibrations, tmp_path):
    posterior = estimate(
        STEADY,
        COARSE,
        miscalibrated(np.random.default_rng(4)),
        unknowns=[replace(u, correlation_time=2.0) if u.kind == "bias" else u for u in ASKED],
    )
    posterior.save(tmp_path / "posterior.nc")
    again = Posterior.load(tmp_path / "posterior.nc")
    for (was, values), (now, same) in zip(posterior.unknowns, again.unknowns, strict=True):
        assert (was.name, was.kind, was.streams) == (now.name, now.kind, now.streams)
        assert was.correlation_time == now.correlation_time
        np.testing.assert_array_equal(was.std, now.std)
        np.testing.assert_array_equal(was.value, now.value)
        np.testing.assert_array_equal(values, same)
        before, after = posterior.unknown(was.name)[1], again.unknown(was.name)[1]
        np.testing.assert_allclose(before, after, rtol=1e-4, atol=1e-6 * np.abs(before).max())
    here, there = (p.at([0.1, 0.3], [0.33, 0.7]) for p in (posterior, again))
    np.testing.assert_allclose(here.pose, there.pose, atol=1e-12)
    np.testing.assert_allclose(here.cov, there.cov, atol=1e-5 * np.abs(here.cov).max())
    draw = again.sample(np.random.default_rng(0))
    assert draw.pose.shape == (1, *COARSE.shape, 4, 4)


def test_an_unknown_that_was_not_estimated_is_answered_with_those_that_were(calibrations):
    names = "world, mount, bias, slide, delay"
    with pytest.raises(GlissandoError, match=f"No unknown 'nose' was estimated; .*: {names}"):
        calibrations[0].unknown("nose")
    with pytest.raises(GlissandoError, match=r"those that were: none\."):
        replace(calibrations[0], unknowns=()).unknown("nose")


# Mistakes.


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"kind": "colour"}, "is a 'colour'; choose one of world, mount, bias, slide, delay"),
        ({"value": np.zeros(2)}, "value is .* give 3 numbers"),
        ({"std": np.zeros(6)}, "std is .* give 3 numbers"),
        ({"std": 0.1}, "std is .* give 3 numbers"),
        ({"value": np.full(3, np.nan)}, "value is .* give 3 numbers"),
        ({"std": np.r_[0.1, -0.1, 0.1]}, "must not be negative"),
        ({"correlation_time": -1.0}, "must not be negative"),
        ({"correlation_time": 0.0}, "correlation time"),
        ({"correlation_time": np.nan}, "correlation time"),
    ],
)
def test_an_unknown_that_makes_no_sense_is_one_sentence(changes, sentence):
    right = {"kind": "bias", "streams": ("gyro",), "value": np.zeros(3), "std": np.full(3, 0.1)}
    Unknown("mine", **right)
    with pytest.raises(SensorError, match=sentence) as caught:
        Unknown("mine", **{**right, **changes})
    assert str(caught.value).startswith("Unknown 'mine'")


@pytest.mark.parametrize("std", [0.0, 0.1])
def test_a_bias_of_a_pose_is_refused_and_named(std):
    rods, grid, readings = sliding_scene(nodes=3, rate=5.0)
    bias = unknown("bias", "coil", value=np.full(3, 0.1), std=std)
    with pytest.raises(SensorError, match="Unknown 'bias': a CoilReadings has no bias"):
        estimate(rods, grid, readings, unknowns=[bias])


def robot_with(tmp_path, lines):
    path = tmp_path / "mine.toml"
    path.write_text(f"{robot_file('tdcr466').read_text()}\n[[unknowns]]\n{lines}\n")
    return load_robot(path)


GOOD = {"name": '"drift"', "kind": '"bias"', "streams": '["gyro"]', "std": "[0.1, 0.1, 0.1]",
        "correlation_time": "2.5"}  # fmt: skip


def as_lines(entries):
    return "\n".join(f"{key} = {value}" for key, value in entries.items())


def test_a_robot_file_may_state_unknowns(tmp_path):
    (found,) = robot_with(tmp_path, as_lines(GOOD)).unknowns
    assert (found.name, found.kind, found.streams) == ("drift", "bias", ("gyro",))
    assert found.correlation_time == 2.5
    assert not found.known
    np.testing.assert_array_equal(found.std, 0.1)
    frame = {"name": '"f"', "kind": '"world"', "streams": '["a", "b"]', "std": "[0.01, 0.1]"}
    (found,) = robot_with(tmp_path, as_lines(frame)).unknowns
    np.testing.assert_array_equal(found.std, [0.01] * 3 + [0.1] * 3)
    value = {k: v for k, v in frame.items() if k != "std"} | {"value": "[1, 2, 3, 0, 0, 1]"}
    (found,) = robot_with(tmp_path, as_lines(value)).unknowns
    assert found.known
    np.testing.assert_array_equal(found.value, [1, 2, 3, 0, 0, 1])


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"kind": '"colour"'}, "kind is 'colour'; give one of world, mount, bias, slide, delay"),
        ({"std": "[0.1, 0.1]"}, "std is .*; give 3 numbers"),
        ({"std": "[0.1, -0.1, 0.1]"}, "std is .*; give numbers above zero"),
        ({"value": "[1, 2]"}, "value is .*; give 3 numbers"),
        ({"streams": '"gyro"'}, "streams is 'gyro'; give a list of texts"),
        ({"streams": "[]"}, r"streams is \[\]; give a list of texts"),
        ({"correlation_time": "-1"}, "correlation_time is -1; give a number above zero"),
        ({"correlation_time": "0"}, "correlation_time is 0; give a number above zero"),
        ({"corelation_time": "1"}, "is not a key of this table; did you mean 'correlation_time'"),
        ({"name": "3"}, "name is 3; give a text"),
    ],
)
def test_a_mistake_in_a_robots_unknowns_names_file_entry_and_key(tmp_path, changes, sentence):
    with pytest.raises(RobotFileError, match=rf"mine.toml \[\[unknowns\]\] 1: .*{sentence}"):
        robot_with(tmp_path, as_lines({**GOOD, **changes}))


def test_unknowns_must_be_tables(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(f"unknowns = 3\n{robot_file('tdcr466').read_text()}")
    with pytest.raises(RobotFileError, match=r"\[\[unknowns\]\] must be an array of tables"):
        load_robot(path)
