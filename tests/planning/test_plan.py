"""Foresight: what is foretold of a path is what the estimator says, and so is its gradient."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import generators
from glissando import FixedLagSmoother, Grid, SensorParameter, estimate
from glissando.errors import GlissandoError
from glissando.planning import (
    Chance,
    LogDet,
    SlidingSensor,
    Trace,
    Worst,
    Zone,
    evaluate_path,
    everywhere,
    judge_of,
    plan_slide,
    predict_information,
    sliding_sensor,
)
from glissando.planning.compare import baseline_paths
from glissando.planning.greedy import Belief
from glissando.planning.path_objective import by_cell
from glissando.simulation import SlideLimits
from plans import LENGTH, REACH, ROBOTS, ZONE, small_outlook, small_track, wiggle
from slope import slope_test

OBJECTIVES = {
    "trace": Trace(),
    "trace with rotation": Trace(lever=0.05),
    "logdet": LogDet(),
    "max": Worst(),
    "chance": Chance(0.02),
}
kinds = pytest.mark.parametrize("kind", ROBOTS)
AT = np.array([0.2, 0.45, 0.6, 0.7])


def read_along(outlook, arclength):
    """The readings that a straight robot gives on a path (T,), each in agreement with it."""
    count = round(outlook.steps * outlook.step * outlook.sensor.rate)
    last = outlook.steps * outlook.step
    time = outlook.start + (np.arange(count) + 0.5) * last / count
    place = np.interp(time, outlook.times, arclength)
    pose = np.tile(np.eye(4), (count, 1, 1))
    pose[:, 2, 3] = place
    return outlook.sensor.readings(pose, place, time)


def cov_of(estimated, time):
    return estimated.at(AT, time).cov[:, :6, :6]


@kinds
def test_what_is_foretold_of_a_path_is_what_the_estimator_says_after_it(kind):
    robot, outlook = ROBOTS[kind], small_outlook(kind)
    path = wiggle(outlook)
    told = outlook.told(path)
    found = estimate(robot.prior, outlook.ahead.grid, [read_along(outlook, path)])
    for time in (0.0, 1.3, 2.5):
        mine = told.cov_pose(AT, np.full(AT.size, time))
        np.testing.assert_allclose(mine, cov_of(found, time), rtol=1e-5, atol=1e-11)


@pytest.mark.parametrize(("kind", "slack"), [("separable", 1e-4), ("kinematic", 0.06)])
def test_foresight_from_an_estimate_goes_on_from_all_that_it_knows(kind, slack):
    """Estimated to 1.5 s and foretold to 3 s, or estimated to 3 s at once: the same.

    But for what the kinematic prior says between arclength nodes near the last time of an estimate,
    which depends on the time that this stands for.
    """
    robot, past = ROBOTS[kind], small_outlook(kind, 1.5)
    before = read_along(past, wiggle(past))
    known = estimate(robot.prior, past.ahead.grid, [before])
    outlook = small_outlook(kind, 1.5, known=known)
    path = wiggle(outlook)
    both = before.joined(read_along(outlook, path))
    grid = Grid(robot.arclength_nodes, np.append(past.ahead.grid.time, outlook.ahead.grid.time[1:]))
    whole = estimate(robot.prior, grid, [both])
    told = outlook.told(path)
    for time in (1.5, 2.2, 3.0):
        mine = told.cov_pose(AT, np.full(AT.size, time))
        spread = (np.einsum("zii->z", cov[:, :3, :3]) for cov in (mine, cov_of(whole, time)))
        np.testing.assert_allclose(*spread, rtol=slack)


def test_foresight_goes_on_from_a_running_smoother_with_its_unknowns():
    robot, past = ROBOTS["separable"], small_outlook(horizon=2.0)
    drift = SensorParameter("frame", "frame", ("coil",), np.zeros(6), np.full(6, 2e-3), 3.0)
    before = read_along(past, wiggle(past))
    smoother = FixedLagSmoother(
        robot.prior, robot.arclength_nodes, window=99, sensor_parameters=[drift], gate=None
    )
    smoother.add(before)
    for time in past.ahead.grid.time:
        smoother.advance(time)
    outlook = small_outlook(horizon=1.0, known=smoother)
    path = wiggle(outlook)
    grid = Grid(robot.arclength_nodes, np.append(past.ahead.grid.time, outlook.ahead.grid.time[1:]))
    both = before.joined(read_along(outlook, path))
    whole = estimate(robot.prior, grid, [both], sensor_parameters=[drift])
    mine = outlook.told(path).cov_pose(AT, np.full(AT.size, 2.7))
    np.testing.assert_allclose(mine, cov_of(whole, 2.7), rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize(("kind", "slack"), [("separable", 0.01), ("kinematic", 0.05)])
@pytest.mark.parametrize(("reach", "horizon"), [(REACH, 3.0), ((0.1, LENGTH), 3.0), (REACH, 1.1)])
def test_a_few_modes_judge_a_path_almost_as_the_whole_does(kind, slack, reach, horizon):
    """Also if the time ahead ends within a time step of the estimate."""
    outlook = small_outlook(kind, horizon, reach, node_step=0.5)
    judge = judge_of(outlook, [ZONE], Trace())
    for path in (wiggle(outlook, reach), np.full(outlook.steps, 0.6)):
        whole = evaluate_path(outlook, [ZONE], Trace(), path)
        assert np.sqrt(judge.value(path)) == pytest.approx(whole.std, rel=slack)


@kinds
@pytest.mark.parametrize("coils", [1, 2])
@pytest.mark.parametrize("name", OBJECTIVES)
def test_the_gradient_of_a_whole_path_is_that_of_its_value(kind, coils, name):
    outlook = small_outlook(kind, coils=coils, spacing=0.07)
    judge = judge_of(outlook, [ZONE, Zone((0.65, 0.7), (1.0, 2.0), 0.5)], OBJECTIVES[name])
    path = wiggle(outlook)
    value, slope = judge(path)
    size = abs(value)

    def moved(step):
        return np.atleast_1d(judge.value(path + 5e-2 * step) / size)

    slope_test(moved, 5e-2 * slope[None] / size)
    assert value == judge.value(path)


@kinds
def test_dense_covariances_updated_reading_by_reading_say_the_same(kind):
    outlook = small_outlook(kind)
    judge = judge_of(outlook, [ZONE], Trace())
    path, belief = wiggle(outlook), Belief.before(judge)
    for cell, rows in enumerate(by_cell(judge.readings(path)[0], outlook.inside)):
        belief.update(rows, cell)
    scale = np.abs(judge.before).max()
    np.testing.assert_allclose(belief.zone_cov(), judge.cov(path), rtol=1e-5, atol=1e-9 * scale)


@settings(max_examples=25, deadline=None)
@given(
    kind=st.sampled_from(sorted(ROBOTS)),
    sensor=st.sampled_from(["coil", "pose", "position"]),
    rng=generators,
)
def test_one_more_reading_never_raises_a_variance_anywhere(kind, sensor, rng):
    rows = {"coil": 5, "pose": 6, "position": 3}[sensor]
    more = SlidingSensor(rng.uniform(1e-7, 1e-4, rows), kind=sensor)
    outlook = small_outlook(kind, 1.0)
    known = outlook.told(wiggle(outlook))
    place, time = rng.uniform(0.0, LENGTH, 30), rng.uniform(0.0, 1.0, 30)
    before = known.cov_pose(place, time)
    after = known.after(more, rng.uniform(0.0, LENGTH, 1), rng.uniform(0.0, 1.0, 1))
    gained = np.linalg.eigvalsh(before - after.cov_pose(place, time))
    assert gained.min() > -1e-7 * np.linalg.eigvalsh(before).max()
    assert gained.max() > 0.0


@kinds
def test_no_path_knows_more_than_a_sensor_everywhere_at_once(kind):
    outlook = small_outlook(kind)
    most = everywhere(outlook, [ZONE], Trace())
    limits = SlideLimits(REACH[1] - REACH[0], 0.06, 0.2)
    for path in baseline_paths(limits, LENGTH, 0.65, outlook.times).values():
        assert evaluate_path(outlook, [ZONE], Trace(), path).value > most.value


def test_what_cannot_be_foreseen_is_told_in_a_sentence():
    robot = ROBOTS["separable"]
    known = estimate(robot.prior, robot.grid(0.0, 1.0), [])
    with pytest.raises(GlissandoError, match="does not say what slides"):
        predict_information(known, REACH, 3.0)
    with pytest.raises(GlissandoError, match="shorten the stroke"):
        predict_information(robot, (0.6, 0.8), 3.0)
    with pytest.raises(GlissandoError, match="bring the coils closer"):
        predict_information(robot, REACH, 3.0, sliding_sensor(robot, coils=3, spacing=0.3))
    with pytest.raises(GlissandoError, match="give two steps or more"):
        predict_information(robot, REACH, 0.1)
    with pytest.raises(GlissandoError, match="cannot slide"):
        SlidingSensor(np.ones(3), kind="gyro")
    outlook = small_outlook()
    with pytest.raises(GlissandoError, match="give both the same"):
        plan_slide(judge_of(outlook, [ZONE], Trace()), replace(small_track(outlook), steps=9))
