import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import generators, law, sixes
from glissando.geometry import se3
from glissando.model.priors.transitions import process_covariances, symmetrize
from oracles import dense
from oracles.transitions import full_bridge as bridge
from oracles.transitions import transition

PSD = np.array([1e-3, 1.2e-3, 2e-3, 3.0, 4.0, 2.0])
CARRIED = np.array([3.0, 2.0, 1.0, 5.0, 6.0, 7.0])

rigidity = st.booleans()
turns = st.floats(0.0, 1.0)  # radians in one step
steps = st.floats(1e-3, 0.5)


def rate_turning(rng, turn, step):
    """A rate (1, 6) that turns the body by `turn` radians over `step`, and the step (1,)."""
    return sixes(rng, 1, reach=1.0, angle=turn / step), np.array([step])


def relative(found, expected):
    """Largest error with every row and column in units of its own standard deviation."""
    std = np.sqrt(np.diagonal(expected))
    return np.abs((found - expected) / np.outer(std, std)).max()


@law
@given(generators, st.floats(0.0, 3.0), steps)
def test_the_transition_is_the_matrix_exponential(rng, turn, step):
    rate, h = rate_turning(rng, turn, step)
    expected = dense.pair_transition(rate[0], step)
    np.testing.assert_allclose(transition(rate, h)[0], expected, rtol=0.0, atol=1e-12)


@law
@given(generators, turns, steps, rigidity)
def test_process_covariances_are_van_loans(rng, turn, step, rigid):
    rate, h = rate_turning(rng, turn, step)
    pair, carried = process_covariances(rate, h, PSD, CARRIED, rigid=rigid)
    assert relative(pair[0], dense.pair_covariance(rate[0], step, PSD)) < 1e-9
    expected = dense.carried_covariance(rate[0], step, CARRIED, rigid=rigid)
    assert relative(carried[0], expected) < 1e-9


@pytest.mark.parametrize(("turn", "tolerance"), [(0.3, 1e-13), (1.0, 1e-10), (2.0, 1e-6)])
def test_quadrature_loses_accuracy_slowly_as_a_step_turns_further(turn, tolerance):
    rng = np.random.default_rng(20)
    worst = 0.0
    for _ in range(20):
        rate, h = rate_turning(rng, turn, 0.1)
        pair, carried = process_covariances(rate, h, PSD, CARRIED, rigid=True)
        worst = max(worst, relative(pair[0], dense.pair_covariance(rate[0], 0.1, PSD)))
        expected = dense.carried_covariance(rate[0], 0.1, CARRIED, rigid=True)
        worst = max(worst, relative(carried[0], expected))
    print(f"turn {turn} rad: {worst:.1e}")
    assert worst < tolerance


@law
@given(generators, st.floats(0.0, 6.0), steps)
def test_process_covariances_are_positive_definite_however_fast_the_body_turns(rng, turn, step):
    rate, h = rate_turning(rng, turn, step)
    for cov in process_covariances(rate, h, PSD, CARRIED, rigid=True):
        std = np.sqrt(np.diagonal(cov[0]))
        assert relative(cov[0].T, cov[0]) < 1e-14
        assert np.linalg.eigvalsh(cov[0] / np.outer(std, std))[0] > 0.0


def test_without_motion_noise_is_the_textbooks_integrated_white_noise():
    h = 0.3
    pair, carried = process_covariances(np.zeros(6), np.array(h), PSD, CARRIED, rigid=True)
    textbook = np.kron([[h**3 / 3, h**2 / 2], [h**2 / 2, h]], np.diag(PSD))
    np.testing.assert_allclose(pair, textbook, rtol=1e-13, atol=0.0)
    np.testing.assert_allclose(carried, h * np.diag(CARRIED), rtol=1e-13, atol=1e-18)


@law
@given(generators, st.floats(0.0, 0.5), st.floats(0.05, 0.3), st.floats(0.05, 0.3), rigidity)
def test_two_steps_are_one_long_step(rng, turn, a, b, rigid):
    """Chapman-Kolmogorov: Q(a + b) = Φ(b) Q(a) Φ(b)ᵀ + Q(b), and Φ(a + b) = Φ(b) Φ(a)."""
    rate = sixes(rng, 1, angle=turn / 0.3)
    a, b = np.array([a]), np.array([b])
    onward = transition(rate, b)
    np.testing.assert_allclose(onward @ transition(rate, a), transition(rate, a + b), atol=1e-13)
    ride = se3.adjoint(se3.exp(-b[:, None] * rate)) if rigid else np.eye(6)[None]
    first, second, both = (
        process_covariances(rate, h, PSD, CARRIED, rigid=rigid) for h in (a, b, a + b)
    )
    for phi, near, far, whole in zip((onward, ride), first, second, both, strict=True):
        assert relative((phi @ near @ np.swapaxes(phi, -1, -2) + far)[0], whole[0]) < 1e-9


