"""Posteriors are the process itself given the readings; what unmeasured nodes change is small."""

import numpy as np
import pytest

from glissando import Grid, GyroReadings, PoseReadings, SolverOptions, State, estimate
from glissando.geometry import se3
from glissando.model.state import DOF
from oracles import separable as oracle
from separable_rod import GRID, PRIORS, REST, SCALE, process_of, separable

TINY = 1e-6  # deviations in standard deviations, so small that nothing bends
EXACT = SolverOptions(tolerance=1e-4 * TINY)
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


@pytest.mark.slow
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
    found, options = [], SolverOptions(tolerance=1e-7)
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


@pytest.mark.slow
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
