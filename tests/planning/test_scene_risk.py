"""The risk of a motion: its bound, samples, and shapes solved anew agree."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from draws import generators, law
from glissando.planning.scene.risk import both_below, bound_hits
from glissando.planning.scene.sampled_risk import sample_risk
from motion_scenes import LOOSE, ROBOT, UNSURE, any_problem
from oracles.model_errors import dense_covariance, sampled_errors, sampled_hits


@pytest.fixture
def rng():
    """A generator of its own for each test."""
    return np.random.default_rng(0)


@law
@given(rng=generators, rho=st.floats(-0.999, 0.999))
def test_two_numbers_are_below_with_the_probability_of_the_bivariate_normal(rng, rho):
    x, y = 1.5 * rng.standard_normal(2)
    found = both_below(np.array([x]), np.array([y]), np.array([rho]))[0]
    true = multivariate_normal.cdf([x, y], cov=[[1.0, rho], [rho, 1.0]])
    assert found == pytest.approx(true, abs=2e-8)


@settings(law, max_examples=6)
@given(rng=generators)
def test_what_is_known_is_what_dense_algebra_says(rng):
    robot = (ROBOT, LOOSE, UNSURE)[rng.integers(3)]
    problem, control = any_problem(rng, int(rng.integers(1, 4)), robot, horizon=2.0)
    known = problem.evaluate(control).known
    true = dense_covariance(problem, known.corrections.rows)
    np.testing.assert_allclose(known.corrections.before, true, atol=1e-8)


@pytest.mark.parametrize("robot", [ROBOT, LOOSE, UNSURE])
def test_between_corrections_what_is_left_is_as_large_as_in_samples(rng, robot):
    problem, control = any_problem(rng, 3, robot, horizon=2.0)
    known, count = problem.evaluate(control).known, 20_000
    errors = np.array(list(sampled_errors(problem, known, count, rng)))
    for stated, others in ((known.off, errors), (known.lagged, errors[1:])):
        pairs = zip(errors, others, strict=False)
        found = np.array([a.T @ b / count for a, b in pairs])
        found = 0.5 * (found + found.mT)
        np.testing.assert_allclose(found, stated, atol=6.0 * np.abs(stated).max() / count**0.5)


def as_risky(problem, control, risk):
    """The problem with a robot so thick, 3 mm or more, that the bound of the risk is about this."""
    problem, _, c = problem.cut(problem.evaluate(control), 2e-3)
    low, high = 0.003, 0.2
    for _ in range(40):
        middle = 0.5 * (low + high)
        mean = c.mean + problem.scene.robot_radius - middle
        bound = bound_hits(replace(c, mean=mean)).value
        low, high = (middle, high) if bound < risk else (low, middle)
    return replace(problem, scene=replace(problem.scene, robot_radius=low))


@pytest.mark.slow
@pytest.mark.parametrize("risk", [0.01, 0.1])
def test_the_bound_is_above_the_risk_and_at_most_three_times_of_it(risk, rng):
    ratios = []
    for _ in range(6):
        problem, control = any_problem(rng)
        thick = as_risky(problem, control, risk)
        evaluation = thick.evaluate(control)
        share, std = sample_risk(thick, evaluation, 10_000, seed=1)
        assert share < evaluation.hits.value + 4.0 * std
        if thick.scene.robot_radius > 0.0031:
            ratios.append(evaluation.hits.value / share)
    assert len(ratios) > 2
    assert max(ratios) < 3.0, ratios
    assert np.median(ratios) < 1.5, ratios


@pytest.mark.slow
def test_shapes_solved_anew_hit_as_often_as_the_samples_say(rng):
    pairs = []
    for robot in (ROBOT, LOOSE):
        problem, control = any_problem(rng, 2, robot, horizon=2.0)
        thick = as_risky(problem, control, 0.08)
        evaluation = thick.evaluate(control)
        share = sample_risk(thick, evaluation, 10_000, seed=1)[0]
        pairs.append((sampled_hits(thick, evaluation, 1000, rng), share))
    for true, share in pairs:
        assert share / 2.0 < true < 1.5 * share, pairs
