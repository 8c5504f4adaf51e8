"""The search for a path: within limits, never worse than a start, near the best of all paths."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glissando.planning import (
    MovingInterval,
    PathSpace,
    Trace,
    Zone,
    evaluate_path,
    path_objective_of,
    plan_slide,
)
from glissando.simulation import SlideLimits
from oracles.greedy_planner import plan_greedily
from plans import LENGTH, OBJECTIVES, ROBOTS, ZONE, small_problem, small_space, small_task

kinds = pytest.mark.parametrize("kind", ROBOTS)


@kinds
@pytest.mark.parametrize("name", OBJECTIVES)
def test_no_start_is_better_than_the_plan_and_neither_is_the_greedy_path(kind, name):
    _, space, path_objective = small_task(kind, objective=OBJECTIVES[name])
    plan = plan_slide(path_objective, space, [ZONE])
    assert plan.value <= min(plan.starts.values())
    assert plan.value == pytest.approx(path_objective.value(plan.arclength), rel=1e-12)
    assert plan.value <= plan_greedily(path_objective, space)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(
    share=st.floats(0.0, 1.0),
    speed=st.floats(0.01, 0.3),
    acceleration=st.floats(0.05, 3.0),
    low=st.floats(0.0, 0.65),
)
def test_no_plan_breaks_a_limit(share, speed, acceleration, low):
    problem = small_problem(reach=(low, LENGTH))
    limits = SlideLimits(LENGTH - low, speed, acceleration)
    start = low + share * (LENGTH - low)
    space = small_space(problem, start, speed, acceleration, (low, LENGTH))
    zones = [Zone((0.3, 0.6))]
    path_objective = path_objective_of(problem, zones, Trace())
    plan = plan_slide(path_objective, space, zones, candidates=2, iterations=8)
    path = plan.slide_path(LENGTH, limits)  # refuses what breaks a limit
    np.testing.assert_allclose(LENGTH - path.at(space.times), plan.arclength, atol=1e-9)
    np.testing.assert_allclose(plan.at(problem.times)[0], plan.arclength, atol=1e-9)
    assert plan.arclength[0] == pytest.approx(start, abs=0.5 * acceleration * 0.05**2 + 1e-9)


def exhaustive(path_objective, space, unit, most):
    """The least value of all paths whose control points are whole steps, no more than `most`."""
    span = round((space.upper - space.lower) / unit)

    def values(places, move):
        left = space.steps + 2 - len(places)
        if left == 1:
            control = space.lower + unit * np.array([*places, places[-1]], dtype=float)
            yield path_objective.value(space.arclength(control))
            return
        for step in range(max(move - 1, -most), min(move + 1, most) + 1):
            if 0 <= places[-1] + step <= span and abs(step) <= left - 1:
                yield from values([*places, places[-1] + step], step)

    first = round((space.start - space.lower) / unit)
    return min(values([first, first], 0))


PROBLEMS = [
    (kind, name, zone, start)
    for (kind, name), (zone, start) in zip(
        itertools.product(ROBOTS, OBJECTIVES),
        itertools.cycle([(Zone((0.45, 0.5)), 0.7), (Zone((0.2, 0.6)), 0.6), (ZONE, 0.5)]),
        strict=False,
    )
    for zone in (zone, Zone((0.3, 0.35), (3.0, 7.0)), Zone((0.66, 0.7), (0.0, 4.0)))
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "name", "zone", "start"), PROBLEMS)
def test_the_plan_is_within_one_percent_of_the_best_of_all_paths(kind, name, zone, start):
    """Seven steps of 1 s, up to two units a step, changing by one: every path is tried."""
    reach, unit = (0.4, LENGTH), 0.05
    problem = small_problem(kind, 7.0, reach, step=1.0, node_step=1.0)
    path_objective = path_objective_of(problem, [zone], OBJECTIVES[name])
    space = PathSpace(*reach, 2.0 * unit, unit, 1.0, problem.steps, start)
    plan = plan_slide(path_objective, space, [zone])
    best = exhaustive(path_objective, space, unit, 2)
    assert plan.value <= best + 0.01 * abs(best)


@pytest.mark.slow
@kinds
@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_moving_zone_is_followed_almost_as_well_as_if_it_were_still(kind, share):
    """At up to half the slide's speed, within 25 % of a sensor that stays in such a zone."""
    speed, reach, horizon = 0.06, (0.2, LENGTH), 6.0
    problem, last = small_problem(kind, horizon, reach), 0.65 - share * speed * horizon

    def zone_at(place):
        return place - 0.02, place + 0.02

    zone = Zone(MovingInterval((0.0, horizon), zone_at(0.65), zone_at(last)))
    space = small_space(problem, 0.65, speed, 0.2, reach)
    plan = plan_slide(path_objective_of(problem, [zone], Trace()), space, [zone])
    followed = evaluate_path(problem, [zone], Trace(), plan.arclength).std
    still = [
        evaluate_path(problem, [Zone(zone_at(s))], Trace(), np.full(problem.steps, s)).std
        for s in np.linspace(0.65, last, 4)
    ]
    assert followed <= 1.25 * np.mean(still)


def test_motion_of_the_sensor_is_spared_as_its_weight_grows():
    _, space, path_objective = small_task()
    plans = [plan_slide(path_objective, space, [ZONE], speed_weight=w) for w in (0.0, 0.02, 10.0)]
    square_speeds = [np.mean(np.diff(plan.control) ** 2) for plan in plans]
    assert square_speeds[0] > square_speeds[1] > square_speeds[2]
    assert square_speeds[2] < 1e-3 * square_speeds[0]
    values = [path_objective.value(plan.arclength) for plan in plans]
    assert values[0] <= 1.02 * values[1] <= 1.02**2 * values[2]


def test_the_same_seed_gives_the_same_plan_and_more_starts_never_a_worse_one():
    _, space, path_objective = small_task("kinematic")
    plans = [plan_slide(path_objective, space, [ZONE], candidates=count) for count in (1, 1, 6)]
    np.testing.assert_array_equal(plans[0].control, plans[1].control)
    assert plans[2].value <= plans[0].value * (1.0 + 1e-3)


def test_how_much_of_a_search_is_done_only_grows():
    _, space, path_objective = small_task("kinematic")
    shown = []
    plan_slide(path_objective, space, [ZONE], progress=lambda *counted: shown.append(counted))
    done, total = zip(*shown, strict=True)
    assert len(set(total)) == 1
    assert list(done) == sorted(set(done))
    assert (done[0], done[-1] < total[0]) == (0, True)
