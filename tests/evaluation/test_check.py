"""Consistency as a product: honest confidence is called true as often as it should, others not."""

import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from scipy.signal import lfilter
from scipy.stats import chi2

from command_line import run
from glissando import PoseReadings, StateEstimate, se3
from glissando.cli.check import _table
from glissando.cli.console import site_table
from glissando.cli.main import main
from glissando.evaluation.consistency import LEVELS, Consistency, check
from glissando.evaluation.effective_samples import effective_errors, effective_samples
from glissando.evaluation.metrics import Errors, errors_against, joined, pool


def series(rng, count, rho, scale=1.0):
    """Squared normalised errors (M,) of three degrees of freedom, correlated by rho a step."""
    steps = rng.standard_normal((count, 3))
    for k in range(1, count):
        steps[k] = rho * steps[k - 1] + np.sqrt(1.0 - rho**2) * steps[k]
    return scale * np.sum(steps**2, axis=1)


def judged(nees):
    return Consistency("site", 0.1, "position", nees, 3, effective_samples(nees))


@pytest.mark.parametrize("rho", [0.0, 0.8, 0.97])
def test_effective_samples_are_those_of_the_correlation(rho):
    """A square of a Gaussian series with correlation ρ^k has correlation ρ^2k."""
    rng = np.random.default_rng(0)
    found = np.median([effective_samples(series(rng, 4000, rho)) for _ in range(20)])
    expected = 4000 * (1.0 - rho**2) / (1.0 + rho**2)
    assert found == pytest.approx(expected, rel=0.15)


def lasting(rng, share, count=400):
    """White errors (M, 3) of which a share of the variance is the same at all times."""
    return np.sqrt(share) * rng.standard_normal(3) + np.sqrt(1.0 - share) * rng.standard_normal(
        (count, 3)
    )


@pytest.mark.parametrize(("share", "most"), [(0.0, 0.1), (0.25, 0.35), (0.9, 0.25)])
def test_errors_that_last_are_worth_few_samples(share, most):
    """Their squares vary little about their own mean, which is another in each recording."""
    rng, none, wrong = np.random.default_rng(0), np.full(400, np.nan), 0
    found = []
    for _ in range(100):
        white = lasting(rng, share)
        errors = Errors("site", np.zeros(400), none, none, np.sum(white**2, axis=1), none, none,
                        white_position=white)  # fmt: skip
        (judged,) = check([errors])
        found.append(judged.effective)
        wrong += judged.verdict != "true"
    assert wrong <= 100 * most
    assert np.median(found) < (1.5 / share**2 if share else 401.0)
    assert share or np.median(found) > 300.0


def test_an_estimate_whose_covariance_is_none_is_judged_by_what_is_left():
    class Somebodys:
        def at(self, arclength, _):
            still, poses = np.zeros((arclength.size, 6)), np.tile(np.eye(4), (arclength.size, 1, 1))
            cov = np.tile(np.diag([1.0, 1.0, 1.0, -1e-3, *np.ones(14)]), (arclength.size, 1, 1))
            return StateEstimate(poses, still, still, cov)

    poses = np.tile(se3.exp(np.full(6, 0.01)), (10, 1, 1))
    truth = PoseReadings(time=np.arange(10.0), arclength=np.zeros(10), values=poses, cov=1e-6)
    errors = errors_against(Somebodys(), truth)
    assert errors.white_position.shape == (10, 3)
    assert errors.white_rotation.shape == (0, 3)
    assert {c.quantity for c in check([errors])} == {"position", "rotation"}


