"""The estimate of a rod that moves under loads lies at the mean, whatever the steps in time.

The truth is a rod without weight under a wrench that follows its tip, integrated from the tip to
the base, which needs neither iteration nor the package's mechanics.
"""

from unittest import mock

import numpy as np
import pytest

from glissando import CoilReadings, Grid, estimate
from glissando.estimation import batch_problem
from glissando.estimation.laplace_shift import at_mean
from glissando.geometry import se3
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.solver.block_tridiagonal import factor
from glissando.solver.located_readings import locate

LENGTH, SCALE = 0.5, 1.0
STIFFNESS = np.array([2e4, 2e4, 7e4, 6.1e-3, 6.1e-3, 4.6e-3])  # buckles at 60 mN
STD_TIP = np.repeat([0.02, 6e-4], 3)
NODES, PIECES = np.linspace(0.0, LENGTH, 7), 240
NOISE = np.repeat([0.7e-3, 7e-3], [3, 2])


def prior(**changes):
    """The prior of that rod."""
    fields = {
        "psd_load": np.repeat([1e-8, 1e-12], 3),
        "psd_strain_error": np.repeat([1e-10, 1e-6], 3),
        "var_tip": STD_TIP**2,
        "time_scale": SCALE,
        "var_base": np.full(6, 1e-10),
    }
    mechanics = Mechanics(STIFFNESS[None], np.array([1e-6]), gravity=np.zeros(3))
    return MechanicalPrior(mechanics, **(fields | changes))


def tip_loads(rng, time):
    """Matérn wrenches (K, 6) at the tip, body frame, with the prior's variance and time scale."""
    gap = np.sqrt(3.0) * np.abs(time[:, None] - time) / SCALE
    cov = (1.0 + gap) * np.exp(-gap) + 1e-10 * np.eye(time.size)
    return STD_TIP * (np.linalg.cholesky(cov) @ rng.standard_normal((time.size, 6)))


def tip_pose(load):
    """Pose (K, 4, 4) of the tip from the base under wrenches (K, 6), by the midpoint rule."""
    step, wrench = LENGTH / PIECES, load.copy()
    back = np.broadcast_to(np.eye(4), (len(load), 4, 4))

    def slope(w):
        strain = np.array([0, 0, 1.0, 0, 0, 0]) + w / STIFFNESS
        v, u = strain[:, :3], strain[:, 3:]
        moment = np.cross(u, w[:, 3:]) + np.cross(v, w[:, :3])
        return strain, np.hstack([np.cross(u, w[:, :3]), moment])  # towards the base

    for _ in range(PIECES):
        _, change = slope(wrench)
        strain, change = slope(wrench + 0.5 * step * change)
        wrench = wrench + step * change
        back = back @ se3.exp(-step * strain)
    return se3.inverse(back)


def reading(rng, time, load, noise=NOISE):
    """Readings of a coil at the tip of the rod under wrenches (K, 6)."""
    off = np.zeros((time.size, 6))
    off[:, :5] = noise * rng.standard_normal((time.size, 5))
    values, places = tip_pose(load) @ se3.exp(off), np.full(time.size, LENGTH)
    return CoilReadings(time=time, arclength=places, values=values, cov=noise**2)


def found(coil, time, *, mean):
    """Posterior about the mean, or about the mode."""
    with mock.patch.object(batch_problem, "at_mean", at_mean if mean else lambda p, _: p):
        return estimate(prior(), Grid(NODES, time), [coil])


def errors(rng, step, count, *, still, mean=True):
    """Errors and standard deviations (count · K,) of the force along the tip."""
    time, out = np.arange(0.0, 2.5, step), []
    for _ in range(count):
        load = tip_loads(rng, time)
        load = np.repeat(load[:1], time.size, axis=0) if still else load
        tip = found(reading(rng, time, load), time, mean=mean).load(LENGTH, time)
        out.append([tip.wrench[:, 2] - load[:, 2], tip.std[:, 2]])
    return np.concatenate(out, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(("step", "still"), [(0.05, False), (0.05, True)])
def test_the_force_along_a_rod_is_as_true_as_stated(step, still):
    error, std = errors(np.random.default_rng(3), step, 5, still=still)
    assert np.mean((error / std) ** 2) < 2.0
    assert abs(error.mean()) < 0.5 * std.mean()


def of_strain_along(marginals):
    """Variances (K, N) of the strain along the rod."""
    return np.einsum("kii->ki", marginals.cov).reshape(-1, NODES.size, 24)[..., 8]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_shifted_posterior_is_consistent(seed):
    """Its mean follows from its own linearisation, and its covariance is that of its system."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 1.0, 0.05)
    coil = reading(rng, time, tip_loads(rng, time))
    mode, shifted = (found(coil, time, mean=mean) for mean in (False, True))
    along = shifted.state.strain[..., 2] - mode.state.strain[..., 2]
    variance = of_strain_along(shifted.marginals)
    assert np.max(np.abs(along) / np.sqrt(variance)) > 0.2
    assert np.allclose(of_strain_along(factor(shifted.system).marginals()), variance, rtol=1e-6)
    assert shifted.solve.log_fit == mode.solve.log_fit
    off = shifted.state.pose[:, -1, :3, 3] - mode.state.pose[:, -1, :3, 3]
    assert np.all(np.abs(off) < 0.5 * mode.std_pose()[:, -1, :3].max())


@pytest.mark.slow
def test_without_knowledge_from_readings_nothing_moves():
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 1.0, 0.1)
    coil = reading(rng, time, tip_loads(rng, time), noise=1e3 * NOISE)
    mode = found(coil, time, mean=False)
    assert at_mean(mode, locate(mode.grid, [coil])) is mode


def test_without_readings_the_estimate_is_that_of_the_prior():
    time = np.arange(0.0, 0.5, 0.1)
    unread = estimate(prior(), Grid(NODES, time), [])
    assert np.all(np.isfinite(unread.load(LENGTH, time).std))
    np.testing.assert_allclose(unread.load(LENGTH, time).wrench, 0.0, atol=1e-9)
