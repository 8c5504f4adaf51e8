"""The separable prior against its definition: a dense Gaussian process over arclength × time.

About a still rod of constant strain the prior is that process exactly, at nodes and along
arclength; between time nodes the body's frame moves, and what a cell says errs by the third power
of its duration over the time scale or less. Nothing it says depends on the grid or the duration.
"""

from dataclasses import replace
from decimal import Decimal, localcontext
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from scipy.linalg import expm

from draws import generators, law, motion, poses, sixes, states
from glissando import (
    BaseDensity,
    CoilReadings,
    Grid,
    GyroReadings,
    KinematicPrior,
    Options,
    OutsideGridError,
    PoseReadings,
    State,
    estimate,
    matern,
    se3,
)
from glissando.intervals import RATED, interval_between, interval_end, interval_error
from glissando.points import sort_points
from glissando.separable import BaseVariance, SeparablePrior
from glissando.state import DOF
from oracles import dense
from oracles import separable as oracle
from slope import slope_test

M = 12
GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25])
NODES = 12
REST = np.array([0.02, -0.01, 1.03, 1.2, -0.8, 0.5])
PSD = np.array([1e-3, 1.2e-3, 2e-3, 3.0, 4.0, 2.0])
BASE = BaseVariance(
    np.array([1e-4, 2e-4, 1e-4, 1e-2, 2e-2, 1e-2]), np.array([1e-3, 1e-3, 2e-3, 2.0, 1.0, 1.5])
)
SCALE = 0.8
JOINT = 0.25
JUMP = np.array([1e-3, 1e-3, 1e-3, 3.0, 2.0, 0.5])
TWO = {
    "psd_strain_arclength": np.stack([PSD, 0.5 * PSD[[1, 2, 0, 5, 3, 4]]]),
    "joints": np.array([JOINT]),
    "jumps": JUMP[None],
}
PROCESS = {
    "psd": PSD,
    "base_pose_var": BASE.pose,
    "base_strain_var": BASE.strain,
    "time_scale": SCALE,
    "rest_strain": REST,
}
UNBENT = np.zeros((2, M, 12))


def separable(**changes):
    """A prior of a soft rod bent at rest, with every variance different."""
    settings = {
        "psd_strain_arclength": PSD,
        "time_scale": SCALE,
        "base": BASE,
        "rest_strain": REST,
    }
    return SeparablePrior(**{**settings, **changes})


def rated(rng, state):
    """The state with strain rates."""
    return replace(state, strain_rate=sixes(rng, *state.strain.shape[:-1], reach=0.3, angle=3.0))


def moving(rng, grid=GRID):
    """A bent and moving rod on a grid whose neighbours nearly agree."""
    return rated(rng, motion(rng, grid))


# The process in time


def exact_noise(time_scale, step):
    """Q = P∞ − Φ P∞ Φᵀ with sixty digits, where the difference may cancel."""
    with localcontext() as context:
        context.prec = 60
        rate, step = Decimal(3).sqrt() / Decimal(time_scale), Decimal(step)
        a, fade = rate * step, (-rate * step).exp()
        phi = ((1 + a) * fade, step * fade, -rate * a * fade, (1 - a) * fade)
        start = Decimal(1), rate**2
        rows = [
            [start[0] - phi[0] ** 2 * start[0] - phi[1] ** 2 * start[1]],
            [-phi[0] * phi[2] * start[0] - phi[1] * phi[3] * start[1]],
            [start[1] - phi[2] ** 2 * start[0] - phi[3] ** 2 * start[1]],
        ]
        first, corner, last = (float(row[0]) for row in rows)
    return np.array([[first, corner], [corner, last]])


