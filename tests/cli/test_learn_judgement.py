"""What `glissando learn` has learned is judged by truth that it was not learned from."""

import argparse
import json
import shutil
from pathlib import Path

import pytest

from command_line import run
from glissando import GlissandoError, load_robot
from glissando.cli import learn_judgement
from glissando.cli.console import truth_cells
from glissando.evaluation.run import run_estimate

WINDOW = ["--window", 0, 1]


def unmarked(recording, tmp_path):
    """A copy in which no stream is marked as truth."""
    folder = tmp_path / "unmarked"
    shutil.copytree(recording, folder)
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(text.replace("truth = true", ""))
    return folder


def test_what_was_learned_stays_where_held_out_truth_cannot_be_judged(
    recording, tmp_path, capsys, in_process, monkeypatch
):
    def breaks(*given, **more):
        raise GlissandoError("It cannot be judged.")

    monkeypatch.setattr(learn_judgement, "run_estimate", breaks)
    out = tmp_path / "out.toml"
    options = ["--robot", recording / "few.toml", "--out", out, *WINDOW, "--steps", 1]
    more = ["--truth", "truth2", "--hold-out", "truth3", "--only", "gyro noise"]
    assert run("learn", recording, *options, *more) == 2
    captured = capsys.readouterr()
    assert "What was learned" in captured.out
    assert f"{out} holds what was learned" in captured.err
    assert "It cannot be judged." in captured.err
    assert load_robot(out).name == "tdcr466"


def test_truth_that_was_learned_from_is_no_sensor_where_other_truth_is_held_out(
    recording, tmp_path, capsys, in_process, monkeypatch
):
    """Nothing marks truth here, so each stream is a sensor unless an option says otherwise."""
    folder, used = unmarked(recording, tmp_path), []

    def watched(*given, use, **more):
        used.append(use)
        return run_estimate(*given, use=use, **more)

    monkeypatch.setattr(learn_judgement, "run_estimate", watched)
    options = ["--robot", folder / "few.toml", "--out", tmp_path / "out.toml", "--steps", 1]
    more = ["--truth", "truth2,truth4", "--hold-out", "truth3", "--only", "gyro noise"]
    assert run("learn", folder, *options, *WINDOW, *more) == 0
    assert used == 2 * [["coil", "gyro", "truth1"]]


def test_marked_truth_judges_what_readings_alone_have_taught(
    recording, tmp_path, capsys, in_process
):
    out = tmp_path / "out.toml"
    options = ["--robot", recording / "few.toml", "--out", out, *WINDOW, "--steps", 1, "--json"]
    more = ["--only", "gyro noise", "--use", "coil,gyro"]
    for folder, judges in ((recording, True), (unmarked(recording, tmp_path), False)):
        assert run("learn", folder, *options, *more) == 0
        captured = capsys.readouterr()
        told = json.loads(captured.out)
        assert [h["file"] for h in told["held_out"]] == ["before", "after"] * judges
        assert (f"no truth judges {out}" in captured.err) is not judges


@pytest.mark.parametrize(("inside", "warned"), [(0.84, True), (0.86, False)])
def test_a_file_that_is_too_sure_of_truth_is_named(inside, warned, capsys):
    errors = [
        {"file": file, "recording": "arm", "coverage95_position": share}
        for file, share in (("before", 0.2), ("after", inside))
    ]
    options = argparse.Namespace(out=Path("out.toml"), truth=None)
    learn_judgement.warn_of_confidence({"held_out": errors}, options)
    said = capsys.readouterr().err
    assert ("with out.toml 84.0 % of truth in arm lie inside 95 %" in said) is warned
    assert said.count("lie inside") == warned


def test_what_a_stream_that_was_held_out_does_not_read_has_no_number():
    errors = {"position_rmse": 2e-3, "nees_position": 1.1, "coverage95_position": 0.9}
    held = {**errors, "rotation_rmse": None}
    assert truth_cells(held) == ["2.00", "–", "1.10", "90.0 %"]
    none = {**dict.fromkeys(errors), "rotation_rmse": 0.1}
    assert truth_cells(none) == ["–", "5.73", "–", "–"]
