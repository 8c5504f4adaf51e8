"""Touches that come and go: what is read of them counts, online and in a batch alike."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from glissando import FixedLagSmoother, Grid, SolverOptions, estimate
from glissando.errors import GlissandoError
from glissando.estimation.contact import (
    ContactScan,
    bending_force,
    mixed,
    scan_contacts,
    scan_of,
)
from glissando.estimation.contact_evidence import error_priors
from glissando.estimation.contact_force import force_at, nearest_nodes
from glissando.model.priors.mechanical.intervals import still_columns, still_error
from glissando.simulation import Loads, Wrench, solve_shape
from mechanical_rod import GRID, mechanical, moving
from oracles import separable as oracle
from touched_rod import FORCE, GRAVITY, LENGTH, NODES, PLACES, PRIOR, ROD, STD, coil, joined, shape

TIMES = np.linspace(0.0, 0.6, 7)
EXACT = SolverOptions(tolerance=1e-4)
SWAYED = replace(PRIOR, var_tip=np.repeat([0.1, 1e-8], 3))

# What is touched contradicts an estimate that knows of no touch.
pytestmark = pytest.mark.filterwarnings("ignore::glissando.FalseConfidenceWarning")


@pytest.mark.slow
def test_online_a_touch_is_seen_while_it_lasts():
    rng, smoother = np.random.default_rng(3), FixedLagSmoother(PRIOR, NODES, window=4)
    said = []
    for step in range(8):
        time = 0.1 * step
        bent = shape(FORCE if step >= 4 else np.zeros(3))
        smoother.add(coil(rng, bent, [time]))
        smoother.advance(time)
        said.append(smoother.contacts(std_force=STD, false_alarms=1e-3).detected)
    assert not any(said[:4])
    assert all(said[5:])
    for time in np.arange(0.8, 3.0, 0.2):  # nothing is read any more
        smoother.advance(time)
        scan = smoother.contacts(std_force=STD, false_alarms=1e-3)
        assert not scan.detected
        assert np.all(np.nan_to_num(scan.force) == 0.0)


def test_times_at_which_nothing_was_read_say_nothing_of_a_touch():
    readings = coil(np.random.default_rng(6), shape(FORCE), [0.0])
    grid = Grid(NODES, np.arange(0.0, 3.01, 0.25))
    scan = scan_contacts(estimate(PRIOR, grid, [readings]), grid.time, std_force=STD)
    assert scan.detected.tolist() == [True] + [False] * 12
    assert np.all(np.isnan(scan.force[1:]))


@pytest.mark.slow
def test_readings_of_a_touch_are_no_outliers_and_an_outlier_is_no_touch():
    """The prior knows of no touch and would refute all that is read while one lasts."""
    rng, times = np.random.default_rng(8), np.arange(0.0, 2.01, 0.2)
    touched, free, push = (times > 0.9) & (times < 1.5), shape(np.zeros(3)), shape(FORCE)
    parts = [coil(rng, push if on else free, [t]) for on, t in zip(touched, times, strict=True)]
    readings, wrong = joined(parts), 3 * PLACES.size - 1
    readings.values[wrong, :3, 3] += [0.0, 0.02, 0.0]
    posterior = estimate(replace(PRIOR, time_scale=0.1), Grid(NODES, times), [readings])
    assert posterior.solve.refused == {"CoilReadings": [wrong]}
    scan = scan_contacts(posterior, times, std_force=STD)
    np.testing.assert_array_equal(scan.detected, touched)


@pytest.mark.slow
@pytest.mark.parametrize(("time_scale", "step"), [(0.1, 0.1), (1.0, 1.0 / 30.0)])
def test_online_the_readings_of_a_touch_are_believed_and_wrong_ones_are_not(time_scale, step):
    """It comes and goes within 0.3 s and moves the tip by half the length."""
    rng, smoother = (
        np.random.default_rng(2),
        FixedLagSmoother(replace(PRIOR, time_scale=time_scale), NODES, window=4),
    )
    off = []
    for k in range(int(1.5 / step)):
        now = k * step
        bent = shape(np.interp(now, [0.4, 0.7, 1.0, 1.3], [0.0, 1.0, 1.0, 0.0]) * FORCE)
        seen = coil(rng, bent, [now])
        few = seen.select(slice(1, None, 3))
        if k % 5 == 2:
            few.values[-1, 1, 3] += 0.03
        smoother.add(few)
        found = smoother.advance(now)
        off += [np.linalg.norm(found.position[-1] - bent.at(NODES).pose[-1, :3, 3])]
    wrong = len(range(2, int(1.5 / step), 5))
    assert smoother.dropped == {"CoilReadings": {"gated": wrong}}
    assert max(off) < 0.025


@pytest.mark.slow
@pytest.mark.parametrize("online", [False, True])
@pytest.mark.parametrize("share", [0.25, 1.0])
def test_over_time_a_force_is_as_large_as_it_is_and_there_while_it_is(online, share):
    """The scan of one time counts all others as the fading trace of a force at that time alone."""
    prior, times, squares = replace(PRIOR, time_scale=0.1), np.arange(0.0, 1.01, 0.1), []
    free, push = shape(np.zeros(3)), shape(share * FORCE)
    for seed in range(3):
        rng = np.random.default_rng([seed, 11])
        parts = [coil(rng, push if k >= 5 else free, [t]) for k, t in enumerate(times)]
        if online:
            smoother, scans = FixedLagSmoother(prior, NODES, window=4), []
            for part in parts:
                smoother.add(part)
                smoother.advance(float(part.time[0]))
                scans.append(smoother.contacts(std_force=STD))
            scan = ContactScan.over(scans)
        else:
            posterior = estimate(prior, Grid(NODES, times), [joined(parts)], gate=None)
            scan = scan_contacts(posterior, times, std_force=STD)
        assert not scan.detected[:5].any()
        assert scan.detected[6:].all()
        turn = push.at(scan.arclength[scan.best]).pose[:, :3, :3]
        off = scan.force - np.einsum("kji,j->ki", turn, share * FORCE)
        squares += [off[k, :2] @ np.linalg.solve(scan.cov[k, :2, :2], off[k, :2])
                    for k in range(6, 11)]  # fmt: skip
    assert np.mean(np.array(squares) < chi2.ppf(0.95, 2)) > 0.85


@pytest.fixture(scope="module")
def swaying():
    """A coil's readings of a rod that nothing but a swaying force at its tip moves."""
    rng = np.random.default_rng(5)
    parts = []
    for time in TIMES:
        side = 0.3 * np.array([np.sin(5.0 * time), np.cos(3.0 * time), 0.0])
        parts.append(coil(rng, shape(side, LENGTH), [time]))
    return joined(parts)


