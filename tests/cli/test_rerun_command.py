"""The same inputs give the same bytes, and a result is computed again from its report.json."""

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from glissando import simulate
from glissando.cli.main import main
from glissando.evaluation.reproduction import SAME, differences, posterior_difference
from glissando.io.netcdf import load_posterior
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


def test_a_simulation_of_one_seed_is_the_same_and_states_it(estimated, tmp_path):
    session = simulate(slide="hold", duration=2.0, seed=5, name="again")
    write_session(session, tmp_path / "rec", "sliding700", seed=5)
    for path in sorted((estimated / "rec").glob("*.csv")):
        assert (tmp_path / "rec" / path.name).read_bytes() == path.read_bytes()
    assert "seed = 5\n" in (tmp_path / "rec" / "recording.toml").read_text()


def test_a_rerun_gives_the_same_numbers(estimated, capsys):
    report = estimated / "out" / "report.json"
    assert set(json.loads(report.read_text())["versions"]) >= {"python", "glissando", "numba"}
    status, found = rerun(capsys, report)
    assert (status, found["same"], found["inputs"], found["report"]) == (0, True, [], [])
    assert found["posterior"] == {"mean_in_std": 0.0, "std": 0.0}
    assert main(["rerun", str(report)]) == 0
    assert capsys.readouterr().out == "The same to the last digit.\n"


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


def test_a_report_without_its_request_or_recording_is_refused(estimated, tmp_path, capsys):
    report = json.loads((estimated / "out" / "report.json").read_text())
    (tmp_path / "gone.json").write_text(
        json.dumps(report | {"request": report["request"] | {"recording": "nowhere"}})
    )
    (tmp_path / "other.json").write_text("[]")
    for name, says in (("gone", "is not there"), ("other", "does not state"), ("none", "be read")):
        assert main(["rerun", str(tmp_path / f"{name}.json")]) == 2
        assert says in capsys.readouterr().err


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


@pytest.mark.slow
def test_blas_on_two_threads_gives_the_same_numbers(estimated, tmp_path):
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    command = [sys.executable, "-m", "glissando", "estimate", estimated / "rec", "--out", tmp_path]
    two = os.environ | dict.fromkeys(names, "2")
    subprocess.run(command, env=two, check=True, capture_output=True, timeout=300)
    pair = (load_posterior(folder / "posterior.nc") for folder in (estimated / "out", tmp_path))
    assert max(posterior_difference(*pair)) <= SAME
