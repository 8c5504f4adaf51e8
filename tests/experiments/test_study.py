"""Studies: what is asked, what is kept, what is said of it; nothing here starts a process."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

pytest.importorskip("pyarrow", reason="studies need pyarrow")
pytest.importorskip("cryptography", reason="local studies need keys")

from draws import generators, law
from glissando import GlissandoError, __version__
from glissando.cli.console import Console
from glissando.cli.main import main
from glissando.experiments import runner, scenes
from glissando.experiments.runner import METRICS, failure, outcome
from glissando.experiments.study import store as stores
from glissando.experiments.study.figures import study_figure
from glissando.experiments.study.plan import SETTINGS, StudyError, load_study
from glissando.experiments.study.store import TABLE, Store, parquet
from glissando.experiments.study.summary import print_summary, summarise
from studies import write_study

NOISE = "noise = [0.5, 2]"


def ids(study):
    return [cell.id for cell in study.cells()]


def made_up(rng, cell):
    """A row as a cell might leave it; every tenth fails."""
    if rng.uniform() < 0.1:
        return failure("it was not to be")
    return {**{name: float(rng.uniform()) for name in METRICS}, "error": None}


def test_a_study_is_every_combination_with_every_seed(tmp_path):
    study = load_study(write_study(tmp_path, NOISE + "\njitter = [1, 3]\nnodes = [2, 3]", seeds=5))
    found = study.cells()
    assert len(found) == len(study) == 2 * 2 * 2 * 5 == len({cell.id for cell in found})
    assert [cell.seed for cell in found[:6]] == [0, 1, 2, 3, 4, 0]
    combinations = {(c.settings["noise"], c.settings["jitter"], c.scene.nodes) for c in found}
    assert len(combinations) == 8
    assert set(found[0].settings) == set(SETTINGS)


def test_noise_scales_all_of_the_coil_and_a_part_only_itself(tmp_path):
    lines = "noise = [2]\njitter = [3]\nmocap = [5]"
    (cell,) = load_study(write_study(tmp_path, lines)).cells()
    scaled, usual = scenes.flaws(cell.scene), scenes.bench(cell.scene.robot).flaws
    assert scaled.bias == pytest.approx(2 * usual.bias)
    assert scaled.jitter == pytest.approx(6 * usual.jitter)
    assert scaled.mocap_angle == pytest.approx(5 * usual.mocap_angle)
    assert scaled.set_curvature == scaled.encoder == 0.0


@law
@given(st.permutations(["noise = [1, 2]", "mocap = [1, 2]", "nodes = [2, 3, 4]"]))
def test_an_id_depends_on_settings_alone(tmp_path_factory, lines):
    """Not on the order of axes, on where the file is, on what is said that would be so anyway."""
    here, there = (tmp_path_factory.mktemp("study") for _ in range(2))
    known = ids(load_study(write_study(here, "\n".join(sorted(lines)), seeds=2)))
    again = ids(load_study(write_study(there, "\n".join([*lines, "jitter = [1.0]"]), seeds=3)))
    assert set(known) < set(again)
    assert len(set(again)) == 2 * 2 * 3 * 3


def test_a_cell_is_another_when_its_robot_is(tmp_path):
    file = write_study(tmp_path, NOISE)
    before = ids(load_study(file))
    robot = tmp_path / "stub.toml"
    robot.write_text(robot.read_text().replace("6450", "6000"))
    assert not set(before) & set(ids(load_study(file)))


def test_a_slide_goes_on_as_long_as_the_session(tmp_path):
    file = write_study(tmp_path, 'speed = [0.01, 0.02]\nslide = ["oscillate"]\nduration = [20]')
    for cell in load_study(file).cells():
        assert scenes.path(cell.scene).duration >= 20.0
        assert cell.scene.stroke == 0.06


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("noise =", "nosie ="), "nosie is not a key of this table; did you mean 'noise'?"),
        (("encoder = 0", "encodr = 0"), "encodr is not a key .* did you mean 'encoder'?"),
        (("seeds = 1", "seed = 1"), "seed is not a key .* did you mean 'seeds'?"),
        (("seeds = 1", "seeds = 0.5"), "seeds is 0.5; give a whole number from 1 to"),
        (("seeds = 1", "seeds = 1e308"), "seeds is 1e.308; give a whole number from 1 to"),
        (("[0.5, 2]", "2"), "noise is 2; give a list of values to combine"),
        (("[0.5, 2]", "[]"), r"noise is \[\]; give a list of values to combine"),
        (("[0.5, 2]", "[2, 2.0]"), "noise is .*; give each value once"),
        (("[0.5, 2]", "[-1]"), "noise is -1; give a number from zero up"),
        (("noise = [0.5, 2]", "encoder = [1]"), "encoder is in .fixed. and in .grid."),
        (("straight", "Z"), "no shape named 'Z' and no such file"),
        (("noise = [0.5, 2]", "at = [0.4]"), "slide's stroke would be 0.4 m"),
        (('"hold"', '"hodl"'), "slide is 'hodl'; give one of hold, oscillate, traverse"),
        (("noise = [0.5, 2]", "stroke = [0.01, 0.02]"), "stroke changes nothing with slide = hold"),
        (("noise = [0.5, 2]", "gyro = [1, 2]"), "gyro is not a key of this table"),
        (("stub.toml", "stab.toml"), "no robot named 'stab.toml' and no such file"),
        (("noise = [0.5, 2]", 'prior = ["tdcr466"]'), "prior 'tdcr466' is of a robot of 0.466 m"),
        (("seeds = 1", "seeds = 9999999"), "asks for 19,999,998 cells"),
        (("seeds = 1", "seeds = ="), "is not valid TOML"),
    ],
)
def test_a_mistake_in_the_file_is_one_sentence(tmp_path, capsys, change, sentence):
    file = write_study(tmp_path, NOISE)
    assert change[0] in file.read_text()
    file.write_text(file.read_text().replace(*change))
    assert main(["study", str(file), "--out", str(tmp_path / "out")]) == 2
    with pytest.raises(GlissandoError, match=sentence):
        load_study(file).cells()
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_cell_is_a_trial_of_its_scene(tmp_path):
    (cell,) = load_study(write_study(tmp_path, "noise = [3]")).cells()
    found = scenes.trial(cell.scene, 7)
    row = outcome(cell.scene, 7)
    assert row["position_rmse"] == pytest.approx(found.errors[0].summary()["position_rmse"])
    assert row["error"] is None
    assert set(row) == {*METRICS, "error"}
    assert outcome(cell.scene, 8)["position_rmse"] != row["position_rmse"]


def test_a_cell_keeps_to_one_thread_and_outlives_any_mistake(tmp_path, monkeypatch):
    (cell,) = load_study(write_study(tmp_path, "noise = [1]")).cells()

    def threads(*_):
        raise ZeroDivisionError(sorted({p["num_threads"] for p in threadpool_info()}))

    monkeypatch.setattr(runner, "trial", threads)
    with threadpool_limits(2):
        assert outcome(cell.scene, 0) == failure("ZeroDivisionError: [1]")


@pytest.fixture
def big(tmp_path):
    return load_study(write_study(tmp_path, NOISE, seeds=50))


def opened(study, folder, resume=True):
    return Store(study, folder / "out", resume=resume)


@pytest.mark.slow
@law
@given(generators)
def test_the_table_does_not_depend_on_order_batches_or_interruptions(tmp_path_factory, rng):
    tables = []
    folder = tmp_path_factory.mktemp("study")
    study = load_study(write_study(folder, NOISE, seeds=10))
    plan = study.cells()
    rows = {cell.id: made_up(rng, cell) for cell in plan}
    for name in ("one", "other"):
        order = rng.permutation([cell.id for cell in plan])
        for batch in np.array_split(order, rng.integers(1, 6)):
            store = Store(study, folder / name, resume=True)  # as if every batch were a run
            store.add({cell: rows[cell] for cell in batch})
        tables.append(store.join(plan))
    assert (folder / "one" / TABLE).read_bytes() == (folder / "other" / TABLE).read_bytes()
    kept = tables[0].to_pylist()
    assert [row["id"] for row in kept] == [cell.id for cell in plan]
    assert [row["seed"] for row in kept] == [cell.seed for cell in plan]
    for row in kept:
        assert {name: row[name] for name in rows[row["id"]]} == rows[row["id"]]


def test_what_was_being_written_when_the_power_went_is_no_part(tmp_path, big):
    opened(big, tmp_path).add({cell.id: failure("no") for cell in big.cells()[:3]})
    (part,) = (tmp_path / "out" / "parts").iterdir()
    part.with_name("000001-torn.writing").write_bytes(part.read_bytes()[:100])
    assert len(opened(big, tmp_path).rows) == 3


def test_a_later_row_of_a_cell_replaces_the_earlier(tmp_path, big):
    first = big.cells()[0].id
    for sentence in ("one", "two", "three"):
        opened(big, tmp_path).add({first: failure(sentence)})
    assert opened(big, tmp_path).rows[first]["error"] == "three"


def test_results_are_not_overwritten_and_versions_do_not_mix(tmp_path, big, monkeypatch):
    opened(big, tmp_path, resume=False).add({})
    assert not list((tmp_path / "out" / "parts").iterdir())  # a batch of nothing is no file
    opened(big, tmp_path, resume=False).add({"a": failure("no")})
    with pytest.raises(StudyError, match="go on with --resume"):
        opened(big, tmp_path, resume=False)
    monkeypatch.setattr(stores, "__version__", "99")
    with pytest.raises(StudyError, match=f"is of glissando {__version__} and this is 99"):
        opened(big, tmp_path)


def test_a_table_says_what_made_it(tmp_path, big):
    store = opened(big, tmp_path)
    store.add({cell.id: failure("no") for cell in big.cells()})
    store.join(big.cells())
    told = json.loads(parquet().read_schema(tmp_path / "out" / TABLE).metadata[b"glissando"])
    assert told["version"] == __version__
    assert told["study"]["grid"] == {"noise": [0.5, 2.0]}
    assert told["study"]["fixed"]["duration"] == 0.025
    assert told["study"]["seeds"] == {"first": 0, "count": 50}


def rows_of(study, rng):
    return [{**cell.settings, "seed": cell.seed, **made_up(rng, cell)} for cell in study.cells()]


def test_a_summary_pools_the_cells_of_each_value(tmp_path):
    study = load_study(write_study(tmp_path, NOISE + "\nnodes = [2, 3]", seeds=40))
    rows = rows_of(study, np.random.default_rng(0))
    told = summarise(study, rows)
    assert set(told["axes"]) == {"noise", "nodes"}
    assert told["errors"] == {"it was not to be": told["failed"]}
    for point in told["axes"]["noise"]:
        mine = [r for r in rows if r["noise"] == point["value"]]
        sound = [r["position_rmse"] for r in mine if r["error"] is None]
        assert point["cells"] == len(mine) == 80
        assert point["failed"] == 80 - len(sound)
        square = [value**2 for value in sound]
        found = point["position_rmse"]
        assert found["value"] ** 2 == pytest.approx(sum(square) / len(square))
        error = 1.96 * np.std(square) / len(square) ** 0.5 / (2.0 * found["value"])
        assert found["high"] - found["low"] == pytest.approx(2.0 * error, rel=0.2)


def test_cells_of_a_seed_are_drawn_again_together(tmp_path):
    study = load_study(write_study(tmp_path, NOISE + "\nnodes = [2, 3, 4, 5]", seeds=40))
    rng = np.random.default_rng(1)
    error = rng.chisquare(3.0, 40)  # of a robot, tracker and noise, whatever the settings
    rows = rows_of(study, rng)
    numbers = ("position_rmse", "rotation_rmse", "coverage95_position", "converged")
    for row in rows:
        row |= {"error": None, **dict.fromkeys(numbers, 1.0)}
        row["nees_position"] = error[row["seed"] - study.seeds[0]]
    for point in summarise(study, rows)["axes"]["noise"]:
        found = point["nees_position"]
        assert found["value"] == pytest.approx(error.mean())
        wide = 2.0 * 1.96 * error.std() / 40**0.5
        assert found["high"] - found["low"] == pytest.approx(wide, rel=0.2)


@pytest.mark.parametrize("seeds", [2, 3, 8])
def test_intervals_of_few_seeds_hold_the_true_value_almost_as_often_as_they_say(tmp_path, seeds):
    study = load_study(write_study(tmp_path, "", seeds=seeds))
    rng, inside = np.random.default_rng(seeds), 0
    for _ in range(100):
        rows = rows_of(study, rng)
        for row, square in zip(rows, rng.lognormal(-0.125, 0.5, seeds), strict=True):  # mean 1
            row |= dict.fromkeys(METRICS, square**0.5) | {"error": None}
        found = summarise(study, rows)["axes"]["seeds"][0]["position_rmse"]
        inside += 0.0 < found["low"] <= 1.0 <= found["high"]
    assert inside >= 85


def test_a_single_seed_has_no_interval(tmp_path):
    study = load_study(write_study(tmp_path, "", seeds=1))
    rows = rows_of(study, np.random.default_rng(2))
    rows[0] |= dict.fromkeys(METRICS, 1.0) | {"error": None}
    told = summarise(study, rows)
    assert told["axes"]["seeds"][0]["position_rmse"] == {"value": 1.0, "low": None, "high": None}
    print_summary(told, Console())
    study_figure(told)


def test_a_study_without_axes_is_a_monte_carlo_of_its_seeds(tmp_path):
    study = load_study(write_study(tmp_path, "", seeds=9))
    (point,) = summarise(study, rows_of(study, np.random.default_rng(0)))["axes"]["seeds"]
    assert point["value"] == "9 seeds"
    assert point["cells"] == 9


def test_a_value_whose_cells_all_failed_has_no_numbers(tmp_path):
    study = load_study(write_study(tmp_path, 'shape = ["straight", "buckled.toml"]'))
    rows = rows_of(study, np.random.default_rng(3))
    rows[1] |= failure("no shape")
    told = summarise(study, rows)
    assert "position_rmse" not in told["axes"]["shape"][1]
    labels = study_figure(told)[1, 0].get_xticklabels()
    assert [label.get_text() for label in labels] == ["straight", "buckled.toml"]


def test_the_figure_draws_each_axis_with_its_bars(tmp_path):
    study = load_study(write_study(tmp_path, NOISE + "\nnodes = [2, 3, 4]", seeds=20))
    told = summarise(study, rows_of(study, np.random.default_rng(1)))
    figure = study_figure(told)[0, 0].figure
    assert [axes.get_xlabel() for axes in figure.axes[2:]] == ["noise", "nodes"]
    line = figure.axes[1].lines[0]
    wanted = [1e3 * point["position_rmse"]["value"] for point in told["axes"]["nodes"]]
    assert list(line.get_xdata()) == [2, 3, 4]
    assert line.get_ydata() == pytest.approx(wanted)


def test_the_study_of_the_page_is_one(tmp_path):
    page = Path(__file__).parents[2] / "docs" / "simulation.md"
    text = page.read_text(encoding="utf-8").partition("## Studies")[2]
    file = tmp_path / "sweep.toml"
    file.write_text(re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)[0])
    assert len(load_study(file).cells()) == 3 * 2 * 20
    told = set(re.findall(r"`(\w+)`", text.split("| setting |")[1].split("\n\n")[0]))
    assert set(SETTINGS) <= told
