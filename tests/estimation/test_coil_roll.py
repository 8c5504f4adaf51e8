"""The roll that no coil sees: what is claimed of it is what the cost of another roll says."""

import numpy as np
import pytest

from glissando import CoilReadings, FixedLagSmoother, Grid, PoseReadings, estimate, load_robot
from glissando.geometry import se3
from glissando.io.netcdf import load_posterior, save_posterior

COV = np.array([5e-7] * 3 + [2e-5] * 2)
LOOSE, SURE = 1e4, 1e-8
"""Variances of a reading that says nothing of a number, and of one that holds it."""


def bent_tip(robot):
    """Pose (4, 4) of the tip of an arc."""
    bend = 0.8 / robot.length
    return se3.exp(robot.length * np.array([0.0, 0.0, 1.0, 0.6 * bend, 0.8 * bend, 0.0]))


def coil(robot, rng, time):
    noise = np.zeros((time.size, 6))
    noise[:, :5] = np.sqrt(COV) * rng.standard_normal((time.size, 5))
    seen = bent_tip(robot) @ se3.exp(noise)
    return CoilReadings(
        time=time, arclength=np.full(time.size, robot.length), values=seen, cov=COV, name="coil"
    )


def roll_of(pose, other):
    """The angle about its z by which another pose is turned from one."""
    apart = se3.inverse(pose) @ other
    return float(np.arctan2(apart[1, 0] - apart[0, 1], apart[0, 0] + apart[1, 1]))


@pytest.mark.parametrize("name", ["sliding700", "tdcr466", "tdcr466-segments"])
def test_the_cost_rises_by_a_half_one_standard_deviation_of_roll_away(name):
    robot, time = load_robot(name), np.linspace(0.0, 0.1, 4)
    seen = coil(robot, np.random.default_rng(5), time)
    grid = Grid(robot.arclength_nodes, time)
    free = estimate(robot.prior, grid, [seen], gate=None)
    at = free.at(robot.length, time[-1])
    std = float(np.sqrt(at.cov[5, 5]))
    away = 0.3 * std
    held = at.pose @ se3.exp(np.array([0, 0, 0, 0, 0, away]))
    holds = PoseReadings(
        time=time[-1:], arclength=[robot.length], values=held[None], cov=[LOOSE] * 5 + [SURE]
    )
    turned = estimate(robot.prior, grid, [seen, holds], gate=None, initial=free.state)
    assert roll_of(at.pose, turned.at(robot.length, time[-1]).pose) == pytest.approx(away, rel=0.1)
    rise = turned.solve.cost - free.solve.cost
    assert rise == pytest.approx(0.5 * 0.3**2, rel=0.05)


@pytest.mark.parametrize("name", ["sliding700", "tdcr466", "tdcr466-segments"])
def test_online_it_is_known_as_a_recording_has_it(name):
    robot, time = load_robot(name), np.arange(30) / 30.0
    seen = coil(robot, np.random.default_rng(6), time)
    whole = estimate(robot.prior, Grid(robot.arclength_nodes, time), [seen], gate=None)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    for each in time:
        smoother.add(seen.select(seen.time == each))
        newest = smoother.advance(float(each))
    at, std = whole.at(robot.length, time[-1]), np.sqrt(newest.cov[-1, 5, 5])
    assert std == pytest.approx(np.sqrt(at.cov[5, 5]), rel=0.05)
    assert abs(roll_of(newest.pose[-1], at.pose)) < 0.1 * std


def test_a_window_that_rolled_states_its_covariances_in_the_axes_of_its_mean(tmp_path):
    """They are those of draws, those of the newest state, and those that a file gives back."""
    robot, time = load_robot("tdcr466"), np.arange(10) / 30.0
    around = 1.2 / robot.length * np.array([np.cos(8.0 * time), np.sin(8.0 * time)]).T
    arcs = np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (time.size, 1))
    arcs[:, 3:5] = around
    seen = CoilReadings(
        time=time, arclength=np.full(time.size, robot.length), cov=COV, name="coil",
        values=se3.exp(robot.length * arcs),
    )  # fmt: skip
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=9)
    for each in time:
        smoother.add(seen.select(seen.time == each))
        smoother.advance(float(each))
    posterior, at = smoother.posterior(), (robot.length, time[-1])
    assert np.abs(posterior.state.rolls_from(posterior.linearization_point)).max() > 0.5
    save_posterior(posterior, tmp_path / "posterior.nc")
    again = load_posterior(tmp_path / "posterior.nc")
    np.testing.assert_allclose(again.marginals.cov, posterior.marginals.cov, rtol=1e-5, atol=1e-8)
    newest = smoother.newest().cov[-1]
    np.testing.assert_allclose(newest, posterior.at(*at).cov, rtol=1e-6, atol=1e-9)
    drawn = posterior.sample(np.random.default_rng(9), 4000)
    steps = drawn.difference(posterior.state).reshape(4000, len(posterior.grid.time), -1)
    std = np.sqrt(np.einsum("kii->ki", posterior.marginals.cov))
    np.testing.assert_allclose(steps.std(axis=0), std, rtol=0.1)
