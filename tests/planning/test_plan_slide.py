"""The search for a path: within limits, never worse than a start, near the best of all paths."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glissando.planning import (
    Chance,
    LogDet,
    PathSpace,
    Trace,
    Worst,
    Zone,
    evaluate_path,
    judge_of,
    plan_greedily,
    plan_slide,
)
from glissando.simulation import SlideLimits
from plans import LENGTH, ROBOTS, ZONE, small_outlook, small_track

OBJECTIVES = {"trace": Trace(), "logdet": LogDet(), "max": Worst(), "chance": Chance(0.02)}
kinds = pytest.mark.parametrize("kind", ROBOTS)


@kinds
@pytest.mark.parametrize("name", OBJECTIVES)
def test_no_start_is_better_than_the_plan_and_neither_is_the_greedy_path(kind, name):
    outlook = small_outlook(kind)
    track = small_track(outlook)
    judge = judge_of(outlook, [ZONE], OBJECTIVES[name])
    plan = plan_slide(judge, track, [ZONE])
    assert plan.value <= min(plan.starts.values())
    assert plan.value == pytest.approx(judge.value(plan.arclength), rel=1e-12)
    assert plan.value <= plan_greedily(judge, track)[1]


@settings(max_examples=15, deadline=None)
@given(
    share=st.floats(0.0, 1.0),
    speed=st.floats(0.01, 0.3),
    acceleration=st.floats(0.05, 3.0),
    low=st.floats(0.0, 0.65),
)
def test_no_plan_breaks_a_limit(share, speed, acceleration, low):
    outlook = small_outlook(reach=(low, LENGTH))
    limits = SlideLimits(LENGTH - low, speed, acceleration)
    start = low + share * (LENGTH - low)
    track = small_track(outlook, start, speed, acceleration, (low, LENGTH))
    zone = Zone((0.3, 0.6))
    plan = plan_slide(judge_of(outlook, [zone], Trace()), track, [zone], tried=2, iterations=8)
    path = plan.slide_path(LENGTH, limits)  # refuses what breaks a limit
    np.testing.assert_allclose(LENGTH - path.at(track.times), plan.arclength, atol=1e-9)
    np.testing.assert_allclose(plan.at(outlook.times)[0], plan.arclength, atol=1e-9)
    assert plan.arclength[0] == pytest.approx(start, abs=0.5 * acceleration * 0.05**2 + 1e-9)


def exhaustive(judge, track, unit, most):
    """The least value of all paths whose control points are whole steps, no more than `most`."""
    best, span = np.inf, round((track.upper - track.lower) / unit)
    first = round((track.start - track.lower) / unit)

    def extended(places, way):
        nonlocal best
        left = track.steps + 2 - len(places)
        if left == 1:
            control = track.lower + unit * np.array([*places, places[-1]], dtype=float)
            best = min(best, judge.value(track.places(control)))
            return
        for step in range(max(way - 1, -most), min(way + 1, most) + 1):
            there = places[-1] + step
            if 0 <= there <= span and abs(step) <= left - 1:
                extended([*places, there], step)

    extended([first, first], 0)
    return best


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
    outlook = small_outlook(kind, 7.0, reach, step=1.0, node_step=1.0)
    judge = judge_of(outlook, [zone], OBJECTIVES[name])
    track = PathSpace(*reach, 2.0 * unit, unit, 1.0, outlook.steps, start)
    plan = plan_slide(judge, track, [zone])
    best = exhaustive(judge, track, unit, 2)
    assert plan.value <= best + 0.01 * abs(best)


@kinds
@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_moving_zone_is_followed_almost_as_well_as_if_it_were_still(kind, share):
    """At up to half the slide's speed, within 25 % of a sensor that stays in such a zone."""
    speed, reach, horizon = 0.06, (0.2, LENGTH), 6.0
    outlook = small_outlook(kind, horizon, reach)
    way = share * speed * horizon

    def moving(time):
        middle = 0.65 - way * time / horizon
        return middle - 0.02, middle + 0.02

    zone = Zone(moving)
    track = small_track(outlook, 0.65, speed, 0.2, reach)
    plan = plan_slide(judge_of(outlook, [zone], Trace()), track, [zone])
    followed = evaluate_path(outlook, [zone], Trace(), plan.arclength).std
    still = [
        evaluate_path(outlook, [Zone((s - 0.02, s + 0.02))], Trace(), np.full(outlook.steps, s)).std
        for s in 0.65 - way * np.linspace(0.0, 1.0, 4)
    ]
    assert followed <= 1.25 * np.mean(still)


def test_motion_of_the_sensor_is_spared_as_its_weight_grows():
    outlook = small_outlook()
    track, judge = small_track(outlook), judge_of(outlook, [ZONE], Trace())
    plans = [plan_slide(judge, track, [ZONE], wear=wear) for wear in (0.0, 0.02, 10.0)]
    swift = [np.mean(np.diff(plan.control) ** 2) for plan in plans]
    assert swift[0] > swift[1] > swift[2]
    assert swift[2] < 1e-3 * swift[0]
    values = [judge.value(plan.arclength) for plan in plans]
    assert values[0] <= 1.02 * values[1] <= 1.02**2 * values[2]


def test_the_same_seed_gives_the_same_plan_and_more_starts_never_a_worse_one():
    outlook = small_outlook("kinematic")
    track, judge = small_track(outlook), judge_of(outlook, [ZONE], Trace())
    plans = [plan_slide(judge, track, [ZONE], tried=tried) for tried in (1, 1, 6)]
    np.testing.assert_array_equal(plans[0].control, plans[1].control)
    assert plans[2].value <= plans[0].value * (1.0 + 1e-3)