@pytest.mark.slow
def test_a_map_over_time_is_the_same_online_and_in_batch(swaying):
    batch = estimate(SWAYED, Grid(NODES, TIMES), [swaying], gate=None, options=EXACT)
    smoother = FixedLagSmoother(SWAYED, NODES, window=TIMES.size, gate=None)
    smoother.add(swaying)
    for time in TIMES:
        smoother.advance(float(time))
    smoother.iterate()
    whole = scan_contacts(batch, TIMES, std_force=STD)
    last = smoother.contacts(std_force=STD)
    assert whole.log_ratio.shape == (TIMES.size, whole.arclength.size)
    np.testing.assert_allclose(last.log_ratio, whole.log_ratio[-1], atol=0.1)
    np.testing.assert_allclose(last.threshold, whole.threshold[-1], atol=0.1)
    one = scan_contacts(batch, TIMES[3], std_force=STD)
    both = ContactScan.over([one, last])
    np.testing.assert_allclose(both.log_ratio[0], whole.log_ratio[3])
    np.testing.assert_allclose(both.time, TIMES[[3, -1]])
    with pytest.raises(GlissandoError, match="scans of one smoother, one at least"):
        ContactScan.over([])


def test_what_is_believed_of_errors_of_a_moving_robot_is_what_all_factors_say():
    """Against the inverse of the information of all prior factors together."""
    prior = mechanical()
    state = moving(np.random.default_rng(6), prior)
    count, n, dof = GRID.shape[0] * GRID.shape[1], GRID.shape[1], state.dof
    information = np.zeros((count * dof, count * dof))
    for batch in prior.factors(GRID, state, state, slice(0, GRID.shape[0])):
        flat = oracle.spread(batch, count)
        white = (batch.terms.sqrt_info @ flat.reshape(*batch.terms.residual.shape, -1)).reshape(
            -1, count * dof
        )
        information += white.T @ white
    size = 1.0 / np.sqrt(np.diag(information))
    cov = size[:, None] * np.linalg.inv(size[:, None] * information * size) * size
    cov = cov.reshape(GRID.shape[0], n, dof, GRID.shape[0], n, dof)
    found = error_priors(prior, GRID, state)
    for k, here in enumerate(found):
        at = state.take(k)
        ends = at.take(np.s_[:-1]), at.take(np.s_[1:])
        _, slopes = still_error(*ends, prior.rod.intervals(GRID.arclength))
        columns = still_columns(slopes.shape[3])
        for i in range(n - 1):
            nodes = np.ix_([i, i + 1], columns)
            both = cov[k, :, :, k][nodes[0], nodes[1]].reshape(2 * columns.size, n, dof)
            both = both[:, [i, i + 1]][:, :, columns].reshape(2 * columns.size, -1)
            slope = slopes[i].reshape(12, -1)
            expected, std = slope @ both @ slope.T, np.sqrt(np.diag(here.of_errors[i]))
            np.testing.assert_allclose(
                here.of_errors[i] / np.outer(std, std), expected / np.outer(std, std), atol=2e-4
            )
    fresh = error_priors(prior, GRID.at_times(GRID.time[-1:]), state.take(np.s_[-1:]))
    off = found[-1].of_errors - fresh[0].of_errors
    assert np.abs(off / fresh[0].of_errors).max() > 0.01  # shapes before do matter