@pytest.mark.parametrize("time_scale", [0.02, 0.8, 30.0])
def test_the_noise_of_a_step_is_what_fading_leaves_to_fill(time_scale):
    steps = time_scale * np.array([0.1, 0.5, 1.0, 3.0])
    phi, start = matern.transition(time_scale, steps), matern.stationary(time_scale)
    expected = start - phi @ start @ phi.swapaxes(1, 2)
    unit = np.sqrt(np.outer(np.diag(start), np.diag(start)))
    found = matern.process_covariance(time_scale, steps)
    np.testing.assert_allclose(found / unit, expected / unit, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("share", 10.0 ** np.arange(-9, 2))
def test_the_noise_of_a_step_keeps_its_digits_however_short_the_step(share):
    found = matern.process_covariance(0.8, np.array(0.8 * share))
    np.testing.assert_allclose(found, exact_noise(0.8, 0.8 * share), rtol=1e-12)


def test_the_noise_of_a_short_step_has_its_limits():
    rate, a = np.sqrt(3.0) / 0.8, 1e-7
    found = matern.process_covariance(0.8, np.array(a / rate))
    limit = np.array([[4 / 3 * a**3, 2 * rate * a**2], [2 * rate * a**2, 4 * rate**2 * a]])
    np.testing.assert_allclose(found, limit, rtol=4 * a)


@law
@given(generators)
def test_two_steps_are_one_long_step(rng):
    scale, (a, b) = rng.uniform(0.1, 10.0), rng.uniform(0.0, 3.0, 2)
    first, then = (matern.transition(scale, scale * step) for step in (a, b))
    whole = matern.transition(scale, scale * (a + b))
    unit = np.diag([1.0, np.sqrt(3.0) / scale])
    np.testing.assert_allclose(
        np.linalg.solve(unit, then @ first @ unit),
        np.linalg.solve(unit, whole @ unit),
        rtol=0.0,
        atol=1e-14,
    )
    noise = then @ matern.process_covariance(scale, scale * a) @ then.T
    noise = noise + matern.process_covariance(scale, scale * b)
    total = matern.process_covariance(scale, scale * (a + b))
    np.testing.assert_allclose(noise, total, rtol=1e-10, atol=1e-15 * unit[1, 1])


@law
@given(generators)
def test_a_step_is_the_exponential_of_its_drift(rng):
    scale = rng.uniform(0.1, 10.0)
    step, rate = scale * rng.uniform(0.0, 3.0), np.sqrt(3.0) / scale
    drift = np.array([[0.0, 1.0], [-(rate**2), -2.0 * rate]])
    np.testing.assert_allclose(
        matern.transition(scale, step), expm(step * drift), rtol=1e-10, atol=1e-13
    )


@law
@given(generators)
def test_a_bridge_in_time_is_the_process_conditioned_on_both_ends(rng):
    scale = rng.uniform(0.1, 10.0)
    step = scale * rng.uniform(0.2, 3.0)
    offset = step * rng.uniform(0.1, 0.9)
    times = 0.0, step, offset
    cov = np.block([[oracle.matern(t - t2, scale) for t2 in times] for t in times])
    gain = np.linalg.solve(cov[:4, :4], cov[:4, 4:]).T
    left = cov[4:, 4:] - gain @ cov[:4, 4:]
    unit = np.array([1.0, np.sqrt(3.0) / scale])
    early, late, found = matern.bridge(scale, np.array([step]), np.array([offset]))
    weights = np.concatenate([early[0], late[0]], axis=1)
    tilt = np.tile(unit, 2) / unit[:, None]
    np.testing.assert_allclose(weights * tilt, gain * tilt, rtol=0.0, atol=1e-9)
    tilt = 1.0 / np.outer(unit, unit)
    np.testing.assert_allclose(found[0] * tilt, left * tilt, rtol=1e-6, atol=1e-9)


# Intervals and their rates


@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.3, 0.99, 1.01, 2.0, 3.0])
def test_the_slope_of_a_right_jacobian_times_a_vector(angle):
    rng = np.random.default_rng(100)
    x, w = sixes(rng, M, angle=angle), rng.standard_normal((M, 6))
    at = se3.right_jacobian_slope(x, w)
    slope_test(lambda d: np.einsum("mij,mj->mi", se3.right_jacobian(x + d), w), at)


def intervals(rng):
    """Both ends of intervals, the second near where the first one's strain leads."""
    start, step = rated(rng, states(rng, M)), rng.uniform(0.05, 0.3, M)
    ahead = start.pose @ se3.exp(step[:, None] * start.strain)
    end = State(ahead, start.strain, start.velocity, start.strain_rate)
    return start, end.retract(0.4 * rng.standard_normal((M, RATED))), step


def both_moved(start, end):
    return lambda step: (start.retract(step[:, :RATED]), end.retract(step[:, RATED:]))


@pytest.mark.parametrize("seed", range(3))
def test_an_intervals_error_has_its_jacobians(seed):
    start, end, step = intervals(np.random.default_rng(seed))
    move = both_moved(start, end)
    _, j0, j1 = interval_error(start, end, step)
    slope_test(lambda both: interval_error(*move(both), step)[0], np.concatenate([j0, j1], axis=-1))