@law
@given(generators, turns, steps, st.floats(0.05, 0.95), rigidity)
def test_a_bridge_is_what_both_ends_leave_unknown(rng, turn, step, part, rigid):
    rate, h = rate_turning(rng, turn, step)
    u = part * step
    found = bridge(rate, h, np.array([u]), PSD, CARRIED, rigid=rigid)
    near, far = (dense.pair_covariance(rate[0], length, PSD) for length in (u, step - u))
    onward = dense.pair_transition(rate[0], step - u)
    assert relative(found.cov[0], dense.bridge_covariance(near, onward, far)) < 1e-6
    near, far = (
        dense.carried_covariance(rate[0], length, CARRIED, rigid=rigid) for length in (u, step - u)
    )
    ride = dense.adjoint_exp(-(step - u) * rate[0]) if rigid else np.eye(6)
    assert relative(found.carried_cov[0], dense.bridge_covariance(near, ride, far)) < 1e-9


@law
@given(generators, turns, steps, st.floats(0.05, 0.95), rigidity)
def test_gains_are_the_regression_of_the_point_on_the_far_end(rng, turn, step, part, rigid):
    rate, h = rate_turning(rng, turn, step)
    u = part * step
    found = bridge(rate, h, np.array([u]), PSD, CARRIED, rigid=rigid)
    near = dense.pair_covariance(rate[0], u, PSD)
    cross = near @ dense.pair_transition(rate[0], step - u).T
    explained = found.gain[0] @ dense.pair_covariance(rate[0], step, PSD)
    std = np.sqrt(np.diagonal(near))
    onward_std = np.sqrt(np.diagonal(dense.pair_covariance(rate[0], step, PSD)))
    assert np.abs((explained - cross) / np.outer(std, onward_std)).max() < 1e-9


@law
@given(generators, turns, steps, rigidity)
def test_a_bridge_leaves_nothing_unknown_at_its_ends(rng, turn, step, rigid):
    rate, h = rate_turning(rng, turn, step)
    start = bridge(rate, h, np.zeros(1), PSD, CARRIED, rigid=rigid)
    np.testing.assert_array_equal(start.gain, 0.0)
    np.testing.assert_array_equal(start.cov, 0.0)
    np.testing.assert_array_equal(start.carried_gain, 0.0)
    np.testing.assert_array_equal(start.carried_cov, 0.0)
    end = bridge(rate, h, h, PSD, CARRIED, rigid=rigid)
    whole, carried = process_covariances(rate, h, PSD, CARRIED, rigid=rigid)
    scale = np.sqrt(np.diagonal(whole[0]))
    off = (end.gain[0] - np.eye(12)) * scale / scale[:, None]
    assert np.abs(off).max() < 1e-9
    np.testing.assert_allclose(end.carried_gain[0], np.eye(6), atol=1e-12)
    assert np.abs(end.cov[0] / np.outer(scale, scale)).max() < 1e-9
    assert np.abs(end.carried_cov / np.abs(carried).max()).max() < 1e-12


@law
@given(generators, st.floats(1e-3, 1e3))
def test_gains_do_not_depend_on_the_scale_of_the_noise_and_covariances_follow_it(rng, scale):
    rate, h = rate_turning(rng, 0.7, 0.2)
    one = bridge(rate, h, 0.4 * h, PSD, CARRIED, rigid=True)
    other = bridge(rate, h, 0.4 * h, scale * PSD, scale * CARRIED, rigid=True)
    np.testing.assert_allclose(other.gain, one.gain, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(other.carried_gain, one.carried_gain, rtol=1e-9, atol=1e-12)
    assert relative(other.cov[0], scale * one.cov[0]) < 1e-9
    assert relative(other.carried_cov[0], scale * one.carried_cov[0]) < 1e-9


def test_densities_may_differ_from_interval_to_interval():
    rng = np.random.default_rng(21)
    rate, h = sixes(rng, 5, angle=2.0), rng.uniform(0.05, 0.3, 5)
    psd, carried = rng.uniform(0.1, 2.0, (2, 5, 6))
    together = bridge(rate, h, 0.3 * h, psd, carried, rigid=True)
    for i in range(5):
        alone = bridge(rate[i], h[i], 0.3 * h[i], psd[i], carried[i], rigid=True)
        np.testing.assert_allclose(together.gain[i], alone.gain, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(together.cov[i], alone.cov, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(together.carried_cov[i], alone.carried_cov, atol=1e-12)


def test_symmetrize_keeps_the_even_half():
    np.testing.assert_array_equal(symmetrize(np.array([[1.0, 4.0], [2.0, 3.0]])), [[1, 3], [3, 3]])
