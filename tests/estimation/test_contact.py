"""A force on the robot is found where it is, and none is found where nothing touches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from glissando import (
    FalseConfidenceWarning,
    Grid,
    estimate,
)
from glissando.errors import GlissandoError, OutsideGridError
from glissando.estimation.contact import scan_contacts
from glissando.estimation.contact_place import locate_contact
from glissando.simulation import Loads, Wrench, solve_shape
from touched_rod import FORCE, GRAVITY, LENGTH, NODES, PRIOR, ROD, STD, WHERE, coil, shape

# What is touched contradicts an estimate that knows of no touch.
pytestmark = pytest.mark.filterwarnings("ignore::glissando.FalseConfidenceWarning")


def scanned(readings, **settings):
    found = estimate(PRIOR, Grid(NODES, [0.0]), [readings])
    return scan_contacts(found, 0.0, std_force=STD, **settings)


def test_a_force_is_found_at_its_place_with_its_size():
    readings = coil(np.random.default_rng(0), shape(FORCE))
    scan = scanned(readings)
    assert scan.detected
    assert scan.evidence > scan.threshold + 10.0
    start = scan.arclength[scan.best]
    assert abs(start - WHERE) < 0.05 * LENGTH
    found = locate_contact(PRIOR, Grid(NODES, [0.0]), [readings], start=start, std_force=STD)
    assert abs(found.arclength - WHERE) < 3.0 * found.std_arclength
    assert found.std_arclength < 0.03 * LENGTH
    gap = found.force - FORCE
    assert gap @ np.linalg.solve(found.cov_force, gap) < 15.0
    assert np.linalg.norm(gap[:2]) < 0.35 * np.linalg.norm(FORCE)


@pytest.mark.slow
@pytest.mark.filterwarnings("error::glissando.FalseConfidenceWarning")
def test_where_two_touch_no_place_of_one_is_stated_without_a_warning():
    grid, rng = Grid(NODES, [0.0]), np.random.default_rng(0)
    pair = [Wrench(0.2, [0.1, 0.0, 0.0]), Wrench(0.4, [0.0, 0.08, 0.0])]
    two = coil(rng, solve_shape(ROD, [], Loads(gravity=GRAVITY, wrenches=pair)))
    with pytest.warns(FalseConfidenceWarning, match="No single force explains"):
        found = locate_contact(PRIOR, grid, [two], start=0.36, std_force=STD)
    assert min(abs(found.arclength - w.arclength) for w in pair) > 5.0 * found.std_arclength
    locate_contact(PRIOR, grid, [coil(rng, shape(FORCE))], start=0.3, std_force=STD)


@pytest.mark.slow
def test_the_place_of_a_force_is_known_as_well_as_the_evidence_says():
    rng, count, squares = np.random.default_rng(4), 40, []
    for _ in range(count):
        where, size, turn = rng.uniform([0.15, 0.05, 0.0], [0.45, 0.15, 2.0 * np.pi])
        force = size * np.array([np.cos(turn), np.sin(turn), 0.0])
        scan = scanned(coil(rng, shape(force, where)))
        off = scan.arclength[scan.best] - where
        squares.append((off / scan.std_place) ** 2)
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], count) / count
    assert low < np.mean(squares) < high


@pytest.mark.slow
def test_the_covariance_of_a_force_is_true_in_all_directions_though_coils_show_no_roll():
    grid, size, squares = Grid(NODES, [0.0]), 0.15, []
    for seed in range(8):
        rng = np.random.default_rng([7, seed])
        force = size * rng.standard_normal(3)
        where = rng.uniform(0.4, 0.8) * LENGTH
        readings = coil(rng, shape(force, where))
        found = locate_contact(PRIOR, grid, [readings], start=where, std_force=size)
        gap = found.force - force
        squares.append(gap @ np.linalg.solve(found.cov_force, gap))
    assert chi2.ppf(0.001, 24) < np.sum(squares) < chi2.ppf(0.999, 24)


@pytest.mark.slow
def test_a_strong_force_is_found_though_the_search_begins_elsewhere_and_never_off_the_robot():
    """The scan is linear about a shape without the force, which a strong one leaves far behind."""
    readings = coil(np.random.default_rng(4), shape(6.0 * FORCE))
    grid = Grid(NODES, [0.0])
    for start in (0.02, 0.5):
        found = locate_contact(PRIOR, grid, [readings], start=start, std_force=1.0)
        assert abs(found.arclength - WHERE) < max(3.0 * found.std_arclength, 0.01 * LENGTH)
        assert np.linalg.norm(found.force - 6.0 * FORCE) < 0.1 * np.linalg.norm(6.0 * FORCE)
        assert 0.0 <= found.arclength <= LENGTH


@pytest.mark.slow
def test_false_alarms_are_no_more_frequent_than_stated():
    """The simulated rod has no unknown loads at all, so there may be fewer."""
    rng, still = np.random.default_rng(1), shape(np.zeros(3))
    count, stated = 40, 0.2
    said = sum(scanned(coil(rng, still), false_alarms=stated).detected for _ in range(count))
    assert 0.0 < said / count < stated + 2.0 * np.sqrt(stated * (1.0 - stated) / count)


def test_the_evidence_is_that_of_a_robot_with_and_without_a_force():
    """Against Laplace's evidence of whole estimates, at a node where the force may act."""
    readings = coil(np.random.default_rng(2), shape(0.02 * FORCE))
    node = float(NODES[4])
    variance = np.concatenate([np.square(STD), np.full(3, 1e-12)])
    logs = []
    for points, var in ((np.zeros(0), np.zeros((0, 6))), (np.array([node]), variance[None])):
        prior = replace(PRIOR, points=points, var_points=var)
        logs.append(estimate(prior, Grid(NODES, [0.0]), [readings]))
    expected = logs[1].log_evidence - logs[0].log_evidence
    scan = scan_contacts(logs[0], 0.0, std_force=STD)
    near = np.argsort(np.abs(scan.arclength - node))[:2]
    assert np.mean(scan.log_ratio[near]) == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"false_alarms": 1e-6}, "give a share of times from 0.001 to 0.5"),
        ({"false_alarms": 1.0}, "give a share of times from 0.001 to 0.5"),
        ({"std_force": np.nan}, "give newtons above 0, one number or three"),
        ({"std_force": [0.3, 0.3, 0.0]}, "give newtons above 0, one number or three"),
        ({"std_force": [0.3, 0.3]}, "give newtons above 0, one number or three"),
        ({"std_force": "big"}, "std_force is 'big'; give newtons above 0"),
        ({"false_alarms": "few"}, "false_alarms is 'few'; give a share of times"),
        ({"time": []}, "needs a time"),
        ({"time": "now"}, "Places and times are numbers"),
    ],
)
def test_a_scan_for_no_force_or_an_untold_rate_is_one_sentence(wrong, sentence):
    readings = coil(np.random.default_rng(6), shape(FORCE), [0.0])
    posterior = estimate(PRIOR, Grid(NODES, [0.0]), [readings])
    with pytest.raises(GlissandoError, match=sentence):
        scan_contacts(posterior, **{"time": 0.0} | wrong)


