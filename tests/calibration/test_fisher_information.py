"""What samples of truth tell of parameters: slopes of their likelihood, and information."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from glissando.calibration.robot import fisher_information
from glissando.calibration.robot.predictive import Score

COUNT = 3  # parameters
NUDGE = 1e-4


def world(seed):
    """How residuals and covariances of two streams depend on parameters, and a sample of both."""
    rng = np.random.default_rng(seed)
    streams = []
    for moments, rows in ((6, 3), (4, 6)):
        root = rng.standard_normal((moments, rows, rows)) + 3.0 * np.eye(rows)
        spread = 0.3 * rng.standard_normal((COUNT, rows, rows))
        moves = rng.standard_normal((COUNT, moments, rows))
        streams.append((root, spread, moves))

    def predicted(x, white):
        out = []
        for (root, spread, moves), w in zip(streams, white, strict=True):
            at = root @ (np.eye(root.shape[1]) + np.einsum("p,pij->ij", x, spread))
            drawn = np.einsum("mij,mj->mi", root, w)
            out.append((drawn + np.einsum("p,pmi->mi", x, moves), at @ at.swapaxes(1, 2)))
        return tuple(out)

    def draw(generator):
        return [generator.standard_normal(root.shape[:2]) for root, _, _ in streams]

    return predicted, draw


def score(predicted):
    total = 0.0
    for residual, cov in predicted:
        square = np.einsum("mi,mij,mj", residual, np.linalg.inv(cov), residual)
        log_det = np.sum(np.linalg.slogdet(2.0 * np.pi * cov)[1])
        total -= 0.5 * (square + log_det)
    count = sum(residual.size for residual, _ in predicted)
    return Score(total / count, count, float(count), (), predicted)


def about(predicted, white, x, nudge=NUDGE):
    centre = score(predicted(x, white))
    beside = [score(predicted(x + step, white)) for step in nudge * np.eye(COUNT)]
    return centre, beside


@pytest.mark.parametrize("seed", range(4))
def test_slopes_are_those_of_the_likelihood(seed):
    predicted, draw = world(seed)
    white, x = draw(np.random.default_rng(seed)), np.linspace(-0.1, 0.1, COUNT)
    slope, _ = fisher_information.slopes(*about(predicted, white, x), NUDGE)
    ends = [
        [score(predicted(x + s, white)).value for s in d * np.eye(COUNT)] for d in (1e-5, -1e-5)
    ]
    np.testing.assert_allclose(slope, -np.subtract(*ends) / 2e-5, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_the_information_is_the_mean_product_of_slopes(seed):
    predicted, draw = world(seed)
    rng, zero = np.random.default_rng(seed), np.zeros(COUNT)
    centre, beside = about(predicted, draw(rng), zero)
    _, information = fisher_information.slopes(centre, beside, NUDGE)
    slopes = np.array(
        [
            fisher_information.slopes(*about(predicted, draw(rng), zero), NUDGE)[0]
            for _ in range(600)
        ]
    )
    seen = centre.samples * slopes.T @ slopes / len(slopes)
    scale = np.sqrt(np.diag(information))
    np.testing.assert_allclose(
        seen / np.outer(scale, scale), information / np.outer(scale, scale), atol=0.2
    )


def lasting(rng, moments, rows, memory):
    """Standard normal numbers (M, r) that forget by as much from one moment to the next."""
    out = rng.standard_normal((moments, rows))
    for before, now in pairwise(out):
        now[:] = memory * before + np.sqrt(1.0 - memory**2) * now
    return out


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_slopes_scatter_by_as_much_as_errors_last(memory):
    """Were they independent they would scatter by their information."""
    rng, moments, rows = np.random.default_rng(3), 60, 2
    moves, spread = rng.standard_normal((2, moments, rows)), 0.5 * np.eye(rows)
    slopes, stated, information = [], [], []
    for _ in range(300):
        white = lasting(rng, moments, rows, memory)
        cov = np.broadcast_to(np.eye(rows), (moments, rows, rows))
        beside = [(white + NUDGE * each, cov) for each in moves]
        beside.append((white, cov + NUDGE * spread))
        taken = np.arange(float(moments))
        every = [replace(score([each]), moments=(taken,)) for each in [(white, cov), *beside]]
        slope, info = fisher_information.slopes(every[0], every[1:], NUDGE)
        slopes.append(slope)
        information.append(info)
        stated.append(fisher_information.slope_covariance(every[0], every[1:], NUDGE))
    seen = moments * rows * np.mean([np.outer(s, s) for s in slopes], axis=0)
    wide, one = np.diag(np.mean(stated, axis=0)), np.diag(np.mean(information, axis=0))
    np.testing.assert_allclose(wide / np.diag(seen), 1.0, atol=0.35)
    assert (wide[2] > 2.0 * one[2]) == (memory > 0.0)


def test_a_parameter_without_an_estimate_has_no_slope_and_no_information():
    predicted, draw = world(7)
    centre, beside = about(predicted, draw(np.random.default_rng(0)), np.zeros(COUNT))
    every, of_every = fisher_information.slopes(centre, beside, NUDGE)
    slope, information = fisher_information.slopes(centre, [beside[0], None, beside[2]], NUDGE)
    others = [0, 2]
    np.testing.assert_array_equal(slope, every * [1.0, 0.0, 1.0])
    np.testing.assert_array_equal(
        information[np.ix_(others, others)], of_every[np.ix_(others, others)]
    )
    assert not information[1].any()
    assert not information[:, 1].any()
    none, nothing = fisher_information.slopes(centre, 3 * [None], NUDGE)
    assert not none.any()
    assert not nothing.any()
