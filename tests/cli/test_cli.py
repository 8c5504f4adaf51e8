import csv
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from command_line import run
from glissando.cli.main import main
from glissando.io.shipped_robots import robot_file

EXAMPLE = Path(__file__).parents[2] / "examples" / "closed_form_motion.py"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings") / "closed_form"
    subprocess.run([sys.executable, EXAMPLE, folder], check=True, capture_output=True)
    return folder


@pytest.mark.slow
def test_a_recording_becomes_a_table_a_report_a_posterior_and_figures(recording, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("estimate", recording, "--window", 0, 2, "--out", out) == 0
    table = capsys.readouterr().out
    assert not re.search(r"\w…", table)  # nothing is cut at 80 columns
    for word in ("truth1", "overall", "RMSE", "NEES", "converged"):
        assert word in table
    report = json.loads((out / "report.json").read_text())
    assert report["overall"]["position_rmse"] < 2e-3
    assert report["overall"]["coverage95_position"] > 0.9
    assert [s["name"] for s in report["sites"]] == ["truth1", "truth2", "truth3", "truth4"]
    for name in ("shape.png", "confidence.png", "error.png", "posterior.nc"):
        assert (out / name).stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("metres", [0.2, 1000.0])
def test_a_reading_that_is_far_off_is_named_and_every_command_goes_on(
    recording, tmp_path, capsys, metres
):
    spoilt = tmp_path / "spoilt"
    shutil.copytree(recording, spoilt)
    lines = (spoilt / "coil.csv").read_text().splitlines()
    cells = lines[21].split(",")
    cells[2] = str(float(cells[2]) + metres)
    (spoilt / "coil.csv").write_text("\n".join([*lines[:21], ",".join(cells), *lines[22:]]) + "\n")
    assert run("estimate", spoilt, "--window", 0, 1, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    if metres < 1.0:  # where the robot could be
        assert report["refused"] == {"coil": [float(cells[0])]}
    else:
        assert sum(report["dropped"]["coil"].values()) == 1
    assert report["overall"]["position_rmse"] < 2e-3
    assert run("estimate", spoilt, "--window", 0, 1) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert ("which all others refute: at" if metres < 1.0 else "coil: 1 ") in printed
    assert run("replay", spoilt, "--window", 0, 1, "--json") == 0
    replayed = json.loads(capsys.readouterr().out)
    assert replayed["newest"]["overall"]["position_rmse"] < 3e-3


@pytest.mark.slow
@pytest.mark.parametrize("command", ["estimate", "replay"])
def test_truth_of_another_time_is_named(recording, tmp_path, capsys, command):
    late = tmp_path / "late"
    shutil.copytree(recording, late)
    table = np.loadtxt(late / "truth2.csv", delimiter=",", skiprows=1)
    table[:, 0] += 120.0
    header = (late / "truth2.csv").read_text().splitlines()[0]
    np.savetxt(late / "truth2.csv", table, delimiter=",", header=header, comments="")
    assert run(command, late, "--window", 0, 1, "--json") == 0
    said = capsys.readouterr().err
    assert "truth2 judges nothing: its truth is of 120 to " in said
    assert "bring all streams to one" in said


@pytest.mark.slow
@pytest.mark.parametrize(("window", "warned"), [((0.5, 1.5), False), ((-4, 1), True)])
def test_a_window_beyond_all_readings_is_named(recording, capsys, window, warned):
    assert run("estimate", recording, "--window", *window, "--json") == 0
    said = capsys.readouterr().err
    assert ("the window of -4 to 1 s: what lies beyond them is predicted" in said) == warned


@pytest.mark.slow
def test_an_estimate_starts_from_an_earlier_one_and_says_how_to_go_on(recording, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("estimate", recording, "--window", 0, 1, "--max-iterations", 1) == 1
    complaint = capsys.readouterr().err
    for option in ("--max-iterations", "--start"):
        assert option in complaint
    assert run("estimate", recording, "--window", 0, 1, "--out", out) == 0
    capsys.readouterr()
    start = out / "posterior.nc"
    assert run("estimate", recording, "--window", 0, 1, "--start", start, "--json") == 0
    assert json.loads(capsys.readouterr().out)["iterations"] == 1
    assert run("estimate", recording, "--window", 0.5, 1.5, "--start", start) == 0
    assert run("estimate", recording, "--window", 0, 1, "--max-iterations", 0) == 2
    assert "give 1 or more" in capsys.readouterr().err


def test_json_is_one_object_and_nothing_else(recording, capsys):
    assert run("estimate", recording, "--window", 0, 1, "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    wanted = {"recording", "window", "status", "iterations", "unknowns", "seconds", "dropped"}
    assert wanted | {"overall", "sites"} <= set(printed)
    assert {"name", "arclength", "samples", "rotation_rmse"} <= set(printed["sites"][0])


@pytest.mark.slow
def test_a_query_is_answered_with_pose_strain_velocity_and_covariance(recording, tmp_path):
    query = tmp_path / "points.csv"
    query.write_text("arclength,time\n0.1,0.25\n0.466,0.9\n")
    assert run("estimate", recording, "--window", 0, 1, "--query", query, "--out", tmp_path) == 0
    with (tmp_path / "query.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:9] == ["time", "arclength", "x", "y", "z", "qw", "qx", "qy", "qz"]
    assert list(rows[0])[-1] == "c_5_5"
    assert len(rows[0]) == 21 + 36
    cov = np.array([[float(rows[0][f"c_{i}_{j}"]) for j in range(6)] for i in range(6)])
    assert np.linalg.eigvalsh(cov).min() > 0


def test_chosen_streams_are_used_and_judged(recording, capsys):
    arguments = ["--use", "coil,truth2", "--truth", "truth3", "--window", 0, 1, "--json"]
    assert run("estimate", recording, *arguments) == 0
    printed = json.loads(capsys.readouterr().out)
    assert list(printed["readings"]) == ["coil", "truth2"]
    assert [s["name"] for s in printed["sites"]] == ["truth3"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--window", 50, 60], "holds no readings; the recording runs from 0.000 to 7.9"),
        (["--window", 2, 1], "is empty; give T0 < T1"),
        (["--use", "sonar"], "no stream 'sonar'"),
        (["--truth", "sonar"], "no stream 'sonar'"),
        (["--use", "coil", "--truth", "coil"], "cannot be used and be truth at once"),
        (["--truth", "gyro"], "'gyro' is a gyro; truth must be one of pose"),
        (["--window", 0, "inf"], "is not finite"),
        (["--window", 0, 1e9], "choose a shorter window"),
        (["--robot", "nobody"], "no robot named 'nobody'"),
        (["--query", "nowhere.csv"], "nowhere.csv cannot be read"),
    ],
)
def test_a_mistake_is_one_sentence_and_status_2(recording, capsys, arguments, sentence):
    assert run("estimate", recording, *arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert sentence in captured.err
    assert captured.err.startswith("glissando: ")
    assert "Traceback" not in captured.err


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("time,where\n1,2\n", "must have the columns time,arclength"),
        ("", "must have the columns time,arclength"),
        ("time,arclength\n", "and a row for each point"),
        ("time, arclength\n0.1,nan\n", "line 2: give a number for time"),
        ("time,arclength\n0.1,oops\n", "line 2: give a number for time"),
        ("time,arclength\n0.1,0.9\n", "line 2: time 0.1 s, arclength 0.9 m lies outside"),
        ("time,arclength\n\n0.1,0.1\n\n0.1,0.9\n", "line 5: time 0.1 s, arclength 0.9 m"),
    ],
)
def test_a_bad_query_is_one_sentence(recording, tmp_path, capsys, text, sentence):
    query = tmp_path / "points.csv"
    query.write_text(text)
    assert run("estimate", recording, "--window", 0, 1, "--query", query) == 2
    assert sentence in capsys.readouterr().err


def test_results_that_cannot_be_written_are_refused_before_any_work(recording, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert run("estimate", recording, "--out", tmp_path / "file" / "out") == 2
    assert "is not a folder that can be written to" in capsys.readouterr().err


def test_a_bad_stream_is_one_sentence_and_nothing_is_written(tmp_path, capsys):
    head = "sensor type:,aurora\ntime,arclength,data\n"
    (tmp_path / "aurora0.csv").write_text(head + "0,0.5,0,0,0,0,0,0\n1,0.6,0,0,0.1,0,0,0\n")
    assert run("estimate", tmp_path, "--robot", "tdcr466", "--out", tmp_path / "out") == 2
    assert "rows 0, 1 at 0.5, 0.6 m, up to 0.134" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_query_is_not_overwritten_by_its_answers(recording, tmp_path, capsys):
    query = tmp_path / "query.csv"
    query.write_text("time,arclength\n0.1,0.1\n")
    arguments = ["--window", 0, 1, "--query", query, "--out", tmp_path]
    assert run("estimate", recording, *arguments) == 2
    assert "would replace data" in capsys.readouterr().err
    assert query.read_text().count("\n") == 2


def test_names_are_printed_as_they_are(recording, tmp_path, capsys):
    folder = tmp_path / "copy"
    folder.mkdir()
    for file in recording.iterdir():
        text = file.read_text().replace('"closed form motion"', '"sim [/red] [mm]"')
        (folder / file.name).write_text(text)
    assert run("estimate", folder, "--window", 0, 1) == 0
    assert "sim [/red] [mm]" in capsys.readouterr().out


def test_nothing_that_fixes_the_base_exits_2(recording, tmp_path, capsys):
    text = robot_file("tdcr466").read_text()
    start, end = text.index("[base]"), text.index("[prior]")
    robot = tmp_path / "free.toml"
    robot.write_text(text[:start] + text[end:])
    arguments = ["--robot", robot, "--use", "gyro", "--window", 0, 1]
    assert run("estimate", recording, *arguments) == 2
    assert "Nothing fixes the base" in capsys.readouterr().err


def test_not_converging_exits_1_and_says_what_to_try(recording, capsys, monkeypatch):
    from glissando import SolverOptions, evaluation

    original = evaluation.run.estimate
    monkeypatch.setattr(
        evaluation.run,
        "estimate",
        lambda *a, **k: original(*a, **(k | {"options": SolverOptions(max_iterations=1)})),
    )
    assert run("estimate", recording, "--window", 0, 1) == 1
    assert re.search(r"not converged: \d+ iterations", capsys.readouterr().err.replace("\n", " "))


def test_help_teaches(capsys):
    for arguments in (["--help"], ["estimate", "--help"]):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 0
    assert "examples:" in capsys.readouterr().out


def test_the_module_runs_as_a_program():
    done = subprocess.run(
        [sys.executable, "-m", "glissando", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("glissando 0.")


def test_help_and_the_package_import_nothing_heavy():
    code = (
        "import sys, glissando\nfrom glissando.cli.main import build_parser\n"
        "build_parser('').format_help()\nprint(sorted({'numpy', 'rich', 'scipy'} & {*sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_an_old_name_in_a_robot_file_is_one_line_and_no_mistake(tmp_path, recording, capsys):
    old = robot_file("tdcr466").read_text().replace('"white-noise"', '"kinematic"')
    (tmp_path / "old.toml").write_text(old)
    robot = "--robot", tmp_path / "old.toml"
    assert run("estimate", recording, *robot, "--window", 0, 1, "--json") == 0
    line = 'glissando: old.toml: kind = "kinematic" is now kind = "white-noise"; rename it.\n'
    assert capsys.readouterr().err == line


def test_ctrl_c_in_a_kernel_is_an_interruption(recording, monkeypatch, capsys):
    """numba makes a SystemError of it, whose cause is the interruption."""

    def interrupted(*_):
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr("glissando.cli.estimate.recording_and_robot", interrupted)
    assert run("estimate", recording) == 130
    assert capsys.readouterr().err == "glissando: interrupted\n"
    monkeypatch.setattr(
        "glissando.cli.estimate.recording_and_robot", lambda _: exec("raise SystemError")
    )
    with pytest.raises(SystemError):
        run("estimate", recording)
