"""Claims, trials and the command that reproduces: judged as said, the same every time."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from draws import motion
from glissando.cli import reproduce
from glissando.cli.main import main
from glissando.experiments import scenes, studies
from glissando.experiments.claims import Claim, ClaimsError, Verdict, judge, load_claims
from glissando.experiments.confidence import nearest_minimum
from glissando.experiments.runner import outcome
from glissando.experiments.scenes import REPORTED_ON, TUNED_ON, Scene
from glissando.experiments.statistics import COLUMNS, summary
from glissando.experiments.studies import run_plan
from glissando.io.robot_file import load_robot

BODY = np.linspace(0.0, 0.7, 701)


@pytest.mark.parametrize("place", [0.2, 0.45, 0.64, 0.7])
def test_the_nearest_minimum_is_found_wherever_the_coil_is(place):
    std = np.sqrt(BODY) * (1.0 - 0.6 * np.exp(-(((BODY - place) / 0.03) ** 2)))
    assert nearest_minimum(BODY, std, place) == pytest.approx(place, abs=0.012)


def test_the_clamped_base_and_a_slope_without_a_minimum_are_none():
    assert np.isnan(nearest_minimum(BODY, BODY, 0.3))
    assert nearest_minimum(BODY, 1.0 - BODY, 0.3) == 0.7


def test_intervals_of_a_summary_hold_the_true_error_as_often_as_they_say():
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(100):
        rmse = rng.normal(2.0, 0.3, (60, 1))
        told = summary(np.hstack([rmse, np.ones((60, 4))]))["position"]
        inside += told["low"] < np.sqrt(2.0**2 + 0.3**2) < told["high"]
    assert 86 <= inside <= 100


def test_a_change_is_judged_between_trials_of_the_same_seed():
    """Seeds differ tenfold from each other; each sliding trial is 5 % better than its own."""
    fixed = np.ones((40, 5)) * np.random.default_rng(0).uniform(1, 10, (40, 1))
    told = summary(0.95 * fixed, fixed)["position_change"]
    assert told["low"] == pytest.approx(-5.0)
    assert told["high"] == pytest.approx(-5.0)


RESULTS = {"a": {"b": 3.0}}


def claim(**changes):
    entries = {"id": "x", "says": "s", "paper": "p", "ours": "{a[b]:.1f}", "measure": "a.b"}
    return Claim(**{**entries, "direction": "below", "bound": 4.0, **changes})


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "holds"),
        ({"bound": 3.0}, "FAILS"),
        ({"direction": "above"}, "FAILS"),
        ({"direction": "above", "bound": 2.0}, "holds"),
        ({"direction": "report"}, ""),
    ],
)
def test_a_claim_is_judged_by_its_direction_and_bound(changes, verdict):
    (found,) = judge([claim(**changes)], RESULTS)
    assert found.verdict == verdict
    assert found.fails == (verdict == "FAILS")
    assert found.ours == "3.0"


@pytest.mark.parametrize(
    ("paper", "size"), [(-6.0, "as large as the paper's"), (-2.0, "3.5 × the paper's")]
)
def test_the_size_of_an_effect_is_told_beside_the_papers(paper, size):
    results = {**RESULTS, "e": {"value": -7.0, "low": -9.0, "high": -5.0}}
    for direction in ("below", "report"):
        told = claim(direction=direction, effect="e", paper_effect=paper)
        assert judge([told], results)[0].size == size


@pytest.mark.parametrize("changes", [{"measure": "a.c"}, {"ours": "{a[c]}"}, {"measure": "a.b.c"}])
def test_a_claim_about_a_number_nobody_computes_is_a_mistake(changes):
    with pytest.raises(ClaimsError, match="number that was not computed"):
        judge([claim(**changes)], RESULTS)


def test_a_number_that_is_nan_holds_for_no_claim():
    for direction in ("below", "above"):
        (found,) = judge([claim(direction=direction)], {"a": {"b": float("nan")}})
        assert found.fails


def test_claims_of_the_paper_are_all_there():
    ids = {claim.id for claim in load_claims()}
    wanted = {"highest at the coil", "follows the coil"}
    wanted |= {f"{shape} {what}" for shape in "CS" for what in ("position", "orientation")}
    assert wanted <= ids


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "holds no [[claims]]"),
        ('[[claims]]\nid = "a"\nsays = "b"\nours = "c"\ndirection = "up"', "give one of below"),
        ('[[claims]]\nid = "a"\nsays = "b"\nours = "c"\ndirection = "below"', "measure"),
    ],
)
def test_a_file_of_claims_that_cannot_be_is_one_sentence(tmp_path, capsys, text, sentence):
    (tmp_path / "claims.toml").write_text(text)
    options = ["--claims", str(tmp_path / "claims.toml"), "--out", str(tmp_path / "out")]
    assert main(["reproduce", *options]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_no_shape_is_both_tuned_on_and_reported_on():
    assert not set(TUNED_ON) & set(REPORTED_ON)
    named = {np.asarray(scenes.bench().shape(name).tensions).tobytes() for name in REPORTED_ON}
    assert not {np.asarray(t, dtype=float).tobytes() for t in TUNED_ON.values()} & named


@pytest.mark.slow
def test_an_estimator_that_knows_the_pace_judges_a_motion_as_its_slow_motion():
    slow, fast = (Scene("C-to-S", "hold", seconds, paced=True) for seconds in (20.0, 5.0))
    assert scenes.prior(slow) is scenes.known_robot(slow).prior
    grids, costs = [scenes.grid(scene) for scene in (slow, fast)], []
    np.testing.assert_allclose(grids[1].time, grids[0].time / 4.0)
    state = motion(np.random.default_rng(0), grids[0])
    quick = replace(state, velocity=4.0 * state.velocity)
    for scene, grid, at in zip((slow, fast), grids, (state, quick), strict=True):
        every = scenes.prior(scene).factors(grid, at, at, slice(0, grid.time.size))
        costs.append([batch.terms.cost(batch.terms.residual) for batch in every])
    np.testing.assert_allclose(*costs, rtol=1e-9)


def test_a_scene_with_inertia_swings_past_its_static_shapes():
    still = Scene("C-to-S", "hold", 0.5, flaws=(("set_curvature", 0.0),))
    tip = [
        scenes.motion(scene, 0).at(0.7, 0.5).pose[:3, 3]
        for scene in (still, replace(still, dynamic=True))
    ]
    assert 0.02 < np.linalg.norm(tip[1] - tip[0]) < 0.5


@pytest.mark.slow
def test_the_same_seeds_give_the_same_numbers_on_all_cores_as_in_a_plain_loop():
    scene = Scene("C", "hold", 1.0)
    together = run_plan([(scene, 4), (scene, 6)])[scene]
    rows = [outcome(scene, seed) for seed in range(6)]
    # a process that has computed other things before differs in the last digits of BLAS
    np.testing.assert_allclose(
        together, [[row[name] for name in COLUMNS] for row in rows], rtol=1e-9
    )
    assert np.unique(together[:, 0]).size == 6


@pytest.mark.slow
def test_the_quick_run_computes_judges_and_draws_every_claim(tmp_path, capsys, monkeypatch):
    fewer = {"table": 6, "beyond": 6, "moving": 2, "causes": 1, "passes": 0}
    monkeypatch.setattr(studies, "QUICK_SEEDS", fewer)
    assert main(["reproduce", "--quick", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "FAILS" not in printed
    record = json.loads((tmp_path / "results.json").read_text())
    assert [entry["id"] for entry in record["claims"]] == [
        c.id for c in load_claims() if not c.full
    ]
    page = (tmp_path / "reproduction.md").read_text()
    assert "Why the paper gains less" in page
    assert "published prior" not in page  # of which only a full run tells
    assert {"numpy", "scipy", "python", "glissando"} <= set(record["versions"])
    assert record["seeds"] == {"first": 0, **fewer}
    arm = record["results"]["table"]["C"]["fixed"]
    assert arm["seeds"] == record["seeds"]["table"]
    assert arm["converged"] == 1.0
    written = {p.name for p in tmp_path.iterdir()}
    assert len([name for name in written if name.endswith(".png")]) == 5
    assert os.path.getsize(tmp_path / "sliding.gif") > 10_000


def test_a_claim_that_fails_ends_with_status_1(tmp_path, capsys, monkeypatch):
    failing = Verdict(claim(), "3.0", 3.0, "FAILS")
    monkeypatch.setattr(reproduce, "reproduce", lambda *_, **__: ([failing], []))
    assert main(["reproduce", "--out", str(tmp_path)]) == 1
    assert "FAILS" in capsys.readouterr().out


@pytest.mark.parametrize("seed", [1, 3])
def test_a_right_angle_bend_with_stiff_shear_converges_from_a_straight_start(seed):
    """These two took a hundred iterations and ended elsewhere before the start was softened."""
    found = scenes.trial(Scene("C", "oscillate", 16.44), seed)
    assert found.posterior.solve.converged
    assert found.posterior.solve.iterations < 20
    assert max(e.summary()["position_rmse"] for e in found.errors) < 0.05


def test_a_prior_whose_shear_is_soft_already_is_not_softened():
    soft = load_robot("tdcr466").prior
    assert soft.with_soft_shear() is soft
    stiff = scenes.robot().prior
    assert np.all(stiff.with_soft_shear().psd_strain_arclength[:3] > stiff.psd_strain_arclength[:3])
    assert np.array_equal(
        stiff.with_soft_shear().psd_strain_arclength[3:], stiff.psd_strain_arclength[3:]
    )
