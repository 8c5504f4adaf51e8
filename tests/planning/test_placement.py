"""Sensors placed within a budget: as good as the best of all sets, and no set beats the bound."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import generators
from glissando import CoilReadings, Grid, estimate, load_robot
from glissando.errors import GlissandoError
from glissando.planning.candidates import candidates_of
from glissando.planning.placement import (
    PlacementProblem,
    lower_bound,
    place_sensors,
    placement_problem,
)
from glissando.planning.zones import Zone, zone_points

ROBOT = load_robot("sliding700")
STD = {"gyro": np.array(1e-2), "fbg": np.array(1e-5)}


def drawn(rng):
    """A problem of nine candidates at random: few directions, costs of one to three."""
    d, count = int(rng.integers(2, 12)), 9
    rows = rng.standard_normal((count, int(rng.integers(1, 4)), d)) * rng.uniform(
        0.2, 4.0, (count, 1, 1)
    )
    asked = rng.standard_normal((3, d))
    costs = rng.integers(1, 4, count).astype(float)
    sensors = [candidates_of(ROBOT, "coil", cost, count=1)[0] for cost in costs]
    return PlacementProblem(sensors, list(rows), asked.T @ asked, float(rng.uniform(0, 0.1)))


def test_a_bound_is_a_variance_also_where_costs_are_far_apart():
    costs, rng = (1e-3, 1e1, 5e4, 6e-6, 3e5), np.random.default_rng(0)
    sensors = [candidates_of(ROBOT, "coil", cost, count=1)[0] for cost in costs]
    rows = [1e3 * rng.standard_normal((2, 5)) for _ in costs]
    problem = PlacementProblem(sensors, rows, np.eye(5), 0.1)
    assert 0.1 <= lower_bound(problem, 1.7e-5) <= problem.variance(np.zeros(5))


def best_of_all(problem, budget):
    """The least variance of any set."""
    count, found = len(problem.candidates), np.inf
    for size in range(count + 1):
        for chosen in combinations(range(count), size):
            share = np.zeros(count)
            share[list(chosen)] = 1.0
            if problem.cost @ share <= budget + 1e-9:
                found = min(found, problem.variance(share))
    return found


@pytest.mark.slow
@settings(deadline=None, max_examples=12)
@given(generators, st.integers(3, 9))
def test_placements_are_nearly_the_best_of_all_and_no_set_beats_the_bound(rng, budget):
    problem = drawn(rng)
    best = best_of_all(problem, budget)
    (found,) = place_sensors(problem, [budget])
    assert found.cost <= budget
    assert found.std**2 <= 1.05 * best
    assert lower_bound(problem, budget) <= best * (1.0 + 1e-9)


@settings(deadline=None, max_examples=20)
@given(generators)
def test_slopes_by_shares_are_differences(rng):
    problem = drawn(rng)
    share, nudge = rng.uniform(0.1, 0.9, 9), 1e-5
    for i, slope in enumerate(problem.slopes(share)):
        up, down = share.copy(), share.copy()
        up[i] += nudge
        down[i] -= nudge
        rise = problem.variance(up) - problem.variance(down)
        assert slope == pytest.approx(rise / (2 * nudge), rel=1e-4, abs=1e-7)


def test_the_variance_predicted_is_what_the_estimator_says():
    zones, horizon = [Zone((0.3, 0.6))], 4.0 / ROBOT.time_rate
    candidates = candidates_of(ROBOT, "coil", 1.0, count=4)
    problem = placement_problem(ROBOT, candidates, zones, horizon=horizon)
    share = np.array([0.0, 1.0, 0.0, 1.0])
    grid = Grid(ROBOT.arclength_nodes, np.linspace(0.0, horizon, 5))
    time = (np.arange(round(40.0 * horizon)) + 0.5) / 40.0
    readings = []
    for place in (0.35, 0.7):
        pose = np.tile(np.eye(4), (time.size, 1, 1))
        pose[:, 2, 3] = place
        readings.append(
            CoilReadings(
                time=time,
                arclength=np.full(time.size, place),
                values=pose,
                cov=ROBOT.sensor_std["coil"] ** 2,
                name=f"coil_{place}",
            )
        )
    posterior = estimate(ROBOT.prior, grid, readings)
    place, when, weight = zone_points(
        zones, 0.5 * (grid.time[1:] + grid.time[:-1]), (0.0, horizon), ROBOT.length
    )
    cov = posterior.at(place, when).cov[:, :3, :3]
    said = float(np.einsum("z,zii->", weight, cov))
    assert problem.variance(share) == pytest.approx(said, rel=0.05)


@pytest.mark.slow
def test_more_money_and_more_candidates_never_harm():
    zones = [Zone((0.0, 0.7))]
    coils = candidates_of(ROBOT, "coil", 1.0, count=5)
    others = [
        *candidates_of(ROBOT, "gyro", 0.5, std=STD["gyro"], count=2),
        *candidates_of(ROBOT, "fbg", 2.0, std=STD["fbg"]),
        *candidates_of(ROBOT, "slide", 2.0, slide=(0.64, 0.7, 0.024)),
    ]
    few, many = (
        list(place_sensors(placement_problem(ROBOT, c, zones, horizon=2.0), [1.0, 2.0, 4.0]))
        for c in (coils, [*coils, *others])
    )
    for found in (few, many):
        std = [each.std for each in found]
        assert np.all(np.diff(std) <= 0.0)
        assert all(each.bound <= each.std for each in found)
    assert all(b.std <= 1.01 * a.std for a, b in zip(few, many, strict=True))


@pytest.mark.parametrize(
    ("kind", "given_", "said"),
    [
        ("coil", {"cost": 0.0}, "costs 0"),
        ("gyro", {"cost": 1.0}, "states no noise of a gyro"),
        ("slide", {"cost": 1.0}, "needs a reach"),
        ("tendon", {"cost": 1.0}, "no place to choose"),
    ],
)
def test_what_cannot_be_bought_says_why(kind, given_, said):
    with pytest.raises(GlissandoError, match=said):
        candidates_of(ROBOT, kind, **given_)


def test_a_budget_that_buys_nothing_says_what_the_cheapest_costs():
    problem = drawn(np.random.default_rng(0))
    with pytest.raises(GlissandoError, match="cannot be: the cheapest sensor costs 1"):
        list(place_sensors(problem, [0.5]))
    with pytest.raises(GlissandoError, match="Budgets of 3 and then 1 fall"):
        list(place_sensors(problem, [3.0, 1.0]))


def test_a_time_ahead_that_does_not_fit_is_said_and_a_zone_after_it_refused():
    coils = candidates_of(ROBOT, "coil", 1.0, count=2)
    problem = placement_problem(ROBOT, coils, [Zone((0.3, 0.6))], horizon=100.0)
    assert problem.horizon < 10.0
    with pytest.raises(GlissandoError, match="A zone counts from 50 s on, and sensors"):
        placement_problem(ROBOT, coils, [Zone((0.3, 0.6), (50.0, 60.0))], horizon=100.0)