@pytest.mark.parametrize("seed", range(3))
def test_the_point_inside_an_interval_has_its_jacobians(seed):
    rng = np.random.default_rng(seed)
    start, end, step = intervals(rng)
    move, offset = both_moved(start, end), step * rng.uniform(size=M)
    gain = 0.3 * rng.standard_normal((M, 12, 12))
    rest = sixes(rng, M, 4, reach=0.01).reshape(2, M, 12)
    _, j0, j1 = interval_between(start, end, step, offset, gain, rest)
    slope_test(
        lambda both: interval_between(*move(both), step, offset, gain, rest)[0],
        np.concatenate([j0, j1], axis=-1),
        difference=State.difference,
    )


def after(state, wait):
    """The state a little later, if nothing accelerates."""
    pose = state.pose @ se3.exp(wait * state.velocity)
    return replace(state, pose=pose, strain=state.strain + wait * state.strain_rate)


@pytest.mark.parametrize("seed", range(3))
def test_rates_are_derivatives_in_time(seed):
    rng = np.random.default_rng(seed)
    start, end, step = intervals(rng)
    offset, gain = step * rng.uniform(size=M), 0.3 * rng.standard_normal((M, 12, 12))
    wait = 1e-5
    ends = [(after(start, w), after(end, w)) for w in (-wait, wait)]

    error = interval_error(start, end, step)[0]
    before, behind = (interval_error(*e, step)[0][:, :12] for e in ends)
    np.testing.assert_allclose(error[:, 12:], (behind - before) / (2 * wait), atol=1e-7)

    at = interval_between(start, end, step, offset, gain, UNBENT)[0]
    before, behind = (interval_between(*e, step, offset, gain, UNBENT)[0] for e in ends)
    moved = behind.difference(before)[:, :12] / (2 * wait)
    np.testing.assert_allclose(at.velocity, moved[:, :6], atol=1e-7)
    np.testing.assert_allclose(at.strain_rate, moved[:, 6:], atol=1e-7)


@law
@given(generators)
def test_an_end_built_from_an_error_has_that_error(rng):
    start, end, step = intervals(rng)
    error = interval_error(start, end, step)[0]
    assert np.abs(interval_end(start, error, step).difference(end)).max() < 1e-12
    other = np.concatenate([sixes(rng, M, angle=2.5), rng.standard_normal((M, 18))], axis=-1)
    built = interval_end(start, other, step)
    np.testing.assert_allclose(interval_error(start, built, step)[0], other, atol=1e-11)


@law
@given(generators)
def test_a_point_inside_runs_from_one_end_to_the_other(rng):
    start, end, step = intervals(rng)
    eye = np.broadcast_to(np.eye(12), (M, 12, 12))
    first = interval_between(start, end, step, 0.0 * step, 0.0 * eye, UNBENT)[0]
    last = interval_between(start, end, step, step, eye, UNBENT)[0]
    assert np.abs(first.difference(start)).max() < 1e-12
    assert np.abs(last.difference(end)).max() < 1e-12


@law
@given(generators)
def test_errors_move_as_a_step_says_when_poses_follow_from_strains(rng):
    state = moving(rng)
    step = 0.3 * rng.standard_normal((*GRID.shape, RATED))
    bent = separable().bent(GRID, state, step)
    base, straight = bent.take(np.s_[:, 0]), state.retract(step).take(np.s_[:, 0])
    assert np.abs(base.difference(straight)).max() < 1e-12
    for n, length in enumerate(np.diff(GRID.arclength)):
        ends = [(s.take(np.s_[:, n]), s.take(np.s_[:, n + 1])) for s in (state, bent)]
        (before, j0, j1), (behind, _, _) = (interval_error(*e, np.full(3, length)) for e in ends)
        change = np.einsum("kij,kj->ki", j0, step[:, n])
        change += np.einsum("kij,kj->ki", j1, step[:, n + 1])
        np.testing.assert_allclose(behind - before, change, atol=1e-9)


# Factors


def batches(prior, state, times=slice(0, 3), about=None):
    return list(prior.factors(GRID, state, state if about is None else about, times))


PRIORS = pytest.mark.parametrize("changes", [{}, TWO], ids=["uniform", "two segments"])


