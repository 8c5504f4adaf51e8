"""Objectives: what they measure, and their gradients by the covariance."""

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.stats import chi2

from draws import generators
from glissando.errors import GlissandoError
from glissando.planning import Chance, LogDet, Trace, Worst, Zone
from glissando.planning.objectives import objective_named
from glissando.planning.zones import read_zone, zone_points
from slope import slope_test

OBJECTIVES = Trace(), Trace(lever=0.05), LogDet(), Worst(), Chance(5e-3)
each = pytest.mark.parametrize("objective", OBJECTIVES)
UNIT = 1e-5  # m²


def drawn(rng, count=4, rows=3):
    root = rng.standard_normal((count, rows, rows)) * rng.uniform(0.3, 3.0, (count, 1, rows))
    weight = rng.uniform(0.1, 1.0, count)
    return UNIT * (root @ root.mT + 0.1 * np.eye(rows)), weight / weight.sum()


@each
def test_the_gradient_of_every_objective_says_how_it_changes_with_the_covariance(objective):
    cov, weight = drawn(np.random.default_rng(3), rows=objective.rows)
    value, gradient = objective(cov, weight)

    def moved(step):
        change = UNIT * step.reshape(cov.shape)
        return np.atleast_1d(objective(cov + 0.5 * (change + change.mT), weight)[0] / abs(value))

    slope_test(moved, UNIT * gradient.reshape(1, -1) / abs(value))


@each
@settings(max_examples=40, deadline=None)
@given(rng=generators)
def test_no_objective_falls_where_the_covariance_grows(objective, rng):
    cov, weight = drawn(rng, rows=objective.rows)
    more, _ = drawn(rng, rows=objective.rows)
    assert objective(cov + more, weight)[0] >= objective(cov, weight)[0]
    assert np.linalg.eigvalsh(objective(cov, weight)[1]).min() >= -1e-12


@each
@settings(max_examples=20, deadline=None)
@given(rng=generators)
def test_no_objective_depends_on_the_frame(objective, rng):
    cov, weight = drawn(rng, rows=objective.rows)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn = np.kron(np.eye(objective.rows // 3), turn)
    value = objective(cov, weight)[0]
    np.testing.assert_allclose(objective(turn @ cov @ turn.T, weight)[0], value, rtol=2e-3)


def test_the_chance_of_an_error_beyond_the_bound_is_what_sampling_says():
    rng = np.random.default_rng(0)
    for _ in range(5):
        cov, _ = drawn(rng, 1)
        errors = rng.multivariate_normal(np.zeros(3), cov[0], size=200_000)
        share = np.mean(np.sum(errors**2, axis=1) > 5e-3**2)
        chance = Chance(5e-3)(cov, np.ones(1))[0]
        assert abs(chance - share) < 4.0 * np.sqrt(share * (1.0 - share) / 200_000) + 1e-4


@pytest.mark.parametrize("bound", [0.5, 1.0, 2.0, 4.0])
def test_the_chance_of_a_round_covariance_is_that_of_a_chi_square(bound):
    chance = Chance(bound)(np.eye(3)[None], np.ones(1))[0]
    assert chance == pytest.approx(chi2.sf(bound**2, 3), rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(rng=generators)
def test_the_worst_direction_is_bounded_by_the_largest_eigenvalue_anywhere(rng):
    cov, _ = drawn(rng)
    largest = np.linalg.eigvalsh(cov).max()
    worst = Worst()(cov, np.full(4, 0.25))[0]
    assert largest * 4.0 ** (-1 / 16) <= worst * (1 + 1e-12)
    assert worst <= largest * 3.0 ** (1 / 16) * (1 + 1e-12)


def test_zones_share_their_weight_among_their_points_and_move_evenly():
    still, moving = read_zone("0.1:0.2@0:1*3"), read_zone("0.1:0.2..0.5:0.6@0:10")
    place, time, weight = zone_points([still, moving], np.arange(0.5, 10.0), (0.0, 10.0), 0.7)
    mine = time <= 1.0
    assert weight.sum() == pytest.approx(1.0)
    first = weight[: np.sum(mine) // 2]
    assert first.sum() == pytest.approx(0.75)
    last = place[time == 9.5]
    assert (last.min(), last.max()) == pytest.approx((0.48 + 0.01, 0.58 - 0.01))


def points_of(*zones):
    return zone_points(zones, np.arange(3.0), (0.0, 3.0), 0.7)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Zone((0.5, 0.4)), "0.5 to 0.4 is empty"),
        (lambda: Zone((0.1, 0.4), (2.0, 1.0)), "2 to 1 is empty"),
        (lambda: Zone((0.1, 0.4), weight=0.0), "weight 0"),
        (lambda: read_zone("0.1"), "'0.1' is not understood"),
        (lambda: read_zone("0.1:0.2..0.3:0.4"), "add @T0:T1"),
        (lambda: objective_named("best"), "no objective 'best'"),
        (lambda: Chance(0.0), "bound of 0 m"),
        (lambda: points_of(), "No zone counts"),
        (lambda: points_of(Zone((0.1, 0.9))), "the body from 0 to 0.7 m"),
        (lambda: points_of(Zone((0.1, 0.2), (4, 5))), "from 4 to 5 s, the time ahead from 0 to 3"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(make, message):
    with pytest.raises(GlissandoError, match=message):
        make()
