"""What counts of what readings tell of delays, online."""

import numpy as np
import pytest

from glissando import BaseVariance, FixedLagSmoother, Grid, PoseReadings, SeparablePrior
from glissando.estimation.delay_dating import DelayCounting
from glissando.geometry import se3
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter
from online import fed

STD = np.array([0.02, 0.05])
PROCESS = EstimatedParameters(
    Grid([0.0, 1.0], [0.0]),
    [
        SensorParameter(f"d{i}", "time_offset", (f"s{i}",), [0.0], [std])
        for i, std in enumerate(STD)
    ],
)
COLUMNS = np.array([4, 6])  # of the delays, among the numbers of a node
LENGTH = 0.4


def known(rng):
    """Information (8, 8) on all numbers of a node, the delays' included, and right-hand side."""
    slopes = rng.standard_normal((12, 8)) * np.where(np.isin(np.arange(8), COLUMNS), 30.0, 1.0)
    info = slopes.T @ slopes + np.diag(rng.uniform(0.5, 2.0, 8))
    info[COLUMNS, COLUMNS] += STD**-2.0
    return info, rng.standard_normal(8) * np.sqrt(np.diagonal(info))


def counted(rng, shares, start):
    """What is known of a node before and after counting."""
    info, rhs = known(rng)
    counting = DelayCounting(PROCESS)
    more, more_rhs = counting.leave(0.0, (np.tril(info), rhs), COLUMNS, start, shares)
    after, after_rhs = info.copy(), rhs.copy()
    after[np.ix_(COLUMNS, COLUMNS)] += more
    after_rhs[COLUMNS] += more_rhs
    return info, rhs, after, after_rhs


@pytest.mark.parametrize("seed", range(5))
def test_all_counts_of_slopes_without_noise_and_nothing_of_noise(seed):
    rng, start = np.random.default_rng(seed), np.array([0.01, -0.02])
    info, rhs, after, after_rhs = counted(rng, np.ones(2), start)
    np.testing.assert_allclose(after, info, atol=1e-9 * np.abs(info).max())
    np.testing.assert_allclose(after_rhs, rhs, atol=1e-9 * np.abs(rhs).max())
    *_, after, after_rhs = counted(rng, np.zeros(2), start)
    cov = np.linalg.inv(after)
    np.testing.assert_allclose(cov[np.ix_(COLUMNS, COLUMNS)], np.diag(STD**2), atol=1e-8)
    np.testing.assert_allclose(start + (cov @ after_rhs)[COLUMNS], 0.0, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_a_share_leaves_delays_less_sure_and_all_else_as_it_was_given_them(seed):
    rng, start = np.random.default_rng(seed), np.zeros(2)
    info, _, after, _ = counted(rng, rng.uniform(0.1, 0.95, 2), start)
    others = np.setdiff1d(np.arange(8), COLUMNS)
    np.testing.assert_array_equal(after[others], info[others])
    before, later = (np.linalg.inv(each)[np.ix_(COLUMNS, COLUMNS)] for each in (info, after))
    assert np.linalg.eigvalsh(later - before).min() > 0.0
    assert np.linalg.eigvalsh(np.diag(STD**2) - later).min() > 0.0


@pytest.mark.slow
def test_a_delay_is_not_held_at_its_stated_value_by_what_was_read_before_any_motion_told_it():
    """The tip's readings come 10 ms late, stated are 0 ± 20 ms; the robot moves from the start."""
    spread = np.repeat([1e-8, 4.0], 3)
    prior = SeparablePrior(spread, 1.0, BaseVariance(np.repeat([1e-8, 1e-6], 3), spread))
    delay = SensorParameter("late", "time_offset", ("tip",), [0.0], [0.02])
    grid, noise = Grid(np.linspace(0.0, LENGTH, 5), np.arange(0.0, 1.001, 0.025)), []
    std, off = np.repeat([5e-4, 5e-3], 3), []
    for seed in range(6):
        rng, streams = np.random.default_rng(seed), []
        for name, place, late in (("tip", LENGTH, 0.01), ("middle", LENGTH / 2, 0.0)):
            time = grid.time - late
            bend = np.stack([0 * time, 0 * time, 1 + 0 * time, 3 * np.sin(4 * time),
                             2 * np.cos(3 * time), 0 * time], axis=1)  # fmt: skip
            seen = se3.exp(place * bend) @ se3.exp(std * rng.standard_normal((time.size, 6)))
            at = {"time": grid.time, "arclength": np.full(time.size, place)}
            streams.append(PoseReadings(**at, values=seen, cov=std**2, name=name))
        smoother = FixedLagSmoother(prior, grid.arclength, window=6, sensor_parameters=[delay])
        fed(smoother, grid, streams)
        values, cov = smoother.posterior().parameter("late")
        noise.append(np.sqrt(cov[-1, 0, 0]))
        off.append((values[-1, 0] - 0.01) / noise[-1])
    assert max(noise) < 2e-3
    assert np.sqrt(np.mean(np.square(off))) < 2.0
