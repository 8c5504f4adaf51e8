"""Tracks of foreign files become recordings: where, when and as what the user says."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from command_line import run
from draws import poses
from foreign_files import ndi_csv, tracker_csv
from glissando.errors import OtherTimesWarning, RecordingError
from glissando.geometry import se3
from glissando.io.foreign import Choices, Track, write_recording
from glissando.io.recording_folder import load_recording
from glissando.io.shipped_robots import robot_file


def track(name, **more):
    rng = np.random.default_rng(0)
    return Track(name, "pose", np.arange(5) / 10, poses(rng, 5), **more)


def test_tracks_become_streams_where_and_when_the_user_says(tmp_path):
    path = tmp_path / "path.csv"
    path.write_text("time,arclength\n0.1,0.4\n0.3,0.3\n")
    tracks = [track("coil", frame="tracker"), track("tip"), track("tip"), track("wand")]
    choices = Choices(
        {"coil": path, "tip_1": 0.466, "tip_2": 0.1},
        truth=["tip_1"],
        shift={"tip_2": -0.25},
        kind={"coil": "coil"},
        robot="tdcr466",
    )
    told = write_recording(tracks, tmp_path / "out", choices)
    assert told[-1] == "wand: left out, no arclength was given"
    assert told[0] == "coil: 3 of coil, 0.100 to 0.300 s, at 0.3…0.4 m, 2 outside its path"
    recording = load_recording(tmp_path / "out")
    assert recording.robot.name == "tdcr466"
    coil, tip, moved = (recording.streams[n] for n in ("coil", "tip_1", "tip_2"))
    np.testing.assert_allclose(coil.rows.arclength, [0.4, 0.35, 0.3])
    np.testing.assert_allclose(coil.rows.values, tracks[0].values[1:4], atol=1e-10)
    np.testing.assert_allclose(moved.rows.time, np.arange(5) / 10 - 0.25)
    assert [s.truth for s in (coil, tip, moved)] == [False, True, False]
    assert recording.unknown_frames == {"tracker"}


def test_times_since_1970_begin_at_the_first_of_them(tmp_path):
    early, late = track("a", absolute=True), track("b", absolute=True)
    early = Track(**{**vars(early), "time": early.time + 1.7e9})
    late = Track(**{**vars(late), "time": late.time + 1.7e9 + 3.0})
    write_recording([late, early], tmp_path / "out", Choices({"a": 0.1, "b": 0.2}))
    streams = load_recording(tmp_path / "out").streams
    np.testing.assert_allclose(streams["a"].rows.time, np.arange(5) / 10, atol=1e-6)
    np.testing.assert_allclose(streams["b"].rows.time, np.arange(5) / 10 + 3, atol=1e-6)


def test_times_count_from_the_first_reading_of_those_that_are_used(tmp_path):
    rng, at = np.random.default_rng(0), 1.7e9 + np.arange(3.0)
    tip = Track("tip", "pose", at, poses(rng, 3), absolute=True)
    latched = replace(tip, name="latched", time=at - 3600.0)
    write_recording([latched, tip], tmp_path / "out", Choices({"tip": 0.1}))
    assert load_recording(tmp_path / "out").streams["tip"].rows.time[0] == 0.0


def test_times_of_two_clocks_are_named_unless_a_shift_says_how_they_go_together(tmp_path):
    clock = track("a", absolute=True)
    clock, own = replace(clock, time=clock.time + 1.7e9), track("b")
    placed = {"a": 0.1, "b": 0.2}
    with pytest.warns(OtherTimesWarning, match=r"those of b from a zero of their own.*--shift b=S"):
        write_recording([clock, own], tmp_path / "mixed", Choices(placed))
    write_recording([clock, own], tmp_path / "said", Choices(placed, shift={"b": -0.2}))
    rows = load_recording(tmp_path / "said").streams["b"].rows
    np.testing.assert_allclose(rows.time, np.arange(5) / 10 - 0.2, atol=1e-6)


def test_a_clock_that_does_not_count_from_1970_is_that_of_its_path(tmp_path):
    (tmp_path / "path.csv").write_text("time,arclength\n5,0.4\n6,0.3\n")
    own = Track(**{**vars(track("a", absolute=True)), "time": 5.0 + np.arange(5) / 10})
    write_recording([own], tmp_path / "out", Choices({"a": tmp_path / "path.csv"}))
    rows = load_recording(tmp_path / "out").streams["a"].rows
    np.testing.assert_allclose(rows.time, own.time)
    np.testing.assert_allclose(rows.arclength, 0.4 - np.arange(5) / 100)


def test_a_robot_file_travels_with_the_recording(tmp_path):
    (tmp_path / "mine.toml").write_text(robot_file("tdcr466").read_text())
    choices = Choices({"tip": 0.4}, robot=str(tmp_path / "mine.toml"))
    write_recording([track("tip")], tmp_path / "out", choices)
    assert load_recording(tmp_path / "out").robot.length == 0.466


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ([], "Nothing is left to write (tip: left out, no arclength was given); say where"),
        (["--arclength", "top=0.1"], "The files hold no 'top'; they hold tip"),
        (["--arclength", "tip"], "'tip' is not NAME=VALUE"),
        (["--arclength", "tip=far"], "'far' is not a number"),
        (["--arclength", "tip=186.5"], "tip=186.5 m is on no robot; give metres"),
        (["--arclength", "tip=nan"], "'nan' is not a number"),
        (["--arclength", "tip=0", "--truth", "top"], "The files hold no 'top'"),
        (["--arclength", "tip=0", "--shift", "tip=soon"], "--shift 'soon' is not a number"),
        (["--arclength", "tip=0", "--kind", "tip=gyro"], "cannot be read as 'gyro'"),
        (["--arclength", "tip=0", "--kind", "tip=position"], "cannot be read as 'position'"),
        (["--arclength", "tip=0", "--robot", "nobody"], "no robot named 'nobody'"),
        (["--arclength", "tip=0", "--rate", "b.csv=3"], "--rate names 'b.csv'; the files are"),
        (["--arclength", "tip=0", "--rate", "fast"], "--rate 'fast' is not a number"),
        (["--arclength", "tip=0", "--topic", "/tip"], "--topic has no effect on files that are"),
    ],
)
def test_a_mistake_is_one_sentence_and_nothing_is_written(tmp_path, capsys, options, sentence):
    file = tracker_csv(tmp_path / "a.csv", {"tip": poses(np.random.default_rng(0), 3)})
    given = [file, "--rate", "100", "--out", tmp_path / "out", *options]
    assert run("import", *given) == 2
    captured = capsys.readouterr()
    assert sentence in captured.err
    assert captured.err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


def test_a_track_of_another_clock_than_its_path_is_said_to_be(tmp_path):
    (tmp_path / "path.csv").write_text("time,arclength\n100,0.4\n200,0.3\n")
    choices = Choices({"coil": tmp_path / "path.csv"})
    said = "5 rows at 0 to 0.4 s, outside its path, which goes from 100 to 200 s.*with --shift"
    with pytest.raises(RecordingError, match=said):
        write_recording([track("coil")], tmp_path / "out", choices)


@pytest.mark.parametrize(("times", "path", "said"), [
    (1e3, 1.0, "its times are probably in milliseconds; say so by clock=ms"),
    (1.0, 1e3, "those of its path are probably in milliseconds; say so by clock=ms"),
])  # fmt: skip
def test_milliseconds_on_one_side_of_a_path_are_named(tmp_path, times, path, said):
    """Once all but the first reading were left out, and what was left was written."""
    time = np.arange(40) / 10
    lines = [f"{path * t},{0.4 - 0.01 * t}" for t in time]
    (tmp_path / "path.csv").write_text("\n".join(["time,arclength", *lines]))
    coil = Track("coil", "pose", times * time, poses(np.random.default_rng(0), 40))
    with pytest.raises(RecordingError, match=said):
        write_recording([coil], tmp_path / "out", Choices({"coil": tmp_path / "path.csv"}))
    assert not (tmp_path / "out").exists()


def test_a_folder_that_holds_something_is_left_alone(tmp_path, capsys):
    file = tracker_csv(tmp_path / "a.csv", {"tip": poses(np.random.default_rng(0), 3)})
    options = [file, "--rate", 100, "--arclength", "tip=0.1", "--out", tmp_path]
    assert run("import", *options) == 2
    assert "not empty" in capsys.readouterr().err


@pytest.mark.slow
def test_an_imported_session_is_estimated_as_the_native_one(tmp_path, capsys):
    """A simulated session, written as a tracker and motion capture would, gives the same answer."""
    native, robot = tmp_path / "native", tmp_path / "robot.toml"
    text = robot_file("sliding700").read_text().replace('["coil"]', '["coil", "Coil"]')
    robot.write_text(text.replace("set_curvature =", "dropouts = 1\nset_curvature ="))
    options = ["--cycles", 1, "--shape", "C", "--seed", 4, "--robot", robot]
    assert run("simulate", "--out", native, *options) == 0
    streams = load_recording(native).streams
    text = (native / "recording.toml").read_text()
    frame = text[text.index("[frames.tracker]") : text.index("[[streams]]")]
    told = tomllib.loads(frame)["frames"]["tracker"]
    T_wt = np.eye(4)
    T_wt[:3, :3] = se3.rotation_from_quaternion(np.array(told["quaternion"]))
    T_wt[:3, 3] = told["position"]

    coil = streams["coil"].rows
    ticks = np.round(coil.time * 40).astype(int)
    frames = np.arange(ticks[-1] + 1)
    assert frames.size > ticks.size  # there are drop-outs
    seen = np.full((frames.size, 4, 4), np.nan)
    seen[ticks] = se3.inverse(T_wt) @ coil.values
    ndi_csv(tmp_path / "aurora.csv", {"Coil": seen}, 1000 + frames)
    place = np.column_stack([coil.time, coil.arclength])
    head = {"header": "time,arclength", "comments": "", "delimiter": ","}
    np.savetxt(tmp_path / "path.csv", place, "%.12g", **head)
    truth = {n: s.rows for n, s in streams.items() if s.truth}
    tracker_csv(tmp_path / "vicon.csv", {n: rows.values for n, rows in truth.items()})
    sites = [f"{name}={rows.arclength[0]:g}" for name, rows in truth.items()]
    files = [tmp_path / "aurora.csv", tmp_path / "vicon.csv"]
    where = ",".join([f"Coil={tmp_path / 'path.csv'}", *sites])
    options = ["--rate", "aurora.csv=40,vicon.csv=10", "--arclength", where]
    options += ["--truth", ",".join(truth), "--robot", robot]
    capsys.readouterr()
    assert run("import", *files, "--out", tmp_path / "in", *options) == 0
    toml = tmp_path / "in" / "recording.toml"
    written = toml.read_text()
    begin, end = written.index("[frames.tracker]"), written.index("[[streams]]")
    toml.write_text(written[:begin] + frame + written[end:])
    assert f"Coil: {coil.time.size} of coil" in capsys.readouterr().out

    reports = []
    for folder in (native, tmp_path / "in"):
        assert run("estimate", folder, "--json") == 0
        reports.append(json.loads(capsys.readouterr().out))
    mine, its = reports
    assert mine["readings"]["coil"] == its["readings"]["Coil"]
    assert its["log_evidence"] == pytest.approx(mine["log_evidence"], rel=1e-7)
    for a, b in zip(mine["sites"], its["sites"], strict=True):
        assert (a["name"], a["samples"]) == (b["name"], b["samples"])
        assert b["position_rmse"] == pytest.approx(a["position_rmse"], rel=1e-6)
        assert b["rotation_rmse"] == pytest.approx(a["rotation_rmse"], rel=1e-6)