def test_a_scan_counts_no_information_that_there_is_not(swaying, monkeypatch):
    """A force is never known worse than before, and online an untouched robot gives no alarm."""
    smoother, scans, covs = FixedLagSmoother(SWAYED, NODES, window=3, gate=None), [], []

    def noting(evidence, time, variance, false_alarms):
        covs.append(evidence.given_force(variance)[0])
        return scan_of(evidence, time, variance, false_alarms)

    monkeypatch.setattr("glissando.estimation.fixed_lag.scan_of", noting)
    smoother.add(swaying)
    for time in TIMES:
        smoother.advance(float(time))
        scans.append(smoother.contacts(std_force=STD))
    scan = ContactScan.over(scans)
    value = np.linalg.eigvalsh(np.array(covs) / np.outer(STD, STD))
    assert value.min() > 0.0
    assert value.max() < 1.0 + 1e-9
    assert value[0, 0].min() > 0.9  # beside the base, at the first time
    assert not scan.detected.any()


@pytest.mark.parametrize("seed", range(3))
def test_a_force_is_as_unsure_as_its_place_makes_it(seed):
    """Drawn from one of several places, it has the mean and the covariance of all draws."""
    rng = np.random.default_rng(seed)
    shares, mean = rng.uniform(0.1, 1.0, 3), rng.standard_normal((3, 3))
    roots = 0.3 * rng.standard_normal((3, 3, 3))
    found, cov = mixed(shares, mean, roots @ np.swapaxes(roots, 1, 2))
    at = rng.choice(3, 40_000, p=shares / shares.sum())
    drawn = mean[at] + np.einsum("mij,mj->mi", roots[at], rng.standard_normal((at.size, 3)))
    np.testing.assert_allclose(drawn.mean(axis=0), found, atol=0.03)
    np.testing.assert_allclose(np.cov(drawn.T), cov, atol=0.05)


def test_a_force_counts_every_node_at_which_it_may_act():
    rng, times = np.random.default_rng(4), np.arange(0.0, 0.41, 0.1)
    free, push = shape(np.zeros(3)), shape(0.25 * FORCE)
    parts = [coil(rng, push if k >= 3 else free, [t]) for k, t in enumerate(times)]
    prior = replace(PRIOR, time_scale=0.1)
    posterior = estimate(prior, Grid(NODES, times), [joined(parts)], gate=None)
    scan = scan_contacts(posterior, times, std_force=STD)
    at = posterior.at(scan.arclength[scan.best[4]], times[4]).pose[:3, :3]
    nodes = nearest_nodes(NODES, scan.arclength)
    each = np.array([scan.shares[4, nodes == n].sum() for n in range(NODES.size)])
    row = np.array([4])
    found = [force_at(posterior, n, np.square(STD), row) for n in range(1, NODES.size)]
    forces, covs = (np.concatenate(part) for part in zip(*found, strict=True))
    mean, cov = mixed(each[1:], forces @ at, at.T @ covs @ at)
    np.testing.assert_allclose(scan.force[4], mean, atol=0.05 * np.sqrt(np.diagonal(cov)).max())
    np.testing.assert_allclose(scan.cov[4], cov, atol=0.1 * cov.max())


@pytest.mark.slow
def test_a_robot_that_moves_freely_seems_touched_less_often_if_touches_push_across_it():
    """Its tip moves by a tenth of its length, and readings hardly determine forces along it."""
    rng, said = np.random.default_rng(7), []
    times, places, density = 0.05 * np.arange(40), np.linspace(0.05, LENGTH, 10), 1e-4
    tip = np.repeat([1e-4, 9e-8], 3)
    prior = replace(PRIOR, psd_load=np.repeat([density, 1e-8], 3), var_tip=tip)
    var = np.full((10, 6), np.repeat([density, 1e-8], 3) * LENGTH / 10)
    var[-1] += tip
    lasting = [[oracle.matern(a - b, 1.0)[0, 0] for a in times] for b in times]
    root = np.linalg.cholesky(lasting)
    for _ in range(4):
        sway = np.einsum("ij,jnc->inc", root, rng.standard_normal((times.size, 10, 6)))
        smoother = FixedLagSmoother(prior, NODES, window=4)
        for time, now in zip(times, np.sqrt(var) * sway, strict=True):
            held = [Wrench(s, w[:3], w[3:]) for s, w in zip(places, now, strict=True)]
            held = Loads(gravity=GRAVITY, wrenches=held)
            smoother.add(coil(rng, solve_shape(ROD, [], held), [time]).select(slice(-1, None)))
            smoother.advance(time)
            size = bending_force(prior, NODES)
            scans = [smoother.contacts(std_force=std) for std in (None, size)]
            said.append([bool(scan.detected) for scan in scans])
    across, any_way = np.mean(said, axis=0)
    assert across < 0.7 * any_way
