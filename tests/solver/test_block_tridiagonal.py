import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from draws import generators, law
from glissando._kernels.threads import one_thread
from glissando.errors import UnobservableError
from glissando.solver.block_tridiagonal import BlockTridiagonal, factor

counts, sizes = st.integers(1, 6), st.one_of(st.integers(1, 9), st.integers(23, 60))


def random_system(rng, count, size):
    """A random positive definite block-tridiagonal matrix: a band squared, plus a little."""
    n = count * size
    block = np.arange(n) // size
    lower_band = (block[:, None] - block >= 0) & (block[:, None] - block <= 1)
    root = rng.standard_normal((n, n)) * lower_band
    full = root @ root.T + 0.1 * np.eye(n)
    return blocks_of(full, count, size), full


def blocks_of(full, count, size):
    slabs = full.reshape(count, size, count, size).swapaxes(1, 2)
    diagonal = slabs[range(count), range(count)]
    lower = slabs[range(1, count), range(count - 1)]
    return BlockTridiagonal(diagonal, lower.reshape(count - 1, size, size))


@law
@given(generators, counts, sizes)
def test_solve_is_the_dense_solve(rng, count, size):
    system, full = random_system(rng, count, size)
    right = rng.standard_normal((count, size))
    expected = np.linalg.solve(full, right.ravel()).reshape(count, size)
    found = factor(system).solve(right)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


@law
@given(generators, counts, sizes)
def test_a_factor_resumes_where_the_matrix_changed(rng, count, size):
    system, _ = random_system(rng, count, size)
    start = int(rng.integers(count))
    before = factor(system)
    system.diagonal[start:] += np.eye(size)
    resumed = factor(system, before, start=start)
    expected = factor(system)
    np.testing.assert_array_equal(resumed.inverse, expected.inverse)
    np.testing.assert_array_equal(resumed.coupling, expected.coupling)


@law
@given(generators, counts, sizes)
def test_log_det_is_the_dense_log_det(rng, count, size):
    system, full = random_system(rng, count, size)
    assert factor(system).log_det == pytest.approx(np.linalg.slogdet(full)[1], abs=1e-8)


@law
@given(generators, counts, sizes)
def test_marginals_are_blocks_of_the_dense_inverse(rng, count, size):
    system, full = random_system(rng, count, size)
    marginals = factor(system).marginals()
    inverse = np.linalg.inv(full).reshape(count, size, count, size).swapaxes(1, 2)
    tolerance = 1e-8 * np.abs(inverse).max()
    for k in range(count):
        np.testing.assert_allclose(marginals.cov[k], inverse[k, k], atol=tolerance)
        np.testing.assert_array_equal(marginals.cov[k], marginals.cov[k].T)
    for k in range(count - 1):
        np.testing.assert_allclose(marginals.cross[k], inverse[k, k + 1], atol=tolerance)


def sparse_system(rng, count, size):
    """One whose couplings hold numbers in a few rectangles, as those of neighbouring nodes do."""
    lower = np.zeros((count - 1, size, size))
    for block in lower:
        for _ in range(rng.integers(4)):
            rows, columns = (np.sort(rng.integers(size + 1, size=2)) for _ in range(2))
            block[slice(*rows), slice(*columns)] = rng.standard_normal()
    root = rng.standard_normal((count, size, size))
    room = 2.0 * np.abs(lower).sum(axis=(1, 2)).max(initial=0.0) + 1.0
    diagonal = root @ root.swapaxes(1, 2) + room * np.eye(size)
    full = np.zeros((count, size, count, size))
    full[range(count), :, range(count)] = diagonal
    full[range(1, count), :, range(count - 1)] = lower
    full[range(count - 1), :, range(1, count)] = lower.swapaxes(1, 2)
    return BlockTridiagonal(diagonal, lower), full.reshape(count * size, -1)


@law
@given(generators, st.integers(2, 4), st.integers(1, 120))
def test_couplings_of_few_numbers_are_solved_as_dense_ones(rng, count, size):
    system, full = sparse_system(rng, count, size)
    right, inverse = rng.standard_normal((count, size)), np.linalg.inv(full)
    solved = factor(system)
    expected = (inverse @ right.ravel()).reshape(count, size)
    np.testing.assert_allclose(solved.solve(right), expected, atol=1e-9 * np.abs(expected).max())
    marginals = solved.marginals(consume=True)
    blocks = inverse.reshape(count, size, count, size).swapaxes(1, 2)
    tolerance = 1e-9 * np.abs(inverse).max()
    for k in range(count):
        np.testing.assert_allclose(marginals.cov[k], blocks[k, k], atol=tolerance)
    for k in range(count - 1):
        np.testing.assert_allclose(marginals.cross[k], blocks[k, k + 1], atol=tolerance)