@pytest.mark.parametrize("rho", [0.0, 0.8, 0.97])
def test_squares_of_errors_are_worth_what_their_correlation_says(rho):
    rng, found = np.random.default_rng(0), []
    for _ in range(20):
        steps = rng.standard_normal((4000, 3))
        for k in range(1, 4000):
            steps[k] = rho * steps[k - 1] + np.sqrt(1.0 - rho**2) * steps[k]
        found.append(effective_errors(steps))
    assert np.median(found) == pytest.approx(4000 * (1.0 - rho**2) / (1.0 + rho**2), rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("last", [100.0, 300.0])
def test_errors_of_which_one_axis_lasts_are_not_called_false(last):
    """Where an average over axes was squared, 19 and 31 % of such verdicts were false."""
    rng, count, none = np.random.default_rng(0), 1000, np.full(1000, np.nan)
    rho, wrong = np.exp(-1.0 / last), 0
    for _ in range(200):
        white = rng.standard_normal((count, 3))
        noise = np.sqrt(1.0 - rho**2) * white[1:, 0]
        white[1:, 0] = lfilter([1.0], [1.0, -rho], noise, zi=[rho * white[0, 0]])[0]
        errors = Errors("site", np.zeros(count), none, none, np.sum(white**2, axis=1), none, none,
                        white_position=white)  # fmt: skip
        (judged,) = check([errors])
        wrong += judged.verdict != "true"
    assert wrong <= 0.12 * 200


def test_errors_that_are_joined_keep_how_wide_a_tube_would_hold_them():
    none = np.full(3, np.nan)
    errors = Errors("a", *np.zeros((4, 3)), none, np.arange(3.0))
    whole = joined([errors, replace(errors, name="b")])
    np.testing.assert_array_equal(whole.sigmas, [0.0, 1.0, 2.0, 0.0, 1.0, 2.0])


def test_a_constant_series_is_worth_one_sample():
    assert effective_samples(np.full(100, 2.0)) == 1.0
    assert effective_samples(np.zeros(3)) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_honest_confidence_is_called_true_and_errors_of_confidence_are_found(rho):
    rng = np.random.default_rng(1)
    verdicts = {
        scale: [judged(series(rng, 1500, rho, scale)).verdict for _ in range(100)]
        for scale in (1.0, 1.7, 1.0 / 1.7)
    }
    assert verdicts[1.0].count("true") >= 85
    assert verdicts[1.7].count("overconfident") >= 95
    assert verdicts[1.0 / 1.7].count("underconfident") >= 95


def test_coverage_bounds_hold_honest_coverage():
    rng = np.random.default_rng(2)
    inside = dict.fromkeys(LEVELS, 0)
    for _ in range(200):
        found = judged(series(rng, 600, 0.6))
        for level in LEVELS:
            low, high = found.coverage_bounds(level)
            inside[level] += low <= found.coverage(level) <= high
    assert min(inside.values()) >= 180


def test_sites_are_judged_alone_and_together_and_what_is_missing_is_left_out():
    nan = np.full(50, np.nan)
    nees = series(np.random.default_rng(3), 50, 0.0)
    seen = Errors("pose", np.full(50, 0.1), nees, nees, nees, nees, nees)
    point = Errors("point", np.full(50, 0.2), nees, nan, nees, nan, nan)
    found = [(c.site, c.quantity) for c in check([seen, point])]
    assert found == [
        ("pose", "position"), ("point", "position"), ("all", "position"), ("pose", "rotation")
    ]  # fmt: skip


@pytest.mark.parametrize("others", [2, 3])
def test_rotations_of_coils_are_inside_together_as_often_as_alone(others):
    """A coil shows no roll: two degrees of freedom, alone and beside truth that shows it."""
    rng, none = np.random.default_rng(0), np.full(20_000, np.nan)
    sites = [
        Errors(f"s{dof}{k}", np.zeros(none.size), none, none, none, rng.chisquare(dof, none.size),
               none, dof, np.arange(none.size))
        for k, dof in enumerate((2, others))
    ]  # fmt: skip
    together = check(sites)[-1]
    assert together.site == "all"
    assert together.dof == others
    assert together.mean == pytest.approx(1.0, abs=0.03)
    pooled = pool(sites)
    for level in LEVELS:
        assert together.coverage(level) == pytest.approx(level, abs=0.01)
        inside = pooled.nees_rotation <= chi2.ppf(level, pooled.dof_rotation)
        assert np.mean(inside) == pytest.approx(level, abs=0.01)


def test_a_long_name_folds_on_a_narrow_terminal_and_no_number(capsys):
    name = "aurora_sensor_number_one"
    nees = series(np.random.default_rng(4), 50, 0.0)
    usual = Consistency("mocap_700", 0.123, "position", 3.0 * nees, 3, 50)
    Console(width=80).print(_table("position", [usual]))
    assert "overconfident" in capsys.readouterr().out
    Console(width=76).print(_table("position", [Consistency(name, 0.123, "position", nees, 3, 50)]))
    table = site_table("title", ("s (m)", "samples", "position (mm)", "rotation (deg)", "NEES"))
    table.add_row(name, "0.4660", "1234", "12.345", "123.45", "1.03")
    Console(width=60).print(table)
    printed = capsys.readouterr().out
    for whole in ("0.123", f"{np.mean(nees) / 3:.2f}", "0.4660", "1234", "12.345", "123.45"):
        assert f" {whole} " in printed


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("check") / "C"
    options = ["--shape", "C", "--slide", "oscillate", "--cycles", "1"]
    assert main(["simulate", *options, "--out", str(folder)]) == 0
    return folder


@pytest.mark.slow
def test_a_recording_and_its_saved_posterior_are_judged_alike(recording, tmp_path, capsys):
    assert run("estimate", recording, "--out", tmp_path / "estimate") == 0
    capsys.readouterr()
    assert run("check", recording, "--json") == 0
    fresh = json.loads(capsys.readouterr().out)["checks"]
    saved = tmp_path / "estimate" / "posterior.nc"
    assert run("check", saved, "--recording", recording, "--json") == 0
    again = json.loads(capsys.readouterr().out)["checks"]
    assert len(fresh) == len(again) == 15
    for one, other in zip(fresh, again, strict=True):
        assert one["nees"] == pytest.approx(other["nees"], rel=1e-6)
        assert set(one["coverage"]) == {"0.5", "0.9", "0.95", "0.99"}


def test_the_check_is_printed_and_drawn(recording, tmp_path, capsys):
    assert run("check", recording, "--out", tmp_path) == 0
    printed = capsys.readouterr().out
    for word in ("position", "rotation", "innovation", "mocap_700", "all", "95 %"):
        assert word in printed
    assert (tmp_path / "calibration.png").stat().st_size > 10_000
    assert json.loads((tmp_path / "check.json").read_text())["name"] == "C"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nowhere"], "no recording folder or posterior"),
        (["posterior.nc"], "give the folder that does with --recording"),
        (["."], "give the folder that does with --recording"),
    ],
)
def test_a_mistake_is_one_sentence(tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "posterior.nc").write_text("")
    assert run("check", *arguments) == 2
    assert sentence in capsys.readouterr().err


def test_a_recording_without_truth_cannot_be_checked(recording, capsys):
    assert run("check", recording, "--truth", "", "--use", "coil") == 2
    assert "has no truth" in capsys.readouterr().err
