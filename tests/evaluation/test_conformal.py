"""Guarantees without a model: what they promise holds for errors of any law."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta

from draws import generators, law
from glissando.errors import GlissandoError, RobotFileError
from glissando.estimation.state_estimate import StateEstimate
from glissando.evaluation.conformal import (
    AdaptiveSet,
    block_scores,
    conformal_tube,
    inside_tube,
)
from glissando.evaluation.metrics import Errors, errors_against
from glissando.io.robot_file import load_robot, with_tube
from glissando.io.shipped_robots import robot_file
from glissando.model.sensors.sensors import PositionReadings
from glissando.model.tube import Tube


def errors_of(name, time, sigmas):
    blank = np.zeros(time.size)
    return Errors(name, blank, blank, blank, blank, blank, sigmas, 3, time)


class _Straight:
    """An estimate of a straight robot, as unsure in every direction of position."""

    def __init__(self, std):
        self._std = std

    def at(self, arclength, time):
        cov = np.zeros((time.size, 18, 18))
        cov[:, range(3), range(3)] = self._std**2
        still = np.zeros((time.size, 6))
        return StateEstimate(np.tile(np.eye(4), (time.size, 1, 1)), still, still, cov)


@pytest.mark.parametrize("noise", [0.0, 1.0, 3.0])  # of truth, in deviations of the estimate
def test_noise_of_truth_widens_a_tube_that_holds_the_body_itself(noise):
    rng, std, blocks = np.random.default_rng(8), 1e-3, 60
    time, inside = 0.1 * np.arange(10 * blocks), []
    for _ in range(40):
        scores = []
        for _ in range(2):
            off = 3.0 * std * rng.standard_normal((time.size, 3))
            seen = off + noise * std * rng.standard_normal(off.shape)
            truth = PositionReadings(
                time=time,
                arclength=np.full(time.size, 0.1),
                values=seen,
                cov=(noise * std) ** 2 + 1e-14,
                name="truth",
            )
            errors = errors_against(_Straight(std), truth)
            scores.append(block_scores([errors], 1.0))
        tube = conformal_tube(scores[0], 1.0, 0.9)
        of_body = np.linalg.norm(off, axis=1).reshape(blocks, 10).max(axis=1) / std
        inside.append(inside_tube(tube, of_body))
    assert np.mean(inside) > 0.9 - 4.0 * np.std(inside) / np.sqrt(len(inside))


@pytest.mark.parametrize("shape", [0.3, 1.0, 8.0])  # of tails, from light to very heavy
@pytest.mark.parametrize(("blocks", "level"), [(19, 0.95), (50, 0.9), (250, 0.95)])
def test_a_further_block_lies_inside_as_often_as_promised_whatever_the_law(shape, blocks, level):
    rng = np.random.default_rng(blocks)
    inside = []
    for _ in range(200):
        scores = np.exp(shape * rng.standard_normal(blocks + 200))
        tube = conformal_tube(scores[:blocks], 0.0, level)
        inside.append(inside_tube(tube, scores[blocks:]))
    rank = np.ceil(round((blocks + 1) * level, 9))
    expected = beta(rank, blocks + 1 - rank)  # of the coverage given the calibration
    assert expected.mean() >= level - 1e-12
    slack = 4.0 * np.sqrt((expected.var() + 0.25 / 200) / 200)
    assert np.mean(inside) == pytest.approx(expected.mean(), abs=slack)


def test_blocks_too_few_for_the_level_are_refused_with_how_many_it_takes():
    with pytest.raises(GlissandoError, match="needs 19 blocks or more, and there are 18"):
        conformal_tube(np.ones(18), 2.0, 0.95)
    assert conformal_tube(np.arange(19.0), 2.0, 0.95).sigmas == 18.0
    for level in (0.0, 1.0, np.nan):
        with pytest.raises(GlissandoError, match="not a probability"):
            conformal_tube(np.ones(18), 2.0, level)
    with pytest.raises(GlissandoError, match="0 s or more"):
        block_scores([], -1.0)


@law
@given(generators, st.sampled_from([0.0, 0.3, 2.0]))
def test_a_block_scores_its_worst_sample_of_all_sites(rng, seconds):
    errors = []
    for site in "ab":
        time = np.sort(np.round(rng.uniform(5.0, 12.0, 30), 1))
        sigmas = rng.chisquare(3, time.size)
        sigmas[rng.random(time.size) < 0.1] = np.nan
        errors.append(errors_of(site, time, sigmas))
    pairs = [
        (t, n) for e in errors for t, n in zip(e.time, e.sigmas, strict=True) if not np.isnan(n)
    ]
    first = min(t for t, _ in pairs)
    worst = {}
    for t, n in pairs:
        block = np.floor((t - first) / seconds) if seconds else t
        worst[block] = max(worst.get(block, 0.0), n)
    if seconds:  # a block that ends before its time is none
        every = np.unique([t for t, _ in pairs])
        end = every[-1] + np.median(np.diff(every))
        worst = {
            b: n for b, n in worst.items() if first + (b + 1) * seconds <= end + 1e-6 * seconds
        }
    expected = [worst[block] for block in sorted(worst)]
    assert np.allclose(block_scores(errors, seconds), expected)


def test_a_recording_holds_as_many_blocks_as_fill_it():
    errors = [errors_of("a", np.arange(0.0, 5.475, 0.025), np.ones(219))]
    assert [block_scores(errors, s).size for s in (1.0, 2.0, 5.475, 6.0, 100.0)] == [5, 2, 1, 0, 0]
    exact = [errors_of("a", np.arange(0.0, 6.0, 0.025), np.ones(240))]
    assert block_scores(exact, 2.0).size == 3


@law
@given(generators, st.floats(0.6, 0.99), st.floats(0.005, 0.3))
def test_the_miss_rate_keeps_its_bound_at_every_moment_for_any_data(rng, level, rate):
    """Data that drift, jump, and answer the last threshold with a miss whenever they can."""
    sets, size = AdaptiveSet(level, rate), 1.0
    spite = rng.uniform()
    for _ in range(300):
        size *= np.exp(0.2 * rng.standard_normal())
        score = size * rng.standard_normal() ** 2
        if rng.random() < spite:
            score = sets.threshold * 1.01 if np.isfinite(sets.threshold) else np.nan
        wild = [score, np.inf, -np.inf, np.nan]
        sets.update(rng.choice(wild, p=[0.85, 0.05, 0.05, 0.05]))
        assert abs(sets.miss_rate - (1.0 - level)) <= sets.bound + 1e-12


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_a_set_that_holds_nothing_misses_even_the_lowest_score(level):
    sets = AdaptiveSet(level)
    for _ in range(400):
        sets.update(-np.inf if sets.threshold == -np.inf else 1.0)
    assert abs(sets.miss_rate - (1.0 - level)) <= sets.bound + 1e-12


def test_a_set_that_does_not_adapt_breaks_the_same_bound():
    """The bound is no triviality: scores that grow leave every fixed set."""
    scores = np.linspace(1.0, 50.0, 3000)
    fixed = np.quantile(scores[:300], 0.95)
    sets = AdaptiveSet()
    for score in scores:
        sets.update(score)
    missed = np.mean(scores > fixed)
    assert abs(missed - 0.05) > sets.bound
    assert abs(sets.miss_rate - 0.05) <= sets.bound


def test_on_steady_scores_sets_are_finite_and_miss_as_often_as_they_should():
    rng, sets = np.random.default_rng(0), AdaptiveSet(0.9)
    finite = []
    for score in rng.chisquare(3, 4000):
        sets.update(score)
        finite.append(np.isfinite(sets.threshold))
    assert sets.miss_rate == pytest.approx(0.1, abs=0.01)
    assert np.mean(finite[500:]) > 0.95


def test_a_robot_file_keeps_its_text_and_carries_the_latest_tube(tmp_path):
    text = robot_file("tdcr466").read_text(encoding="utf-8")
    first, second = Tube(0.9, 3.25, 40, 2.0), Tube(0.95, 4.5, 250, 0.0)
    once = with_tube(text, first)
    assert once.startswith(text.rstrip())
    file = tmp_path / "mine.toml"
    for written, tube in ((once, first), (with_tube(once, second), second)):
        file.write_text(written, encoding="utf-8")
        assert load_robot(file).tube == tube
    middle = with_tube(text, first).replace("[prior]", "[tube]\nlevel = 0.5\n\n[prior]", 1)
    file.write_text(with_tube(middle.rsplit("[tube]", 1)[0], second), encoding="utf-8")
    assert load_robot(file).tube == second
    noted = with_tube(text, first).replace("[tube]", "[tube]\n# of a session in May")
    again = with_tube(f"{noted}\n# of the data sheet\n[more]\n", second)
    assert "# of a session in May\n" in again
    assert "# of the data sheet\n[more]\n" in again
    file.write_text(once.replace("level = 0.9", "level = 1.5"), encoding="utf-8")
    with pytest.raises(RobotFileError, match="level"):
        load_robot(file)
    assert load_robot("tdcr466").tube is None