def test_mistakes_are_one_sentence():
    readings = coil(np.random.default_rng(4), shape(np.zeros(3)))
    found = estimate(PRIOR, Grid(NODES, [0.0]), [readings])
    with pytest.raises(OutsideGridError):
        scan_contacts(found, 3.0)
    with pytest.raises(OutsideGridError, match="off the robot"):
        locate_contact(PRIOR, Grid(NODES, [0.0]), [readings], start=31.0)
    with pytest.raises(OutsideGridError):
        found.load(0.7, 0.0)


@pytest.mark.slow
def test_near_the_base_where_readings_show_force_times_place_its_covariance_is_true():
    grid, size, squares = Grid(NODES, [0.0]), 0.15, []
    for seed in range(16):
        rng = np.random.default_rng([5, seed])
        force, where = size * rng.standard_normal(3), rng.uniform(0.04, 0.3) * LENGTH
        readings = coil(rng, shape(force, where))
        found = locate_contact(PRIOR, grid, [readings], start=where, std_force=size)
        gap = found.force - force
        squares.append(gap @ np.linalg.solve(found.cov_force, gap))
        assert abs(found.arclength - where) < 4.0 * found.std_arclength
    assert np.sum(squares) < chi2.ppf(0.999, 3 * 16)
    assert np.mean(np.array(squares) > chi2.ppf(0.95, 3)) < 0.2