@law
@given(generators, counts, sizes)
def test_the_covariance_of_what_depends_on_parts_is_that_of_the_dense_inverse(rng, count, size):
    system, full = random_system(rng, count, size)
    first_slab, part = rng.integers(count), int(rng.integers(1, size + 1))
    slab = np.minimum(first_slab + rng.integers(2, size=(5, 3)), count - 1)
    first = rng.integers(size - part + 1, size=(5, 3))
    slopes, left = rng.standard_normal((5, 2, 3, part)), rng.standard_normal((5, 2, 2))
    left = left @ left.swapaxes(1, 2)
    found = factor(system).marginals().spread(slab, first, slopes, left)
    inverse, flat = np.linalg.inv(full), slopes.reshape(5, 2, -1)
    at = ((slab * size + first)[:, :, None] + np.arange(part)).reshape(5, -1)
    expected = flat @ inverse[at[:, :, None], at[:, None, :]] @ flat.swapaxes(1, 2) + left
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


@law
@given(generators, counts, sizes)
def test_a_sample_is_the_transposed_factor_solved_for_white_noise(rng, count, size):
    system, full = random_system(rng, count, size)
    seed = int(rng.integers(2**32))
    white = np.random.default_rng(seed).standard_normal(count * size)
    expected = np.linalg.solve(np.linalg.cholesky(full).T, white)
    found = factor(system).sample(np.random.default_rng(seed)).ravel()
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_samples_have_the_covariance_they_are_drawn_from():
    rng = np.random.default_rng(30)
    system, full = random_system(rng, 3, 2)
    chol = factor(system)
    draws = np.stack([chol.sample(rng).ravel() for _ in range(20_000)])
    white = draws @ np.linalg.cholesky(full)  # of unit covariance if the draws are right
    np.testing.assert_allclose(white.T @ white / len(draws), np.eye(6), atol=0.05)


@law
@given(generators, counts, sizes)
def test_adding_to_the_diagonal_adds_to_the_matrix_and_leaves_the_first_alone(rng, count, size):
    system, full = random_system(rng, count, size)
    values = rng.uniform(size=(count, size))
    sum_ = system.add_to_diagonal(values)
    expected = blocks_of(full + np.diag(values.ravel()), count, size)
    np.testing.assert_array_equal(sum_.diagonal, expected.diagonal)
    np.testing.assert_array_equal(system.diagonal, blocks_of(full, count, size).diagonal)


def test_nothing_given_is_overwritten():
    system, full = random_system(np.random.default_rng(31), 4, 5)
    right = np.ones((4, 5))
    chol = factor(system)
    chol.solve(right)
    before = chol.marginals()
    chol.sample(np.random.default_rng(0))
    after = chol.marginals()
    untouched = blocks_of(full, 4, 5)
    np.testing.assert_array_equal(system.diagonal, untouched.diagonal)
    np.testing.assert_array_equal(system.lower, untouched.lower)
    np.testing.assert_array_equal(right, 1.0)
    np.testing.assert_array_equal(before.cov, after.cov)


@law
@given(generators, st.integers(0, 4), st.booleans())
def test_an_undetermined_direction_is_refused_at_its_time_node(rng, at, is_hidden):
    """A direction of a single slab, either one of its axes or an even mixture of them."""
    full = random_system(rng, 5, 4)[1] + 5.0 * np.eye(20)
    axis = rng.uniform(0.5, 1.5, 4) if is_hidden else np.eye(4)[2]
    blind = np.zeros(20)
    blind[4 * at : 4 * at + 4] = axis / np.linalg.norm(axis)
    blinder = np.eye(20) - np.outer(blind, blind)
    singular = blinder @ full @ blinder
    with pytest.raises(UnobservableError, match=f"singular at time node {at}: .* Give the robot"):
        factor(blocks_of(singular, 5, 4))


def test_a_direction_shared_by_all_slabs_is_refused_at_the_last():
    chain = np.kron(np.diag([1.0, 2, 2, 2, 1]) - np.eye(5, k=1) - np.eye(5, k=-1), np.eye(4))
    with pytest.raises(UnobservableError, match="time node 4"):
        factor(blocks_of(chain, 5, 4))


@pytest.mark.parametrize("spoiled", [-1.0, np.nan])
def test_a_matrix_that_is_no_information_at_all_is_refused(spoiled):
    system, _ = random_system(np.random.default_rng(32), 3, 4)
    system.diagonal[1, 2, 2] = spoiled
    with pytest.raises(UnobservableError, match="time node 1"):
        factor(system)


def test_a_matrix_without_a_factor_is_not_kept():
    system, _ = random_system(np.random.default_rng(33), 3, 30)
    system.diagonal[1] *= -1.0
    kept = sys.getrefcount(system.diagonal), sys.getrefcount(system.lower)
    with pytest.raises(UnobservableError):
        factor(system)
    assert (sys.getrefcount(system.diagonal), sys.getrefcount(system.lower)) == kept


def test_blas_keeps_to_one_thread_around_the_blocks():
    def threads():
        return {p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas"}

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with one_thread():
            with one_thread():
                assert threads() == {1}
            assert threads() == {1}  # the inner one does not end it
        assert threads() == before
