"""Nothing passes unseen between two moments, and moments are close only near something."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.planning.scene.motion_search import Search, judged_closely
from glissando.planning.scene.obstacles import sphere
from glissando.planning.scene.sampled_risk import sample_risk
from motion_scenes import HELD, any_problem


def past_a_speck(rng):
    """A motion and a speck that its tip passes in the middle between two corrections."""
    problem, control = any_problem(rng, robot=HELD, obstacles=[], horizon=3.0)
    problem = replace(problem, scene=replace(problem.scene, robot_radius=2e-3, model_std=2e-4))
    even = problem.space.with_moments(np.linspace(0.0, 3.0, 97))
    tip = replace(problem, space=even).evaluate(control).tip
    fast = np.linalg.norm(tip[16::16] - tip[:-16:16], axis=1).argmax()
    speck = sphere(tip[16 * fast + 8], 1e-4)
    return replace(problem, scene=replace(problem.scene, obstacles=[speck])), control, even


@pytest.mark.parametrize("seed", range(4))
def test_the_risk_is_that_of_moments_close_everywhere(seed):
    problem, control, even = past_a_speck(np.random.default_rng(seed))
    search = Search(problem, 0.05)
    search, motion = judged_closely(search, search.at(control))
    risk, std = sample_risk(search.problem, motion)
    everywhere = replace(problem, space=even)
    true = sample_risk(everywhere, everywhere.evaluate(control))[0]
    coarse = sample_risk(problem, problem.evaluate(control))[0]
    assert true > 0.3
    assert risk == pytest.approx(true, abs=0.05 + 4.0 * std)
    assert coarse < true
    assert motion.tip.shape[0] < even.moments.size


def test_far_from_everything_a_motion_is_judged_when_it_is_corrected():
    rng = np.random.default_rng(0)
    problem, control = any_problem(rng, obstacles=[sphere(np.array([5.0, 0.0, 0.0]), 0.1)])
    search = Search(problem, 0.05)
    space = judged_closely(search, search.at(control))[0].problem.space
    np.testing.assert_array_equal(space.moments, problem.space.moments)


@pytest.mark.parametrize("seed", range(3))
def test_further_moments_change_neither_the_cost_nor_what_is_known_at_corrections(seed):
    rng = np.random.default_rng(seed)
    problem, control = any_problem(rng)
    times = rng.uniform(0.0, problem.scene.horizon, 9)
    more = replace(problem, space=problem.space.with_moments(times))
    at, again = problem.evaluate(control), more.evaluate(control)
    corrected = more.space.corrected
    np.testing.assert_allclose(again.known.off[corrected], at.known.off, atol=1e-12)
    np.testing.assert_allclose(again.values[corrected], at.values, atol=1e-12)
    assert again.cost == pytest.approx(at.cost, rel=1e-9)
