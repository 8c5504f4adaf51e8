"""What the online estimator does with readings and clocks that cannot be right."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from glissando import Grid, PoseReadings, PositionReadings, load_robot
from glissando.errors import OutsideGridError, SensorError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.innovation_gate import InnovationGate
from glissando.estimation.reading_buffer import ReadingBuffer
from glissando.geometry import se3
from glissando.model.noise import GemanMcClure
from online import PRIORS, fed
from scenes import LENGTH, arc, sliding_scene

POSE_COV = np.repeat([1e-6, 1e-4], 3)


def test_a_gross_outlier_is_refused_counted_and_leaves_no_trace():
    prior, grid, readings = sliding_scene()
    calm = FixedLagSmoother(prior, grid.arclength, window=4)
    clean = fed(calm, grid, readings)[-1]
    assert calm.fits
    base, coil, gyro = readings
    bad = coil.values.copy()
    bad[[10, 25], 0, 3] += 0.3
    smoother = FixedLagSmoother(prior, grid.arclength, window=4)
    found = fed(smoother, grid, [base, replace(coil, values=bad), gyro])[-1]
    assert smoother.dropped["coil"]["gated"] == 2
    assert np.abs(found.position - clean.position).max() < 2e-3
    open_to_all = FixedLagSmoother(prior, grid.arclength, window=4, gate=None)
    fed(open_to_all, grid, [base, replace(coil, values=bad), gyro])
    assert not open_to_all.dropped
    assert not smoother.fits  # what was refused counts against the model


def test_a_tracker_that_freezes_is_not_believed_and_one_that_states_a_fact_is():
    """A frozen coil goes on with new stamps; the base that is held says the same at all times."""
    prior, grid, (base, coil, gyro) = sliding_scene()
    frozen = (coil.time > 0.5) & (coil.time < 1.5)
    values = coil.values.copy()
    values[frozen] = values[np.argmax(frozen)]
    smoother = FixedLagSmoother(prior, grid.arclength, window=4)
    found = fed(smoother, grid, [base, replace(coil, values=values), gyro])
    assert smoother.dropped == {"coil": {"repeated": np.count_nonzero(frozen) - 1}}
    blind = FixedLagSmoother(prior, grid.arclength, window=4)
    first = np.flatnonzero(frozen)[0]
    heard = ~frozen | (np.arange(frozen.size) == first)
    for now, then in zip(found, fed(blind, grid, [base, coil.select(heard), gyro]), strict=True):
        np.testing.assert_array_equal(now.position, then.position)
        np.testing.assert_array_equal(now.cov, then.cov)


def test_a_frozen_tracker_of_several_bodies_is_not_believed_either():
    """Rows of different places stand between those of one."""
    robot, rng = load_robot("tdcr466"), np.random.default_rng(0)
    place = robot.length * np.array([0.5, 1.0])
    at_rest, spread = place[:, None] * [0.0, 0.0, 1.0], []
    for bodies in ((slice(0, 1), slice(1, 2)), (slice(0, 2),)):
        smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
        for k in range(60):
            if k < 30:
                seen = at_rest + 1e-3 * rng.standard_normal((2, 3))
            for number, body in enumerate(bodies):
                read = {"arclength": place[body], "values": seen[body], "cov": 1e-6}
                time = np.full(len(read["arclength"]), k / 30)
                smoother.add(PositionReadings(time=time, name=f"body{number}", **read))
            newest = smoother.advance(k / 30)
        assert sum(d["repeated"] for d in smoother.dropped.values()) == 60
        spread.append(newest.std_position[-1])
    assert spread[1] == pytest.approx(spread[0], rel=1e-3)
    assert spread[0] > 0.1


def test_bodies_at_rest_that_a_stream_without_noise_reads_are_no_frozen_tracker():
    robot = load_robot("tdcr466")
    place = robot.length * np.array([0.5, 1.0])
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    for k in range(10):
        values = place[:, None] * [0.0, 0.0, 1.0]
        time = np.full(2, k / 30)
        smoother.add(PositionReadings(time=time, arclength=place, values=values, cov=1e-6))
        smoother.advance(k / 30)
    assert not smoother.dropped


@pytest.mark.parametrize("places", [(0.02, 1.0), (0.02, 0.25, 0.5, 0.75, 1.0)])
def test_a_place_that_is_refused_for_long_is_believed_though_others_of_its_stream_fit(places):
    """The robot bends in a step; what is read near its base fits before and after."""
    robot, rng = load_robot("sliding700"), np.random.default_rng(1)
    rest = robot.prior.rest_state(Grid(robot.arclength_nodes, [0.0])).pose[0, 0]
    place = robot.length * np.array(places)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    for k in range(150):
        bend = 0.5 if k < 60 else 2.5
        pose = rest @ se3.exp(place[:, None] * [0.0, 0.0, 1.0, 0.0, bend, 0.0])
        values = pose @ se3.exp(np.sqrt(POSE_COV) * rng.standard_normal((place.size, 6)))
        time = np.full(place.size, k / 30)
        read = {"arclength": place, "values": values, "cov": POSE_COV, "name": "bodies"}
        smoother.add(PoseReadings(time=time, **read))
        newest = smoother.advance(k / 30)
    assert smoother.dropped["bodies"]["gated"] <= 10 * place.size
    off = np.linalg.norm(newest.position[-1] - pose[-1, :3, 3])
    assert off < 4.0 * newest.std_position[-1] < 0.05
    assert smoother.fits


def test_outliers_of_a_stream_with_a_saturating_loss_are_survived_and_judged(monkeypatch):
    rng, squares = np.random.default_rng(0), []
    prior, grid, (base, coil, gyro) = sliding_scene(duration=2.0)
    wrong = rng.random(len(coil)) < 0.2
    values = coil.values.copy()
    values[wrong, :3, 3] += 0.05 * rng.standard_normal((np.count_nonzero(wrong), 3))
    coil = replace(coil, values=values, loss=GemanMcClure(3.0))
    smoother = FixedLagSmoother(prior, grid.arclength, window=5)
    note = InnovationGate.note
    monkeypatch.setattr(
        InnovationGate, "note",
        lambda self, name, at, nis, dof: squares.extend(nis) or note(self, name, at, nis, dof),
    )  # fmt: skip
    tip = fed(smoother, grid, [base, coil, gyro])[-1].position[-1]
    assert np.linalg.norm(tip - arc(LENGTH, grid.time[-1])[:3, 3]) < 5e-3
    assert min(squares) >= 0.0
    assert max(squares) > 100.0  # outliers are seen for what they are


def test_a_hundred_thousand_readings_that_come_again_are_refused_soon():
    prior, grid, (_, coil, _) = sliding_scene()
    time = 1e-5 * np.random.default_rng(0).permutation(100_000)
    many = PoseReadings(
        time=time, arclength=np.full(time.size, LENGTH), cov=1e-6, name="pose",
        values=np.repeat(coil.values[:1], time.size, axis=0),
    )  # fmt: skip
    smoother = FixedLagSmoother(prior, grid.arclength, window=4)
    tracemalloc.start()
    smoother.add(many)
    smoother.add(many)
    assert tracemalloc.get_traced_memory()[1] < 300e6
    tracemalloc.stop()
    assert smoother.dropped["pose"]["repeated"] == 100_000


def test_a_stream_that_was_right_all_along_is_believed_in_the_end():
    prior, grid, readings = sliding_scene(duration=2.0)
    base, coil, gyro = readings
    coil = coil.select(slice(None, None, 4))  # one an update: several at once would agree
    moved = coil.values.copy()
    moved[6:, 0, 3] += 0.2
    smoother = FixedLagSmoother(prior, grid.arclength, window=4)
    tip = fed(smoother, grid, [base, replace(coil, values=moved), gyro])[-1].position[-1]
    assert 1 <= smoother.dropped["coil"]["gated"] <= 10
    assert abs(tip[0] - arc(LENGTH, 2.0)[0, 3] - 0.2) < 0.05


def faulty(rng, stream):
    """The stream as a bad day gives it: arrival times (M,), and rows lost, wrong and delayed."""
    kept = rng.uniform(size=len(stream)) > 0.3
    kept &= (stream.time < 2.0) | (stream.time > 4.0)  # a blackout
    stream = stream.select(kept)
    came = stream.time + (rng.uniform(size=len(stream)) < 0.1) * rng.uniform(0, 0.1, len(stream))
    values = stream.values.copy()
    wrong = rng.uniform(size=len(stream)) < 0.05
    if values.shape[1:] == (4, 4):
        values[wrong, :3, 3] += rng.normal(0.0, 0.2, (wrong.sum(), 3))
    else:
        values[wrong] += rng.normal(0.0, 5.0, (wrong.sum(), 3))
    time = stream.time + (0.05 if stream.name == "gyro" else 0.0)  # a clock that is off
    return replace(stream, values=values, time=time), came


def through_a_bad_day(prior, seed):
    """Std and error (m) of the tip at every update, and what the smoother made of the day."""
    rng = np.random.default_rng(seed)
    _, grid, readings = sliding_scene(seed, duration=6.0, rate=20.0)
    day = [faulty(rng, stream) for stream in readings]
    smoother = FixedLagSmoother(prior, grid.arclength, window=5)
    spread, miss = [], []
    for k, time in enumerate(grid.time):
        since = grid.time[k - 1] if k else -np.inf
        for stream, came in day:
            now = (came > since) & (came <= time)
            if np.any(now):
                smoother.add(stream.select(now))
        newest = smoother.advance(time)
        spread.append(newest.std_position[-1])
        miss.append(np.linalg.norm(newest.position[-1] - arc(LENGTH, time)[:3, 3]))
    return grid.time, np.array(spread), np.array(miss), smoother


@pytest.mark.slow
@pytest.mark.parametrize("kind", PRIORS)
def test_a_bad_day_of_losses_blackout_outliers_disorder_and_a_wrong_clock(kind):
    ratios = []
    for seed in range(5):
        time, spread, miss, smoother = through_a_bad_day(PRIORS[kind], seed)
        before, dark = (time > 1.0) & (time < 1.9), (time > 2.5) & (time < 4.0)
        after = time > 4.5
        print(f"tip error before {miss[before].max():.4f}, after {miss[after].max():.4f} m")
        print(f"began again {smoother.restarts} times; {smoother.dropped}")
        print(f"std before {np.median(spread[before]):.4f}, dark {spread[dark].max():.4f} m")
        assert spread[dark].max() > 5.0 * np.median(spread[before])
        assert np.median(miss[after]) < 0.02
        assert sum(c["gated"] for c in smoother.dropped.values()) >= 3
        ratios.append(np.median(spread[after]) / np.median(spread[before]))
    # Losses and outliers go on and days differ: one may end worse than it began, most do not.
    assert np.median(ratios) < 1.5


def test_times_and_readings_that_make_no_sense_are_counted_and_nothing_breaks():
    prior, grid, (base, coil, _) = sliding_scene()
    smoother = FixedLagSmoother(prior, grid.arclength, window=3)
    with pytest.raises(OutsideGridError, match=r"call advance\(time\) first"):
        smoother.newest()
    fed(smoother, grid, [base, coil])
    before = smoother.newest()
    for rows, later in ((slice(0, 2), 0.0), (slice(2, 4), 100.0)):
        smoother.add(replace(coil.select(rows), time=coil.time[:2] + later))
    outside = replace(coil.select(slice(0, 1)), time=np.array([1.05]), arclength=np.array([9.0]))
    smoother.add(outside)
    back = smoother.advance(0.2)  # the clock went back
    assert smoother.dropped["coil"] == {"late": 2, "ahead": 2, "off the robot": 1}
    np.testing.assert_allclose(back.pose, before.pose, atol=1e-6)
    assert smoother.time == 1.0
    with pytest.raises(OutsideGridError, match="is nan"):
        smoother.advance(np.nan)
    with pytest.raises(SensorError, match="was CoilReadings"):
        smoother.add(replace(base, name="coil"))
    with pytest.raises(OutsideGridError, match="window of 0"):
        FixedLagSmoother(prior, grid.arclength, window=0)


@pytest.mark.parametrize("name", ["tdcr466", "sliding700"])
@pytest.mark.parametrize("apart", [1e-12, 3e-4])
def test_updates_that_are_hardly_apart_cost_neither_the_state_nor_a_reading(name, apart):
    robot = load_robot(name)
    rest = robot.prior.rest_state(Grid(robot.arclength_nodes, [0.0])).take(0).pose[-1:]
    place, cov = np.array([robot.length]), np.full(6, 1e-6)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    time = 0.0
    for step in [1 / 30] * 8 + [apart] * 3 + [1 / 30] * 8:
        time += step
        smoother.add(PoseReadings(time=np.array([time]), arclength=place, values=rest, cov=cov))
        newest = smoother.advance(time)
    assert smoother.restarts == 0
    assert newest.std_position[-1] < 3e-3
    assert not smoother.dropped


def test_a_clock_that_was_set_back_is_refused_and_not_answered_with_an_old_state():
    robot = load_robot("tdcr466")
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    smoother.advance(7200.0)
    smoother.advance(7199.9)
    with pytest.raises(OutsideGridError, match="the clock was set"):
        smoother.advance(3600.0)


def test_a_sensor_with_a_wrong_residual_is_named_online_as_well():
    class Short(PositionReadings):
        def residual(self, at):
            return super().residual(at)[:, :2]

    robot = load_robot("tdcr466")
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    place = np.array([[0.05, 0.0, 0.45]])
    smoother.add(Short(time=[0.0], arclength=[0.466], values=place, cov=1e-6, name="short"))
    with pytest.raises(SensorError, match="return \\(1, 3\\), a row for each reading"):
        smoother.advance(0.0)


def test_an_absurd_stamp_does_not_make_later_readings_look_like_repeated_ones():
    buffer = ReadingBuffer(LENGTH, InnovationGate(1e-6), lambda _: False)
    read = PoseReadings(
        time=[0.0, 50.0], arclength=[LENGTH] * 2, values=arc([LENGTH] * 2, [0.0, 0.1]), cov=1e-6
    )
    buffer.take(read, -np.inf)
    buffer.refuse_ahead(0.0)
    assert buffer._newest == {read.label: 0.0}


@pytest.mark.parametrize("wrong", [3, 6, 8])
def test_of_many_readings_of_an_update_no_wrong_one_is_believed(wrong):
    """Two trackers at the tip, ten readings of each in an update; one of them is 50 mm off."""
    robot, rng = load_robot("sliding700"), np.random.default_rng(0)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    for k in range(1, 8):
        for name in "ab":
            pose = np.tile(np.eye(4), (10, 1, 1))
            pose[:, :3, 3] = 1e-3 * rng.standard_normal((10, 3)) + [0.0, 0.0, robot.length]
            if k == 7 and name == "b":
                pose[-wrong:, 0, 3] += 0.05
            every = {"time": 0.1 * k - 0.09 + 0.01 * np.arange(10), "name": name}
            place = np.full(10, robot.length)
            smoother.add(PoseReadings(arclength=place, values=pose, cov=POSE_COV, **every))
        newest = smoother.advance(0.1 * k)
    assert smoother.dropped["b"]["gated"] == wrong
    assert smoother.dropped["a"]["gated"] == 0
    assert abs(newest.position[-1, 0]) < 4.0 * np.sqrt(newest.cov[-1, 0, 0])


def test_rows_that_come_twice_in_one_batch_count_once():
    robot = load_robot("sliding700")
    time = np.array([0.0, 0.1, 0.2, 0.3])
    spread = []
    for again in (1, 2):
        smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=6)
        values = np.tile(np.eye(4), (4 * again, 1, 1))
        values[:, 2, 3] = robot.length
        place = np.full(4 * again, robot.length)
        read = {"arclength": place, "values": values, "cov": POSE_COV, "name": "tip"}
        smoother.add(PoseReadings(time=np.tile(time, again), **read))
        spread.append(smoother.advance(0.3).std_position[-1])
        assert smoother.dropped["tip"]["repeated"] == 4 * (again - 1)
    assert spread[0] == spread[1]
