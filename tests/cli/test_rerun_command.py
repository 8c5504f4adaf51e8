"""The same inputs give the same bytes, and a result is computed again from its report.json."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from glissando import GlissandoError, simulate
from glissando.cli import estimate, study
from glissando.cli.main import main
from glissando.cli.rerun import _written
from glissando.evaluation.reproduction import SAME, differences
from glissando.io.shipped_robots import robot_file
from glissando.simulation import write_session

pytest.importorskip("h5netcdf")


@pytest.fixture(scope="module")
def estimated(tmp_path_factory):
    """A recording of two seconds, and the results of its estimate."""
    folder = tmp_path_factory.mktemp("rerun")
    write_session(
        simulate(slide="hold", duration=2.0, seed=5), folder / "rec", "sliding700", seed=5
    )
    assert main(["estimate", str(folder / "rec"), "--view", "--out", str(folder / "out")]) == 0
    return folder


def copied(estimated, tmp_path):
    """The recording elsewhere."""
    return shutil.copytree(estimated / "rec", tmp_path / "rec")


def rerun(capsys, *words):
    """Exit status and document of a rerun."""
    capsys.readouterr()
    status = main(["rerun", *map(str, words), "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_the_same_inputs_give_the_same_bytes_of_every_file(estimated, tmp_path, capsys):
    again = tmp_path / "out"
    assert main(["estimate", str(estimated / "rec"), "--view", "--out", str(again)]) == 0
    first = {path.name: path.read_bytes() for path in (estimated / "out").iterdir()}
    assert {"report.json", "posterior.nc", "view.html", "shape.png"} <= first.keys()
    for name, content in first.items():
        assert (again / name).read_bytes() == content, name
    for ending in ("pdf", "svg"):
        drawn = []
        for _ in range(2):
            file = tmp_path / f"shape.{ending}"
            assert main(["figure", "shape", str(estimated / "out"), "--out", str(file)]) == 0
            drawn.append(file.read_bytes())
        assert drawn[0] == drawn[1], ending


@pytest.mark.slow
def test_a_simulation_of_one_seed_is_the_same_and_states_it(estimated, tmp_path):
    session = simulate(slide="hold", duration=2.0, seed=5, name="again")
    write_session(session, tmp_path / "rec", "sliding700", seed=5)
    for path in sorted((estimated / "rec").glob("*.csv")):
        assert (tmp_path / "rec" / path.name).read_bytes() == path.read_bytes()
    assert "seed = 5\n" in (tmp_path / "rec" / "recording.toml").read_text()


@pytest.mark.slow
def test_a_rerun_gives_the_same_numbers(estimated, capsys):
    report = estimated / "out" / "report.json"
    assert set(json.loads(report.read_text())["versions"]) >= {"python", "glissando", "numba"}
    status, found = rerun(capsys, report)
    assert (status, found["same"], found["inputs"], found["report"]) == (0, True, [], [])
    assert found["posterior"] == {"mean_in_std": 0.0, "std": 0.0}
    assert main(["rerun", str(report.parent)]) == 0  # the folder will do
    assert capsys.readouterr().out == "The same to the last digit.\n"


def test_a_renamed_report_is_compared_with_the_one_that_is_written(tmp_path):
    for name in ("check.json", "report.json"):
        assert _written(tmp_path, "mine.json").name == ("mine.json", "check.json")[name[0] == "r"]
        (tmp_path / name).write_text("{}")
    assert _written(tmp_path, "mine.json").name == "report.json"
    assert _written(tmp_path, "check.json").name == "check.json"


@pytest.mark.slow
def test_a_rerun_names_the_input_that_changed_and_what_it_changed(estimated, tmp_path, capsys):
    moved = copied(estimated, tmp_path)
    report = estimated / "out" / "report.json"
    assert rerun(capsys, report, "--recording", moved)[0] == 0
    lines = (moved / "coil.csv").read_text().splitlines()
    cells = lines[9].split(",")
    cells[2] = repr(float(cells[2]) + 1e-3)
    (moved / "coil.csv").write_text("\n".join([*lines[:9], ",".join(cells), *lines[10:]]) + "\n")
    status, found = rerun(capsys, report, "--recording", moved)
    assert (status, found["same"], found["inputs"]) == (1, False, ["coil.csv"])
    assert "log_evidence" in [entry["key"] for entry in found["report"]]
    assert 1e-6 < found["posterior"]["mean_in_std"] < 10.0
    assert main(["rerun", str(report), "--recording", str(moved)]) == 1
    assert "input coil.csv: its bytes are not those of then" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "report"),
    [
        ("replay {rec} --out {out}", "replay.json"),
        ("check {rec} --level 0.5 --block 0.05 --store-tube {out}.toml --out {out}", "check.json"),
        pytest.param(
            "plan --robot sliding700 --zone 0.3:0.5 --horizon 1 --out {out}", "plan.json",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "design --robot sliding700 --zone 0.3:0.5 --horizon 1 --strokes 0.06 --out {out}",
            "design.json", marks=pytest.mark.slow,
        ),
        pytest.param(
            "study {sweep} --workers 1 --out {out}", "summary.json", marks=pytest.mark.slow
        ),
        ("import {out}.csv --estimate {rec} --out {out}", "report.json"),
    ],
)  # fmt: skip
def test_every_report_is_computed_again(estimated, tmp_path, capsys, words, report):
    if words.startswith("study"):
        for package in ("pyarrow", "distributed", "cryptography"):
            pytest.importorskip(package)
    out, sweep = tmp_path / "out", tmp_path / "sweep.toml"
    sweep.write_text('seeds = 1\n[fixed]\nslide = "hold"\nduration = 2\n')
    truth = (estimated / "rec" / "mocap_700.csv").read_text().splitlines()
    rows = ["time,arclength,x,y,z", *(",".join(row.split(",")[:5]) for row in truth[1:])]
    Path(f"{out}.csv").write_text("\n".join(rows) + "\n")
    filled = words.format(rec=estimated / "rec", out=out, sweep=sweep)
    assert main(filled.split()) == 0
    stated = json.loads((out / report).read_text())
    assert stated["request"] == filled.split()[:-2]
    assert stated["inputs"]
    before = {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()}
    status, found = rerun(capsys, out / report)
    assert (status, found["same"], found["inputs"], found["report"]) == (0, True, [], [])
    assert set(found["tables"].values()) <= {0.0}
    assert {p: p.read_bytes() for p in sorted(tmp_path.rglob("*")) if p.is_file()} == before


@pytest.mark.slow
def test_a_tube_goes_into_the_robot_file_that_the_recording_brings(estimated, tmp_path):
    """Also where a shipped robot has its name."""
    moved, tube, out = copied(estimated, tmp_path), tmp_path / "tube.toml", tmp_path / "out"
    shipped = robot_file("sliding700").read_text(encoding="utf-8")
    (moved / "mine.toml").write_text("# mine\n" + shipped)
    described = moved / "recording.toml"
    described.write_text(described.read_text().replace('"sliding700"', '"mine.toml"'))
    words = f"check {moved} --level 0.5 --block 0.05 --store-tube {tube} --out {out}"
    assert main(words.split()) == 0
    assert tube.read_text().startswith("# mine\n")
    inputs = json.loads((out / "check.json").read_text())["inputs"]
    assert inputs["--robot"] == inputs["mine.toml"]


@pytest.mark.slow
def test_a_rerun_finds_a_number_of_a_table_that_is_another(estimated, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["replay", str(estimated / "rec"), "--out", str(out)]) == 0
    lines = (out / "newest.csv").read_text().splitlines()
    cells = lines[5].split(",")
    cells[2] = repr(float(cells[2]) + 1e-6)
    (out / "newest.csv").write_text("\n".join([*lines[:5], ",".join(cells), *lines[6:]]) + "\n")
    status, found = rerun(capsys, out / "replay.json")
    assert (status, found["same"], found["report"]) == (1, False, [])
    assert 1e-8 < found["tables"]["newest.csv"] < 1e-3


@pytest.mark.slow
def test_a_report_without_its_request_or_recording_is_refused(estimated, tmp_path, capsys):
    report = json.loads((estimated / "out" / "report.json").read_text())
    requests = {
        "gone": ["estimate", "nowhere"],
        "moves": ["record", "--simulate", "--out", str(tmp_path / "made")],
        "helps": ["estimate", "--help"],
        "strange": ["estimate", 3],
    }
    for name, request in requests.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(report | {"request": request}))
    (tmp_path / "other.json").write_text("[]")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    told = dict.fromkeys(("moves", "helps", "strange"), "states no command to run again")
    told |= {"gone": "is not there", "none": "be read"}
    for name, says in (told | dict.fromkeys(("other", "deep"), "does not state")).items():
        assert main(["rerun", str(tmp_path / f"{name}.json")]) == 2
        assert says in capsys.readouterr().err
    assert not (tmp_path / "made").exists()


def test_a_report_never_has_a_scheduler_asked(tmp_path, capsys, monkeypatch):
    """What a report of others names as a cluster could run its code here."""
    pytest.importorskip("distributed")
    asked = []
    monkeypatch.setattr(study, "cluster", lambda *where: asked.append(where) or cluster_is_away())
    (tmp_path / "sweep.toml").write_text("seeds = 1\n")
    words = ["study", str(tmp_path / "sweep.toml"), "--scheduler", "tcp://192.0.2.1:1"]
    report = {"request": words, "inputs": {}, "versions": {}}
    (tmp_path / "summary.json").write_text(json.dumps(report))
    assert main(["rerun", str(tmp_path / "summary.json")]) == 2
    assert asked == [(None, None)]


def cluster_is_away():
    raise GlissandoError("no cluster")


def test_packages_of_extras_are_asked_for_before_the_work(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(estimate, "find_spec", lambda name: None if name == "h5netcdf" else name)
    monkeypatch.setattr(estimate, "estimate_watched", None)
    write_session(simulate(slide="hold", duration=1.0), tmp_path / "rec", "sliding700")
    assert main(["estimate", str(tmp_path / "rec"), "--out", str(tmp_path / "out")]) == 2
    assert "h5netcdf, not installed: run pip install 'glissando[netcdf]'" in capsys.readouterr().err


def test_differences_are_found_wherever_they_are():
    rng = np.random.default_rng(0)
    before = {"a": rng.standard_normal(5).tolist(), "b": {"c": [1, {"d": float("nan")}], "e": None}}
    assert list(differences(before, json.loads(json.dumps(before)))) == []
    now = json.loads(json.dumps(before))
    now["a"][3] *= 1.0 + 1e-12
    now["b"]["c"][1]["d"] = 2
    now["b"]["f"] = "new"
    found = {d.key: d.size for d in differences(before, now)}
    assert list(found) == ["a.3", "b.c.1.d", "b.f"]
    assert 0.0 < found["a.3"] < SAME
    assert found["b.f"] == np.inf


def test_a_value_is_the_same_by_the_deviation_stated_for_it_and_by_no_other():
    before = {"value": [1e-8, 1e-8], "std": [1e-3, 1e-9], "nees": 1e-8}
    now = before | {"value": [1e-8 + 1e-14, 1e-8 + 1e-14], "nees": 1e-8 + 1e-14}
    found = {d.key: d.size for d in differences(before, now)}
    assert found["value.0"] < SAME
    assert found["value.1"] == pytest.approx(1e-6, rel=1e-3)
    assert found["nees"] == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.slow
def test_another_blas_on_two_threads_gives_the_same_numbers(estimated):
    """OpenBLAS's routines for a processor of 2008, which add in another order."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    other = os.environ | dict.fromkeys(names, "2") | {"OPENBLAS_CORETYPE": "Nehalem"}
    command = [sys.executable, "-m", "glissando", "rerun", estimated / "out" / "report.json"]
    done = subprocess.run([*command, "--json"], env=other, capture_output=True, timeout=300)
    found = json.loads(done.stdout)
    assert found["same"], found
    assert done.returncode == 0
    assert 0.0 < found["posterior"]["mean_in_std"] <= SAME