@PRIORS
@pytest.mark.parametrize("seed", range(2))
def test_every_factor_has_its_jacobian_and_names_its_nodes(changes, seed):
    rng = np.random.default_rng(seed)
    state = moving(rng)
    prior = separable(base_pose=state.pose[0, 0] @ se3.exp(sixes(rng, reach=0.1)), **changes)
    found = batches(prior, state)
    assert len(found) == 4  # base and intervals, at the first time and between times
    for i, batch in enumerate(found):

        def moved(step, i=i):
            there = state.retract(step.reshape(*GRID.shape, RATED))
            return batches(prior, there)[i].terms.residual.ravel()

        slope_test(moved, oracle.spread(batch, NODES).reshape(-1, NODES * RATED))


@PRIORS
def test_a_robot_at_rest_costs_nothing(changes):
    prior = separable(base_pose=poses(np.random.default_rng(101)), **changes)
    state = prior.rest_state(GRID)
    for batch in batches(prior, state):
        np.testing.assert_allclose(batch.terms.residual, 0.0, atol=1e-13)


@PRIORS
@pytest.mark.parametrize("cuts", [[1], [2], [1, 2]], ids=str)
def test_factors_of_parts_of_the_time_are_those_of_the_whole(changes, cuts):
    rng = np.random.default_rng(102)
    state, about, prior = moving(rng), moving(rng), separable(**changes)
    edges = [0, *cuts, 3]
    parts = [
        batch
        for start, stop in pairwise(edges)
        for batch in batches(prior, state, slice(start, stop), about)
    ]
    whole = batches(prior, state, slice(0, 3), about)
    found, expected = (oracle.information(b, NODES) for b in (parts, whole))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    found, expected = (
        sorted(float(np.sum(b.terms.cost(b.terms.residual))) for b in each)
        for each in (parts, whole)
    )
    assert sum(found) == pytest.approx(sum(expected), rel=1e-12)
    assert sum(len(b.nodes) for b in parts) == sum(len(b.nodes) for b in whole)


def process_of(changes):
    if not changes:
        return PROCESS
    return {**PROCESS, "psd": changes["psd_strain_arclength"], "joints": ((JOINT, JUMP),)}


@PRIORS
def test_factors_together_are_the_process_itself_where_strain_is_constant(changes):
    prior = separable(base_pose=poses(np.random.default_rng(103)), **changes)
    state = prior.rest_state(GRID)
    found = np.linalg.inv(oracle.information(batches(prior, state), NODES))
    points = [(s, t) for t in GRID.time for s in GRID.arclength]
    expected = oracle.joint(points, **process_of(changes))
    std = np.sqrt(np.diag(expected))
    gap = np.abs((found - expected) / np.outer(std, std)).max()
    print(f"covariance of the nodes differs by {gap:.1e} of their standard deviations")
    assert gap < 1e-6


# Between the nodes

PLACES = {
    "node": ([0.0, 0.1, 0.4], [0.0, 0.1, 0.25]),
    "between arclengths": ([0.05, 0.13, 0.39], [0.0, 0.1, 0.25]),
    "between times": ([0.0, 0.1, 0.4], [0.07, 0.11, 0.2]),
    "cell": ([0.05, 0.13, 0.39], [0.07, 0.11, 0.2]),
}


@PRIORS
@pytest.mark.parametrize("place", PLACES)
def test_interpolation_has_its_jacobian_and_names_its_nodes(changes, place):
    state = moving(np.random.default_rng(104))
    prior = separable(**changes)
    (points,) = sort_points(GRID, *map(np.array, PLACES[place]))
    found = prior.interpolate(GRID, state, state, points)

    def moved(step):
        there = state.retract(step.reshape(*GRID.shape, RATED))
        return prior.interpolate(GRID, there, state, points).state

    jacobian = np.zeros((3, DOF, NODES, RATED))
    for row, nodes in enumerate(found.nodes):
        jacobian[row][:, nodes] = found.jacobian[row]

    def difference(there, here):
        return there.difference(here).ravel()

    slope_test(moved, jacobian.reshape(3 * DOF, -1), difference=difference)


@law
@given(generators)
def test_interpolation_reproduces_the_nodes_and_runs_into_them_from_every_side(rng):
    state, prior, near = moving(rng), separable(**TWO), 1e-7
    for s in (JOINT - near, JOINT, JOINT + near):
        for t in (0.1 - near, 0.1, 0.1 + near):
            (points,) = sort_points(GRID, np.array([s]), np.array([t]))
            found = prior.interpolate(GRID, state, state, points)
            gap = found.state.take(0).difference(replace(state.take((1, 2)), strain_rate=None))
            if s < JOINT:  # the node's strain is the one beyond the joint
                gap[6:12] = 0.0
                found.cov[:, 6:12] = found.cov[:, :, 6:12] = 0.0
            assert np.abs(gap).max() < 1e-3
            assert np.abs(found.cov).max() < 1e-3


