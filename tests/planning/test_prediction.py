"""Prediction: what is predicted for a path is what the estimator says, and so is its gradient."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import generators
from glissando import FixedLagSmoother, Grid, SensorParameter, estimate
from glissando.errors import GlissandoError
from glissando.planning import (
    SlidingSensor,
    Trace,
    Zone,
    baseline_paths,
    evaluate_everywhere,
    evaluate_path,
    path_objective_of,
    plan_slide,
    predict_information,
)
from glissando.planning.path_objective import by_cell
from glissando.simulation import SlideLimits
from oracles.greedy_planner import DenseModes
from plans import (
    LENGTH,
    OBJECTIVES,
    REACH,
    ROBOTS,
    ZONE,
    read_straight,
    small_problem,
    small_task,
    wiggle,
)
from slope import slope_test

kinds = pytest.mark.parametrize("kind", ROBOTS)
AT = np.array([0.2, 0.45, 0.6, 0.7])


def read_along(problem, arclength):
    """The readings of a straight robot on a path (T,), no two alike to the last digit."""
    time = problem.sensor.reading_times(problem.start, problem.end - problem.start)
    readings = read_straight(problem.sensor, np.interp(time, problem.times, arclength), time)
    values = readings.values.copy()
    values[:, 0, 3] += 1e-15 * np.arange(time.size)
    return replace(readings, values=values)


def predicted_cov(problem, path, time):
    return problem.predict(path).cov_pose(AT, np.full(AT.size, time))


def cov_of(posterior, time):
    return posterior.at(AT, time).cov[:, :6, :6]


def grid_of(robot, *problems):
    times = [problem.ahead.grid.time for problem in problems]
    return Grid(robot.arclength_nodes, np.unique(np.concatenate(times)))


@kinds
def test_what_is_predicted_for_a_path_is_what_the_estimator_says_after_it(kind):
    robot, problem = ROBOTS[kind], small_problem(kind)
    path = wiggle(problem)
    posterior = estimate(robot.prior, problem.ahead.grid, [read_along(problem, path)])
    for time in (0.0, 1.3, 2.5):
        cov = predicted_cov(problem, path, time)
        np.testing.assert_allclose(cov, cov_of(posterior, time), rtol=1e-5, atol=1e-11)


@pytest.mark.parametrize(("kind", "slack"), [("separable", 1e-4), ("kinematic", 0.06)])
def test_prediction_from_an_estimate_goes_on_from_all_that_it_knows(kind, slack):
    """Estimated to 1.5 s and predicted to 3 s, or estimated to 3 s at once: the same.

    But for what the kinematic prior says between arclength nodes near the last time of an estimate,
    which depends on the time that this stands for.
    """
    robot, past = ROBOTS[kind], small_problem(kind, 1.5)
    readings = read_along(past, wiggle(past))
    problem = small_problem(kind, 1.5, source=estimate(robot.prior, past.ahead.grid, [readings]))
    path = wiggle(problem)
    both = readings.joined(read_along(problem, path))
    whole = estimate(robot.prior, grid_of(robot, past, problem), [both])
    for time in (1.5, 2.2, 3.0):
        covs = predicted_cov(problem, path, time), cov_of(whole, time)
        variances = (np.einsum("zii->z", cov[:, :3, :3]) for cov in covs)
        np.testing.assert_allclose(*variances, rtol=slack)


def test_prediction_goes_on_from_a_running_smoother_with_its_sensor_parameters():
    robot, past = ROBOTS["separable"], small_problem(horizon=2.0)
    drift = [SensorParameter("frame", "frame", ("coil",), np.zeros(6), np.full(6, 2e-3), 3.0)]
    readings = read_along(past, wiggle(past))
    smoother = FixedLagSmoother(
        robot.prior, robot.arclength_nodes, window=99, sensor_parameters=drift, gate=None
    )
    smoother.add(readings)
    for time in past.ahead.grid.time:
        smoother.advance(time)
    problem = small_problem(horizon=1.0, source=smoother)
    path = wiggle(problem)
    both = readings.joined(read_along(problem, path))
    whole = estimate(robot.prior, grid_of(robot, past, problem), [both], sensor_parameters=drift)
    cov = predicted_cov(problem, path, 2.7)
    np.testing.assert_allclose(cov, cov_of(whole, 2.7), rtol=1e-3, atol=1e-9)


def test_what_is_unknown_of_other_sensors_says_nothing_to_a_plan():
    """Such as the delay of a gyroscope, beside the coil that slides."""
    late = SensorParameter("delay", "time_offset", ("imu",), np.zeros(1), np.full(1, 0.02))
    beside = small_problem(source=replace(ROBOTS["separable"], sensor_parameters=(late,)))
    problem = small_problem()
    path = wiggle(problem)
    covs = [predicted_cov(each, path, 1.3) for each in (beside, problem)]
    np.testing.assert_allclose(*covs, rtol=1e-6, atol=1e-14)


@pytest.mark.parametrize(("kind", "slack"), [("separable", 0.01), ("kinematic", 0.05)])
@pytest.mark.parametrize(("reach", "horizon"), [(REACH, 3.0), ((0.1, LENGTH), 3.0), (REACH, 1.1)])
def test_a_few_modes_evaluate_a_path_almost_as_the_whole_does(kind, slack, reach, horizon):
    """Also if the time ahead ends within a time step of the estimate."""
    problem = small_problem(kind, horizon, reach, node_step=0.5)
    path_objective = path_objective_of(problem, [ZONE], Trace())
    for path in (wiggle(problem, reach), np.full(problem.steps, 0.6)):
        whole = evaluate_path(problem, [ZONE], Trace(), path)
        assert np.sqrt(path_objective.value(path)) == pytest.approx(whole.std, rel=slack)


@kinds
@pytest.mark.parametrize("coils", [1, 2])
@pytest.mark.parametrize("objective", [*OBJECTIVES.values(), Trace(lever=0.05)])
def test_the_gradient_of_a_whole_path_is_that_of_its_value(kind, coils, objective):
    problem = small_problem(kind, coils=coils, spacing=0.07)
    zones = [ZONE, Zone((0.65, 0.7), (1.0, 2.0), 0.5)]
    path_objective = path_objective_of(problem, zones, objective)
    path = wiggle(problem)
    value, gradient = path_objective(path)
    size = abs(value)

    def moved(step):
        return np.atleast_1d(path_objective.value(path + 5e-2 * step) / size)

    slope_test(moved, 5e-2 * gradient[None] / size)
    assert value == path_objective.value(path)


@kinds
def test_dense_covariances_updated_reading_by_reading_say_the_same(kind):
    problem, _, path_objective = small_task(kind)
    path, modes = wiggle(problem), DenseModes(path_objective)
    rows = path_objective.readings(path)[0]
    for cell, rows_of_cell in enumerate(by_cell(rows, problem.steps_per_cell)):
        modes.update(rows_of_cell, cell)
    atol = 1e-9 * np.abs(path_objective.prior_cov).max()
    np.testing.assert_allclose(modes.zone_cov(), path_objective.cov(path), rtol=1e-5, atol=atol)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    kind=st.sampled_from(sorted(ROBOTS)),
    sensor=st.sampled_from([("coil", 5), ("pose", 6), ("position", 3)]),
    rng=generators,
)
def test_one_more_reading_never_raises_a_variance_anywhere(kind, sensor, rng):
    more = SlidingSensor(rng.uniform(1e-7, 1e-4, sensor[1]), kind=sensor[0])
    problem = small_problem(kind, 1.0)
    prediction = problem.predict(wiggle(problem))
    place, time = rng.uniform(0.0, LENGTH, 30), rng.uniform(0.0, 1.0, 30)
    before = prediction.cov_pose(place, time)
    after = prediction.after(more, rng.uniform(0.0, LENGTH, 1), rng.uniform(0.0, 1.0, 1))
    gained = np.linalg.eigvalsh(before - after.cov_pose(place, time))
    assert gained.min() > -1e-7 * np.linalg.eigvalsh(before).max()
    assert gained.max() > 0.0


@kinds
def test_no_path_knows_more_than_a_sensor_everywhere_at_once(kind):
    problem = small_problem(kind)
    bound = evaluate_everywhere(problem, [ZONE], Trace())
    limits = SlideLimits(REACH[1] - REACH[0], 0.06, 0.2)
    for path in baseline_paths(limits, LENGTH, 0.65, problem.times).values():
        assert evaluate_path(problem, [ZONE], Trace(), path).value > bound.value


def test_coils_that_follow_each_other_are_everywhere_on_the_body():
    one, two = (small_problem(coils=c, spacing=s) for c, s in ((1, 0.0), (2, 0.5)))
    bounds = [evaluate_everywhere(problem, [ZONE], Trace()).value for problem in (one, two)]
    assert bounds[1] < bounds[0]


def test_what_cannot_be_predicted_is_refused_in_a_sentence():
    robot = ROBOTS["separable"]
    _, space, path_objective = small_task()
    with pytest.raises(GlissandoError, match="does not say what slides"):
        predict_information(estimate(robot.prior, robot.grid(0.0, 1.0), []), REACH, 3.0)
    with pytest.raises(GlissandoError, match="shorten the stroke"):
        small_problem(reach=(0.6, 0.8))
    with pytest.raises(GlissandoError, match="bring the coils closer"):
        small_problem(coils=3, spacing=0.3)
    with pytest.raises(GlissandoError, match="give two steps or more"):
        small_problem(horizon=0.1)
    with pytest.raises(GlissandoError, match="cannot slide"):
        SlidingSensor(np.ones(3), kind="gyro")
    path = np.full(space.steps, LENGTH)
    wrong = path[1:], path - 0.3, path * 1e3, path * np.nan, np.array([])
    for each in wrong:
        for evaluated in (path_objective, path_objective.value, path_objective.problem.predict):
            with pytest.raises(GlissandoError, match=r"give \(30,\), from 0.58 to 0.7 m"):
                evaluated(each)
    with pytest.raises(GlissandoError, match="give both the same"):
        plan_slide(path_objective, replace(space, steps=9))
