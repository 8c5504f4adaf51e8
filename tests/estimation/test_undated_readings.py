"""Delayed readings online where a window was read at one time: at first, and after a pause."""

import numpy as np
import pytest

from glissando import FixedLagSmoother, PoseReadings, SensorParameter, load_robot
from glissando.estimation.undated_readings import moved_within, widened
from glissando.geometry import se3
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid

NOISE = np.repeat([1e-3, 1e-2], 3) ** 2


def two_arcs(bend, half):
    """Poses in the middle and at the end of two arcs that bend (4,) about x and y."""
    twists = np.array([[0.0, 0.0, 1.0, *bend[k : k + 2], 0.0] for k in (0, 2)])
    middle, rest = se3.exp(half * twists)
    return middle, middle @ rest


@pytest.mark.parametrize("seed", range(3))
def test_a_first_pose_is_as_unsure_as_a_delay_makes_it_and_so_is_the_first_after_a_pause(seed):
    robot, rng, std = load_robot("tdcr466-segments"), np.random.default_rng(seed), 0.03
    phase, rate = rng.uniform(0.0, 2.0 * np.pi, 4), rng.uniform(2.0, 4.0)
    delay = std * (-1.0) ** seed
    late = SensorParameter("late", "time_offset", ("tip",), [0.0], [std])
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, sensor_parameters=[late])

    def poses(time):
        return two_arcs(2.0 * np.sin(rate * time + phase), 0.5 * robot.length)

    first = [0.0, 2.5]
    for now in np.r_[np.arange(0.0, 0.5, 0.05), first[1]]:
        for k, (name, when) in enumerate((("middle", now), ("tip", now - delay))):
            read = poses(when)[k] @ se3.exp(np.sqrt(NOISE) * rng.standard_normal(6))
            at = robot.length * (0.5 + 0.5 * k)
            smoother.add(
                PoseReadings(time=[now], arclength=[at], values=[read], cov=NOISE, name=name)
            )
        state = smoother.advance(now)
        if now in first:
            cov = state.cov[:, :6, :6]
            tip = se3.log(se3.inverse(state.pose[-1]) @ poses(now)[1])
            assert tip @ np.linalg.solve(cov[-1], tip) < 6 * 2.5
            assert np.sqrt(np.trace(cov[-1, :3, :3])) < 0.1  # it says something all the same
            n = int(np.abs(robot.arclength_nodes - 0.5 * robot.length).argmin())
            assert np.sqrt(np.trace(cov[n, :3, :3])) < 0.01  # what is not late is as sure as it was


def test_what_a_robot_moves_by_is_its_speed_times_the_time_and_no_more_than_its_reach():
    robot = load_robot("tdcr466-segments")
    nodes = robot.arclength_nodes
    rest = robot.prior.rest_state(Grid(nodes, [0.0]))
    short, double, long = (
        np.sqrt(np.diagonal(moved_within(robot.prior, nodes, rest, lag))[-rest.dof :][:2])
        for lag in (1e-3, 2e-3, 100.0)
    )
    np.testing.assert_allclose(double, 2.0 * short, rtol=1e-6)
    assert np.all(long < 500.0 * short)


def test_widened_readings_have_the_covariance_of_noise_and_move_together():
    rng = np.random.default_rng(0)
    m, r, c, d, n = 3, 2, 2, 4, 3
    jacobian, nodes = rng.standard_normal((m, r, c, d)), np.array([[0, 1], [1, 2], [4, 5]])
    noise, root = rng.standard_normal((m, r, r)), rng.standard_normal((n * d, n * d))
    noise, moves = noise @ np.swapaxes(noise, 1, 2) + np.eye(r), root @ root.T
    white = np.linalg.inv(np.linalg.cholesky(noise))
    factors = Factors(nodes, slice(0, d), jacobian, Residuals(np.zeros((m, r)), white))
    out = widened(factors, moves.reshape(n, d, n, d)).terms.sqrt_info
    for k in range(m):
        wide = np.zeros((r, n, d))
        wide[:, nodes[k] % n] = jacobian[k]
        wide = wide.reshape(r, -1)
        cov = noise[k] + wide @ moves @ wide.T
        np.testing.assert_allclose(np.linalg.inv(out[k].T @ out[k]), cov, rtol=1e-9)