def test_what_an_interval_leaves_open_rides_with_the_moving_body():
    """Its velocity errs by the rate of the pose's error and by that error's ride, δ̇ + ad(ϖ) δ."""
    state = moving(np.random.default_rng(106))
    (points,) = sort_points(GRID, np.array([0.15]), np.array([0.1]))
    found = separable().interpolate(GRID, state, state, points)
    strain = 0.5 * (state.strain[1, 1] + state.strain[1, 2])
    near, far = (dense.pair_covariance(strain, h, PSD) for h in (0.05, 0.1))
    open_ = dense.bridge_covariance(near, dense.pair_transition(strain, 0.1), far)
    pose, velocity = found.state.pose[0], found.state.velocity[0]

    def seen(error):
        """Deviation (18,) that a body shows when its pose and strain err by this, and its rates."""
        delta, strain, delta_rate = error[:6], error[6:12], error[12:18]
        wait = 1e-4
        ends = [
            pose @ se3.exp(t * velocity) @ se3.exp(delta + t * delta_rate) for t in (-wait, wait)
        ]
        seen_velocity = se3.log(se3.inverse(ends[0]) @ ends[1]) / (2 * wait)
        return np.concatenate([delta, strain, seen_velocity - velocity])

    step = 1e-4
    slope = [(seen(h) - seen(-h)) / (2 * step) for h in step * np.eye(RATED)]
    into_body = np.stack(slope, axis=1)
    expected = into_body @ np.kron(matern.stationary(SCALE), open_) @ into_body.T
    std = np.sqrt(np.diag(expected))
    gap = np.abs((found.cov[0] - expected) / np.outer(std, std)).max()
    print(f"covariance of the bridge is off by {gap:.1e}")
    assert gap < 1e-6


TINY = 1e-6  # deviations in standard deviations, so small that nothing bends
EXACT = Options(tolerance=1e-4 * TINY)
POSE_COV = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3])
GYRO_COV = np.full(3, 1e-2)
READ_S, READ_T = np.array([0.4, 0.1, 0.25, 0.4, 0.0, 0.4]), np.array([0, 0.4, 0.4, 0.8, 1.2, 1.6])


def readings_of(truth):
    """Poses and angular velocities that deviate from a still robot by `truth` (M, 24)."""
    pose = se3.exp(READ_S[:, None] * REST) @ se3.exp(truth[:, :6])
    where = {"time": READ_T, "arclength": READ_S}
    return [
        PoseReadings(**where, values=pose, cov=POSE_COV),
        GyroReadings(**where, values=truth[:, 15:18], cov=GYRO_COV),
    ]


def from_the_process(s, t, changes):
    """Some truth (M, 24) at the readings, and means (P, 18) and covariances at queries given it."""
    m, p = READ_S.size, s.size
    points = [*zip(READ_S, READ_T, strict=True), *zip(s, t, strict=True)]
    cov = oracle.joint(points, **process_of(changes))
    seen = np.linalg.cholesky(cov[: 24 * m, : 24 * m])
    truth = TINY * seen @ np.random.default_rng(105).standard_normal(24 * m)
    columns = 24 * np.arange(m)[:, None] + np.r_[0:6, 15:18]
    h = np.eye(len(cov))[columns.ravel()]
    noise = np.diag(np.tile(np.append(POSE_COV, GYRO_COV), m))
    mean, left = oracle.condition(cov, h, h[:, : 24 * m] @ truth, noise)
    mean, left = mean[24 * m :].reshape(p, 24), left[24 * m :, 24 * m :].reshape(p, 24, p, 24)
    return truth.reshape(m, 24), mean[:, :DOF], np.einsum("ijik->ijk", left)[:, :DOF, :DOF]


def estimated(nodes, times, changes, truth):
    grid, prior = Grid(nodes, times), separable(**changes)
    start = prior.rest_state(grid)
    return estimate(prior, grid, readings_of(truth), initial=start, options=EXACT)


