"""Intervals of a moving rod: errors, points inside and their rates, with their Jacobians."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from draws import generators, law, sixes, states
from glissando import State
from glissando.geometry import se3
from glissando.model.priors.intervals import RATED, interval_between, interval_end, interval_error
from separable_rod import GRID, moving, rated, separable
from slope import slope_test

M = 12
UNBENT = np.zeros((2, M, 12))


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
    moved = behind.rise_from(before)[:, :12] / (2 * wait)
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
    bent = separable().retract_strains(GRID, state, step)
    base, straight = bent.take(np.s_[:, 0]), state.retract(step).take(np.s_[:, 0])
    assert np.abs(base.difference(straight)).max() < 1e-12
    for n, length in enumerate(np.diff(GRID.arclength)):
        ends = [(s.take(np.s_[:, n]), s.take(np.s_[:, n + 1])) for s in (state, bent)]
        (before, j0, j1), (behind, _, _) = (interval_error(*e, np.full(3, length)) for e in ends)
        change = np.einsum("kij,kj->ki", j0, step[:, n])
        change += np.einsum("kij,kj->ki", j1, step[:, n + 1])
        np.testing.assert_allclose(behind - before, change, atol=1e-9)
