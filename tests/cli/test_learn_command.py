"""`glissando learn`: a robot file from a recording, mistakes as one sentence."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command_line import run
from glissando import load_robot
from glissando.calibration.robot.case import RecordingCase
from glissando.calibration.robot.hyperparameters import Parameter, moved
from glissando.calibration.robot.learn import End, Learned
from glissando.calibration.robot.predictive import Score
from glissando.cli import learn as learn_command
from glissando.cli import learn_tendons, outputs
from glissando.cli.learn_report import _cells, as_json
from glissando.io.recording_folder import load_recording
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.tendons.replicate import TIP

WINDOW = ["--window", 0, 1]


@pytest.mark.slow
def test_what_was_learned_is_a_robot_file_that_estimate_takes(recording, tmp_path, capsys):
    out = tmp_path / "learned.toml"
    more = ["--truth", "truth2,truth4", "--calibrate", "--hold-out", "truth3", "--json"]
    arguments = ["--robot", recording / "few.toml", "--out", out, *WINDOW, "--steps", 1, *more]
    assert run("learn", recording, *arguments, "--only", "noise coil") == 0
    told = json.loads(capsys.readouterr().out)
    learned = {p["name"] for p in told["parameters"]}
    assert learned == {"coil noise, linear", "coil noise, angular"}
    assert told["objective_after"] >= told["objective_before"] - 1e-4  # constants move on
    assert [h["file"] for h in told["held_out"]] == ["before", "after"]
    robot, before = load_robot(out), load_robot(recording / "few.toml")
    for p in told["parameters"]:
        where = slice(0, 3) if "linear" in p["name"] else slice(3, 5)
        np.testing.assert_allclose(robot.sensor_std["coil"][where], p["value"])
        old = before.sensor_std["coil"][where]
        np.testing.assert_allclose(robot.sensor_std["coil"][where] / old, p["factor"])
    np.testing.assert_array_equal(robot.sensor_std["gyro"], before.sensor_std["gyro"])
    names = ["truth frame", "truth2 mount", "truth4 mount"]
    assert [u.name for u in robot.sensor_parameters] == names
    assert all(u.known for u in robot.sensor_parameters)
    assert run("estimate", recording, "--robot", out, *WINDOW, "--json") == 0
    assert json.loads(capsys.readouterr().out)["robot"] == "tdcr466"


@pytest.mark.slow
def test_constants_found_jointly_are_written_as_known_without_the_truths_delay(
    recording, tmp_path, capsys, in_process
):
    out = tmp_path / "learned.toml"
    options = ["--robot", recording / "few.toml", "--out", out, *WINDOW, "--steps", 1, "--json"]
    more = ["--truth", "truth2,truth4", "--joint", "--only", "gyro noise"]
    assert run("learn", recording, *options, *more) == 0
    told = json.loads(capsys.readouterr().out)
    names = ["truth frame", "truth2 mount", "truth4 mount"]
    assert [c["name"] for c in told["constants"]] == [*names, "truth delay"]
    robot = load_robot(out)
    assert [u.name for u in robot.sensor_parameters] == names
    assert all(u.known for u in robot.sensor_parameters)


def test_constants_that_were_found_are_found_anew(recording, tmp_path, capsys, in_process):
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    options = [*WINDOW, "--steps", 1, "--json", "--truth", "truth2,truth4,truth2"]
    more = ["--only", "gyro noise"]
    values = []
    for start, out in ((recording / "few.toml", first), (first, second)):
        way = ["--joint"] if start == first else ["--calibrate"]
        assert run("learn", recording, "--robot", start, "--out", out, *options, *more, *way) == 0
        told = json.loads(capsys.readouterr().out)
        robot = load_robot(out)
        names = ["truth frame", "truth2 mount", "truth4 mount"]
        assert [u.name for u in robot.sensor_parameters] == names
        values.append([u.value for u in robot.sensor_parameters])
    assert told["degrees_of_freedom"] == 2 * 2 * 6
    np.testing.assert_allclose(values[0], values[1], atol=3e-3)


@pytest.mark.slow
def test_truth_in_millimetres_is_refused_before_anything_is_learned(
    recording, tmp_path, capsys, in_process
):
    folder = tmp_path / "millimetres"
    shutil.copytree(recording, folder)
    head, *rows = (folder / "truth2.csv").read_text().splitlines()
    columns = head.split(",")
    position = [columns.index(c) for c in ("x", "y", "z")]
    cells = [row.split(",") for row in rows]
    for row in cells:
        for i in position:
            row[i] = str(1e3 * float(row[i]))
    (folder / "truth2.csv").write_text("\n".join([head, *map(",".join, cells)]) + "\n")
    out = tmp_path / "out.toml"
    options = ["--robot", folder / "few.toml", "--out", out, *WINDOW, "--steps", 1]
    for way in (["--truth", "truth2"], ["--truth", "truth4", "--hold-out", "truth2"]):
        assert run("learn", folder, *options, *way, "--only", "gyro noise") == 2
        captured = capsys.readouterr()
        assert "millimetres" in captured.err
        assert "--allow length-unit" in captured.err
        assert not out.exists()
    allowed = ["--truth", "truth2", "--only", "gyro noise", "--allow", "length-unit"]
    assert run("learn", folder, *options, *allowed) == 0


def test_constants_are_found_where_most_truth_is_whatever_the_order(recording, capsys):
    taken = load_recording(recording)
    cases = [RecordingCase(taken, (0.0, end), ("coil",), ("truth1",)) for end in (0.2, 0.8)]
    for given in (cases, cases[::-1]):
        assert learn_command._longest_first(given) == cases[::-1]
    assert "are found in closed form motion alone" in capsys.readouterr().err
    assert learn_command._longest_first(cases[:1]) == cases[:1]
    assert not capsys.readouterr().err


def test_a_stated_frame_of_the_tip_is_not_moved_without_a_word():
    def stated(turn):
        value = np.array([0.1, 0.0, 0.0, 0.0, 0.0, turn])
        frame = SensorParameter("tracker", "frame", (TIP,), value, np.zeros(6))
        return replace(load_robot("tdcr466"), sensor_parameters=(frame,))

    said = learn_tendons._frame_moved(stated(0.0), stated(0.5))
    assert "turned by 28.6 degrees and moved by" in said
    assert not learn_tendons._frame_moved(stated(0.0), stated(0.01))
    assert not learn_tendons._frame_moved(load_robot("tdcr466"), stated(0.5))


def test_a_folder_that_cannot_be_written_to_is_found_before_learning(
    recording, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(outputs.os, "access", lambda path, mode: False)
    options = ["--robot", recording / "few.toml", "--out", tmp_path / "out.toml", *WINDOW]
    assert run("learn", recording, *options) == 2
    assert "is not a folder that can be written to" in capsys.readouterr().err


def test_a_curvature_at_rest_is_shifted_and_a_density_scaled():
    document = {"rest_strain": [[0.0, 0.0, 1.0, 0.5, 0.0, 0.0]], "prior": {"time_scale": 2.0}}
    numbers = [
        Parameter("rest curvature 1, x", ("rest_strain", 0), (3,), 1.0),
        Parameter("time scale", ("prior", "time_scale"), ()),
    ]
    x, std = np.array([-0.7, np.log(2.0)]), np.array([0.1, np.inf])
    score = Score(0.0, 6, 6.0)
    end = End.SETTLED
    found = Learned(moved(document, numbers, x), numbers, x, std, score, score, 2, end, ())
    rest, scale = as_json(found, Path("out.toml"))["parameters"]
    assert rest["value"] == pytest.approx(-0.2)
    assert rest["shift"] == pytest.approx(-0.7)
    assert rest["std"] == pytest.approx(0.1)
    assert scale["factor"] == pytest.approx(2.0)
    assert scale["log_std"] is None
    assert [_cells(rest), _cells(scale)] == [("-0.7", "± 0.1"), ("× 2", "–")]


def test_without_json_a_table_is_printed_that_names_the_numbers(
    recording, tmp_path, capsys, in_process
):
    out = tmp_path / "learned.toml"
    options = ["--robot", recording / "few.toml", "--out", out, *WINDOW, "--steps", 1]
    assert run("learn", recording, *options, "--only", "gyro noise") == 0
    printed = capsys.readouterr().out
    for word in ("What was learned", "gyro noise", "log-likelihood", "Wrote"):
        assert word in printed
    assert load_robot(out).sensor_std["gyro"].shape == (3,)


@pytest.mark.parametrize(
    ("loss", "stated", "why"),
    [
        ("geman-mcclure", False, "with a loss that saturates (geman-mcclure) less is always"),
        ("huber", True, "the recording states it"),
    ],
)
def test_noise_of_which_nothing_can_be_learned_is_left_with_a_sentence(
    recording, tmp_path, capsys, loss, stated, why
):
    folder = tmp_path / "arc"
    shutil.copytree(recording, folder)
    robot = (folder / "few.toml").read_text()
    robot = robot.replace("[sensors.gyro]", f'[sensors.gyro]\nloss = "{loss}"')
    (folder / "few.toml").write_text(robot)
    if stated:
        text = (folder / "recording.toml").read_text()
        text = text.replace('kind = "gyro"', 'kind = "gyro"\nstd = [2e-3, 2e-3, 2e-3]')
        (folder / "recording.toml").write_text(text)
    options = ["--robot", folder / "few.toml", "--out", tmp_path / "learned.toml", *WINDOW]
    assert run("learn", folder, *options, "--only", "gyro noise") == 2
    said = capsys.readouterr().err
    assert f"gyro noise is not learned: {why}" in said
    assert "--only 'gyro noise' matches no number" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (["--calibrate"], "--calibrate finds where the truth is mounted: name it with --truth"),
        (["--joint"], "--joint finds where the truth is mounted: name it with --truth"),
        (["--joint", "--calibrate", "--truth", "truth2"], "give one of them"),
        (["--only", "nonsense"], "--only 'nonsense' matches no number"),
        (["--only", "noise,nonsense"], "--only 'nonsense' matches no number"),
        (["--steps", 0], "--steps is 0; give 1 or more"),
        (["--truth", "sonar"], "'sonar'"),
        (["--truth", "truth2", "--hold-out", "truth2"], "cannot be learned from and held out"),
        (["--use", "coil", "--truth", "coil"], "coil"),
        (["--robot", "nobody"], "no robot named 'nobody'"),
        (["--window", 2, 1], "is empty; give T0 < T1"),
        (["--window", 50, 60], "holds no readings"),
    ],
)
def test_a_mistake_is_one_sentence_and_status_2(recording, tmp_path, capsys, changes, sentence):
    out = tmp_path / "learned.toml"
    options = ["--robot", recording / "few.toml", "--out", out, *WINDOW]
    assert run("learn", recording, *options, *changes) == 2
    captured = capsys.readouterr()
    assert sentence in captured.err
    assert captured.err.startswith("glissando: ")
    assert captured.out == ""
    assert not out.exists()


@pytest.mark.slow
def test_a_script_without_its_guard_gets_a_sentence_and_does_not_hang(recording, tmp_path):
    words = [str(w) for w in ("learn", recording, "--robot", recording / "few.toml", *WINDOW)]
    script = tmp_path / "script.py"
    script.write_text(
        f"from glissando.cli.main import main\n"
        f"raise SystemExit(main({[*words, '--out', str(tmp_path / 'out.toml')]!r}))\n"
    )
    run = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert run.returncode == 2
    assert 'call learn from a script that begins with if __name__ == "__main__":' in run.stderr


def test_the_file_to_start_from_is_not_overwritten(recording, tmp_path, capsys):
    own = tmp_path / "own.toml"
    own.write_text((recording / "few.toml").read_text())
    assert run("learn", recording, "--robot", own, "--out", own, *WINDOW) == 2
    assert "is the file to start from; give another name" in capsys.readouterr().err
    assert own.read_text() == (recording / "few.toml").read_text()
    nowhere = tmp_path / "no" / "folder.toml"
    assert run("learn", recording, "--robot", own, "--out", nowhere, *WINDOW) == 2
    assert "is not a file in an existing folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("length = 1.0\n", "[prior] is missing"),
        ("[prior]\nkind = 3\n", "own.toml"),
        ("[prior]\n[sensors.pose]\n", "own.toml"),
        ("[prior]\npsd_strain_arclength = 3\n", "own.toml"),
    ],
)
def test_a_robot_file_that_is_none_is_one_sentence(recording, tmp_path, capsys, text, sentence):
    own = tmp_path / "own.toml"
    own.write_text(text)
    assert run("learn", recording, "--robot", own, "--out", tmp_path / "o.toml", *WINDOW) == 2
    assert sentence in capsys.readouterr().err