def apart(at, s, mean, cov):
    """How far answers are from given ones, in standard deviations: means by field, covariances."""
    turn = se3.log(se3.inverse(se3.exp(s[:, None] * REST)) @ at.pose)
    found = np.concatenate([turn, at.strain - REST, at.velocity], axis=-1)
    std = np.sqrt(np.einsum("mii->mi", cov))
    means = np.abs((found - mean) / std / TINY).reshape(-1, 3, 6).max(axis=(0, 2))
    return *means, np.abs((at.cov - cov) / std[:, :, None] / std[:, None, :]).max()


@PRIORS
def test_at_time_nodes_the_posterior_is_the_process_conditioned_on_the_readings(changes):
    s, t = map(np.ravel, np.meshgrid(np.linspace(0, 0.4, 9)[[0, 1, 2, 4, 6, 7]], [0.4, 1.2]))
    truth, *expected = from_the_process(s, t, changes)
    posterior = estimated(GRID.arclength, np.linspace(0.0, 1.6, 9), changes, truth)
    gaps = apart(posterior.at(s, t), s, *expected)
    print("pose, strain, velocity and covariance are off by", *(f"{g:.1e}" for g in gaps))
    assert max(gaps) < 5e-6


@PRIORS
def test_between_time_nodes_the_posterior_errs_by_the_third_power_of_the_step(changes):
    s, share = np.array([0.05, 0.1, 0.33, 0.25, 0.4, 0.2]), np.array([0.5, 0.3, 0.5, 0.7, 0.9, 0.2])
    counts = np.array([4, 8, 16, 32])
    gaps = []
    for count in counts:
        t = (np.array([0, 3, 2, 1, 3, 0]) * count // 4 + share) * 1.6 / count
        truth, *expected = from_the_process(s, t, changes)
        posterior = estimated(GRID.arclength, np.linspace(0.0, 1.6, count + 1), changes, truth)
        gaps.append(apart(posterior.at(s, t), s, *expected))
    size = np.sqrt(3.0) * 1.6 / counts / SCALE
    for a, row in zip(size, gaps, strict=True):
        print(f"√3 h/ℓ = {a:.3f}: pose, strain, velocity, cov off by", *(f"{g:.1e}" for g in row))
    orders = [np.polyfit(np.log(size), np.log(g), 1)[0] for g in np.transpose(gaps)]
    print("orders:", np.round(orders, 2))
    assert np.max(gaps, axis=1)[1] < 4e-3
    assert np.max(gaps, axis=0)[1] < 5e-6  # strain does not turn with the body
    assert orders[0] > 3.5
    assert min(orders[2:]) > 2.7


def moving_scene(bend):
    """Readings of a bent robot that swings by `bend` times half a radian, five times in 1.6 s."""
    time = np.repeat([0.0, 0.4, 0.8, 1.2, 1.6], 2)
    place = np.tile([0.2, 0.4], 5)
    swing = np.sin(2.0 * time + 0.5)[:, None]
    strain = REST + bend * swing * np.array([0.0, 0.0, 0.0, 1.0, 0.7, -0.5])
    pose = se3.exp(place[:, None] * strain)
    spin = 1.6 * bend * np.cos(2.0 * time[1::2] + 0.5)[:, None] * np.array([0.4, 0.28, -0.2])
    return [
        PoseReadings(time=time, arclength=place, values=pose, cov=POSE_COV),
        GyroReadings(time=time[1::2], arclength=place[1::2], values=spin, cov=GYRO_COV),
    ]


def change_by_inserting(pieces, steps, *, arclength=(), time=(), bend=1.0):
    """What unmeasured nodes change anywhere, in standard deviations: means, covariances."""
    found, options = [], Options(tolerance=1e-7)
    s = np.append([0.05, 0.1, 0.17, 0.2, 0.3, 0.36, 0.4], arclength)
    s, t = map(np.ravel, np.meshgrid(s, np.append([0.37, 0.8, 1.25], time)))
    for more_s, more_t in (((), ()), (arclength, time)):
        nodes = np.sort(np.append(np.linspace(0.0, 0.4, pieces + 1), more_s))
        times = np.sort(np.append(np.linspace(0.0, 1.6, steps + 1), more_t))
        grid = Grid(nodes, times)
        found.append(estimate(separable(), grid, moving_scene(bend), options=options).at(s, t))
    one, other = found
    std = np.sqrt(np.einsum("mii->mi", other.cov))
    states = (State(e.pose, e.strain, e.velocity) for e in found)
    mean = next(states).difference(next(states)) / std
    cov = (one.cov - other.cov) / std[:, :, None] / std[:, None, :]
    return np.abs(mean).max(), np.abs(cov).max()


def orders_of(name, sizes, changes):
    """Orders at which means and covariances change with `sizes`, printed with the changes."""
    means, covs = np.transpose(changes)
    orders = [np.polyfit(np.log(sizes), np.log(v), 1)[0] for v in (means, covs)]
    print(f"{name}: order {orders[0]:.2f} of the mean, {orders[1]:.2f} of the covariance")
    print(
        "  ".join(f"{a:.3g}: {m:.1e} {c:.1e}" for a, m, c in zip(sizes, means, covs, strict=True))
    )
    return orders


def test_an_unmeasured_arclength_changes_nothing_where_strain_is_constant():
    mean, cov = change_by_inserting(4, 8, arclength=[0.137, 0.32], bend=1e-6)
    print(f"mean changes by {mean:.1e}, covariance by {cov:.1e}")
    assert mean < 1e-11  # the robot strays by 1e-6 rad
    assert cov < 5e-5


def test_what_an_unmeasured_arclength_changes_falls_with_the_bend():
    bends = np.array([0.25, 0.5, 1.0, 2.0])
    changes = [change_by_inserting(4, 8, arclength=[0.137, 0.32], bend=b) for b in bends]
    orders = orders_of("bend", bends, changes)
    assert orders[0] > 1.9
    assert orders[1] > 0.95


def test_what_an_unmeasured_arclength_changes_falls_as_the_grid_is_refined():
    counts = np.array([2, 4, 8, 16])
    changes = [change_by_inserting(n, 8, arclength=[0.137]) for n in counts]
    orders = orders_of("arclength step", 0.4 / counts, changes)
    assert min(orders) > 1.4


def test_what_an_unmeasured_time_changes_is_of_third_order_where_little_moves():
    counts = np.array([4, 8, 16, 32])
    inside = 0.8 + 0.43 * 1.6 / counts
    changes = [
        change_by_inserting(4, n, time=[t], bend=1e-6) for n, t in zip(counts, inside, strict=True)
    ]
    orders = orders_of("√3 h/ℓ", np.sqrt(3.0) * 1.6 / counts / SCALE, changes)
    assert min(orders) > 2.7


def test_what_an_unmeasured_time_changes_falls_as_the_grid_is_refined():
    """What a cell leaves open is weighed along the shape of its earlier time: first order."""
    counts = np.array([4, 8, 16, 32])
    inside = 0.8 + 0.43 * 1.6 / counts
    changes = [change_by_inserting(4, n, time=[t]) for n, t in zip(counts, inside, strict=True)]
    orders = orders_of("√3 h/ℓ", np.sqrt(3.0) * 1.6 / counts / SCALE, changes)
    assert orders[0] > 1.5
    assert orders[1] > 0.95
    assert max(changes[-1]) < 4e-3


# A static robot watched: what the grid and the duration change

LENGTH, WATCHED = 0.5, np.array([0.125, 0.25, 0.35, 0.5])
SHAPE = np.array([0.0, 0.0, 1.0, 1.6, -0.8, 0.4])
STATIC_PSD = np.array([1e-3, 1e-3, 1e-3, 10.0, 10.0, 2.0])
STATIC_BASE = BaseVariance(
    np.array([1e-6] * 3 + [1e-4] * 3), np.array([1e-4] * 3 + [4.0, 4.0, 0.5])
)
COIL_COV = np.array([1e-6] * 3 + [1e-4] * 2)


def watched(kind, *, nodes=5, rate=40.0, span=(0.0, 1.0), readings=41, read=(0.0, 1.0)):
    """Standard deviations (4, 18) in the middle of a recording of a still robot's tip coil."""
    if kind == "separable":
        prior = SeparablePrior(STATIC_PSD, 2.0, STATIC_BASE)
    else:  # as wide as the other one for a still shape watched for one second
        prior = KinematicPrior(
            psd_velocity_time=np.array([0.05] * 3 + [2.5] * 3),
            psd_strain_arclength=STATIC_PSD,
            psd_strain_time=0.1 * STATIC_PSD,
            psd_velocity_arclength=np.array([1e-2] * 3 + [1.0] * 3),
            base=BaseDensity(STATIC_BASE.pose, STATIC_BASE.strain, np.full(6, 1e-2)),
        )
    time = np.linspace(*read, readings)
    coil = CoilReadings(
        time=time,
        arclength=np.full(readings, LENGTH),
        values=np.tile(se3.exp(LENGTH * SHAPE), (readings, 1, 1)),
        cov=COIL_COV,
    )
    times = np.linspace(*span, round((span[1] - span[0]) * rate) + 1)
    grid = Grid(np.linspace(0.0, LENGTH, nodes), times)
    at = estimate(prior, grid, [coil] if readings else []).at(WATCHED, 0.5 * sum(span))
    return np.sqrt(np.einsum("mii->mi", at.cov))


DOUBLED = {
    "arclength nodes": {"nodes": 9},
    "time nodes": {"rate": 80.0},
    "duration, as many readings a second": {"span": (0, 2), "readings": 81, "read": (0, 2)},
    "duration, the same readings": {"span": (-0.5, 1.5)},
    "duration, as many readings in all": {"span": (0, 2), "read": (0, 2)},
}


@pytest.mark.parametrize("what", DOUBLED)
def test_a_still_robot_is_known_as_well_however_much_is_doubled(what):
    change = {}
    for kind in ("separable", "kinematic"):
        before, behind = watched(kind), watched(kind, **DOUBLED[what])
        change[kind] = np.abs(behind / before - 1.0)
        places = np.linalg.norm(behind[:, :3], axis=1) / np.linalg.norm(before[:, :3], axis=1) - 1
        print(f"{what} doubled, {kind}: std of position changes by", np.round(places, 5))
        fields = change[kind].reshape(4, 3, 6).max(axis=(0, 2))
        print("    at most, of pose, strain, velocity:", np.round(fields, 5))
    if what.endswith("in all"):  # half as many near the middle: the tip itself is known less well
        change = {kind: c[:3, :12] for kind, c in change.items()}
        assert change["separable"].max() < 0.01
    else:
        assert change["separable"].max() < 0.005
    if what != "time nodes":
        assert change["kinematic"].max() > 5.0 * change["separable"].max()


def test_a_robot_nobody_reads_is_known_as_well_however_long():
    change = {}
    for kind in ("separable", "kinematic"):
        std = [watched(kind, rate=10.0, span=(0, last), readings=0) for last in (1, 2, 4)]
        change[kind] = [np.abs(s / std[0] - 1.0).max() for s in std[1:]]
        print(f"{kind}: std changes by", *(f"{c:.1e}" for c in change[kind]), "when 2, 4 times")
    assert max(change["separable"]) < 1e-5
    assert min(change["kinematic"]) > 0.1


def test_time_nodes_so_dense_that_digits_would_be_lost_are_refused():
    """What an information matrix says of differences between neighbours falls as (h/ℓ)³."""
    prior = SeparablePrior(STATIC_PSD, 10.0, STATIC_BASE, rest_strain=SHAPE)
    time = np.linspace(0.0, 1.0, 11)
    process = {
        "psd": STATIC_PSD,
        "base_pose_var": STATIC_BASE.pose,
        "base_strain_var": STATIC_BASE.strain,
        "time_scale": prior.time_scale,
        "rest_strain": SHAPE,
    }
    cov = oracle.joint([*((LENGTH, t) for t in time), (0.25, 0.5)], **process)
    h = np.eye(len(cov))[(24 * np.arange(11)[:, None] + np.arange(5)).ravel()]
    cov = oracle.condition(cov, h, np.zeros(len(h)), np.diag(np.tile(COIL_COV, 11)))[1]
    expected = np.sqrt(np.diag(cov)[-24:-6])
    coil = CoilReadings(
        time=time,
        arclength=np.full(11, LENGTH),
        values=np.tile(se3.exp(LENGTH * SHAPE), (11, 1, 1)),
        cov=COIL_COV,
    )
    for rate in (10, 20):
        grid = Grid(np.linspace(0.0, LENGTH, 9), np.linspace(0.0, 1.0, rate + 1))
        at = estimate(prior, grid, [coil]).at(0.25, 0.5)
        gap = np.abs(np.sqrt(np.diag(at.cov)) / expected - 1.0).max()
        print(f"{rate} nodes a second: std off by {gap:.1e}")
        assert gap < 1e-3
    grid = Grid([0.0, LENGTH], np.linspace(0.0, 1.0, 41))
    with pytest.raises(OutsideGridError, match=r"0.025 s apart are too dense .* leave 0.05 s"):
        estimate(prior, grid, [coil])
