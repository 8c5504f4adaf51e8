"""Recordings replayed as if live: judged as they go, and nothing lost when the run is killed."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time as clock
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import generators, law
from glissando import load_robot
from glissando.cli.main import main
from glissando.errors import RecordingError, SensorError
from glissando.evaluation.replay import replay
from glissando.evaluation.run import run_estimate
from glissando.geometry import se3
from glissando.io.journal import Journal
from glissando.io.recording_folder import load_recording
from glissando.model.sensors.sensors import sensor_class, sensor_kinds
from glissando.model.tendons.channel import Channel
from scenes import LENGTH, arc, sliding_scene

ROBOT = """
name = "arc"
length = 0.466
rest_strain = [0, 0, 1, 0, 0, 0]

[grid]
arclength_nodes = 4
time_rate = 10.0

[base]
position = [0, 0, 0]
quaternion = [1, 0, 0, 0]
var_pose = [1e-6, 1e-4]
var_strain = [1e-5, 1e-5, 1e-5, 25, 25, 1]

[prior]
kind = "separable"
time_scale = 0.5
psd_strain_arclength = [1e-5, 1e-5, 1e-5, 5, 5, 1]
"""
KINDS = sensor_kinds()


def some_readings(rng, kind, count):
    """Readings of a kind, out of order, with a mount where it has one."""
    noise = {"time": rng.uniform(0, 9, count), "arclength": rng.uniform(0, LENGTH, count)}
    pose = se3.exp(rng.uniform(-1, 1, (count, 6)))
    three = dict.fromkeys(("position", "gyro", "accelerometer"), 3)
    width = {**three, "strain": 6, "fbg": 2, "tendon": 2}.get(kind, 0)
    values = pose if kind in ("pose", "coil") else pose[:, :3, :3]
    if width:
        values = rng.uniform(-1, 1, (count, width))
    pair = np.array([1e-4, 2e-4])
    extra = {
        "fbg": {"core_radius": pair, "core_angle": pair},
        "tendon": {"radius": pair, "angle": pair, "end": pair},
    }.get(kind, {})
    rows = {"pose": 6, "coil": 5, "strain": 6, "fbg": 2, "tendon": 2}.get(kind, 3)
    cov = np.full(rows, 1e-4) if kind in ("fbg", "tendon") else rng.uniform(1e-4, 1.0, rows)
    sensor, mount = sensor_class(kind), se3.exp(rng.uniform(-1, 1, 6))
    mount = mount if sensor.mounted else np.eye(4)
    return sensor(**noise, values=values, cov=cov, mount=mount, name=kind, **extra)


@pytest.mark.slow
@law
@given(generators)
def test_a_journal_gives_back_what_was_written_sorted_by_time(rng):
    given_ = [some_readings(rng, kind, 6) for kind in KINDS]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        for half in (slice(0, 4), slice(4, 6)):  # closed and opened again
            with Journal(path, "a run") as journal:
                for readings in given_:
                    journal.write(readings.select(half))
        (path / "arc.toml").write_text(ROBOT)
        recording = load_recording(path)
        assert recording.name == "a run"
        found, _ = recording.readings(KINDS, load_robot(path / "arc.toml"), (0.0, 9.0))
    for mine, its in zip(given_, found, strict=True):
        mine = mine.select(np.argsort(mine.time, kind="stable"))
        np.testing.assert_array_equal(mine.time, its.time)
        np.testing.assert_array_equal(mine.arclength, its.arclength)
        np.testing.assert_allclose(mine.values, its.values, atol=1e-14)
        np.testing.assert_allclose(mine.cov, its.cov, rtol=1e-14)
        np.testing.assert_allclose(mine.mount, its.mount, atol=1e-14)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(generators, st.floats(0.0, 1.0))
def test_a_journal_cut_anywhere_loses_only_its_end_and_can_be_gone_on_with(rng, share):
    given_ = some_readings(rng, "gyro", 12)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        with Journal(path) as journal:
            journal.write(given_.select(slice(0, 8)))
        file = path / "gyro.csv"
        text = file.read_bytes()
        head = text.index(b"\n") + 1
        cut = head + int(share * (len(text) - head))
        file.write_bytes(text[:cut])
        kept = text[head:cut].count(b"\n")
        streams = load_recording(path).streams
        assert (len(streams["gyro"].rows.time) if streams else 0) == kept
        with Journal(path) as journal:
            journal.write(given_.select(slice(8, 12)))
        times = load_recording(path).streams["gyro"].rows.time
    assert sorted(times) == sorted([*given_.time[:kept], *given_.time[8:]])


def test_what_a_journal_cannot_keep_is_a_sentence(tmp_path):
    rng = np.random.default_rng(0)
    pose = some_readings(rng, "pose", 3)
    with Journal(tmp_path / "log") as journal:
        assert not load_recording(tmp_path / "log").streams
        with pytest.raises(SensorError, match="one standard deviation a row"):
            journal.write(pose.changed(cov=np.full((6, 6), 1e-3)))
        with pytest.raises(SensorError, match="cannot be that of a file"):
            journal.write(pose.changed(name="../pose"))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("words")
    with pytest.raises(RecordingError, match="holds something else"):
        Journal(tmp_path / "other")


def record(folder, duration, silence=(0.0, 0.0)):
    """A recording folder with truth, and its robot; its sensors say nothing during the silence."""
    _, _, sensors = sliding_scene(duration=duration)
    sensors = [r.select((r.time <= silence[0]) | (r.time >= silence[1])) for r in sensors]
    rng = np.random.default_rng(1)
    time = np.arange(0.03, duration, 0.11)
    tip = some_readings(rng, "pose", len(time)).changed(
        time=time, arclength=np.full(len(time), LENGTH), values=arc(LENGTH, time),
        name="tip", mount=np.eye(4), cov=1e-8 * np.eye(6),
    )  # fmt: skip
    with Journal(folder, "arc") as journal:
        for stream in (*sensors, tip):
            journal.write(stream)
    text = (folder / "recording.toml").read_text()
    text = text.replace('name = "tip"', 'name = "tip"\ntruth = true')
    text = text.replace('name = "arc"', 'name = "arc"\nrobot = "arc.toml"', 1)
    (folder / "recording.toml").write_text(text)
    (folder / "arc.toml").write_text(ROBOT)
    return load_recording(folder)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record(tmp_path_factory.mktemp("recorded") / "arc", 2.0)


@pytest.mark.slow
def test_truth_of_a_silence_is_judged_as_well(tmp_path):
    """By a robot at rest, which it is taken to be; it was left out, and errors looked small."""
    recording = record(tmp_path / "arc", 12.0, silence=(1.0, 11.0))
    found = replay(recording, recording.robot)
    assert found.smoother.restarts
    truth = recording.stream("tip").rows.time
    np.testing.assert_array_equal(found.newest[0].time, truth[truth > found.time[0]])
    silent = (found.newest[0].time > 5.0) & (found.newest[0].time < 10.0)
    assert found.newest[0].position[silent].max() > 0.02
    for errors in (found.newest[0], found.lagged[0]):  # also where it is heard again
        assert errors.nees_position.max() < 16.0


@pytest.mark.slow
def test_with_a_window_as_long_as_the_recording_what_is_lagged_is_what_the_batch_says(recorded):
    found = replay(recorded, recorded.robot, lag=10.0)
    batch = run_estimate(recorded, recorded.robot, window=None, use=None, truth=None)
    mine, its = found.lagged[0], batch.errors[0]
    assert mine.position.size == its.position.size
    np.testing.assert_allclose(mine.position, its.position, atol=2e-4)
    newest = found.newest[0]
    assert newest.position.size == its.position.size  # each truth sample is judged once
    np.testing.assert_array_equal(newest.time, its.time)
    assert not np.allclose(newest.position, mine.position, atol=1e-4)


def test_rows_that_a_tracker_repeats_are_counted_as_by_an_estimate(recorded, tmp_path, capsys):
    folder = shutil.copytree(recorded.folder, tmp_path / "polled")
    about = folder / "recording.toml"
    about.write_text(about.read_text().replace("keep_repeats = true\n", ""))
    file = folder / "coil.csv"
    head, *rows = file.read_text().splitlines()
    later = [f"{float(r.partition(',')[0]) + 1e-3!r},{r.partition(',')[2]}" for r in rows[:7]]
    file.write_text(
        "\n".join([head, *sorted(rows + later, key=lambda r: float(r.split(",")[0]))]) + "\n"
    )
    counts = []
    for command in ("estimate", "replay"):
        assert main([command, str(folder)]) == 0
        counts.append(re.findall(r"(\d+) repeated rows dropped", capsys.readouterr().out))
    assert counts == [["7"], ["7"]]
    run = replay(load_recording(folder), load_recording(folder).robot)
    assert run.as_json()["rows_dropped"] == {"coil": {"repeated": 7}}


@pytest.mark.slow
def test_the_command_tells_latencies_and_errors_and_leaves_files(recorded, tmp_path, capsys):
    out = tmp_path / "live"
    call = ["replay", str(recorded.folder), "--lag", "0.3", "--out", str(out)]
    assert main([*call, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["updates"] == 21
    assert told["nodes"] == 4
    assert 0.0 < told["latency"]["median"] <= told["latency"]["p99"] <= told["latency"]["max"]
    assert told["newest"]["sites"][0]["name"] == "tip"
    assert told["lagged"]["overall"]["position_rmse"] < 0.05
    written = json.loads((out / "replay.json").read_text())
    assert written.pop("versions")["glissando"]
    assert told.items() <= written.items()
    assert written["request"] == [*call[:-2], "--json"]
    assert len((out / "newest.csv").read_text().splitlines()) == 1 + 21 * 4
    assert (out / "replay.png").stat().st_size > 10_000
    log = load_recording(out / "log")
    assert {n: len(s.rows.time) for n, s in log.streams.items()} == {
        n: len(s.rows.time) for n, s in recorded.streams.items() if not s.truth
    }
    assert main(call) == 2
    assert "holds a finished run" in capsys.readouterr().err
    assert main(["replay", str(recorded.folder), "--lag", "0"]) == 0
    assert "1 time nodes" in capsys.readouterr().out
    assert main(["replay", str(recorded.folder), "--lag", "nan"]) == 2
    assert main(["replay", str(recorded.folder), "--window", "5", "6"]) == 2
    assert "holds no readings" in capsys.readouterr().err


def test_it_can_be_watched_as_it_goes(recorded, capsys):
    pytest.importorskip("viser")
    call = ["replay", str(recorded.folder), "--window", "0", "0.5", "--live"]
    assert main(call) == 0
    assert "Look at http://127.0.0.1:" in capsys.readouterr().err


@pytest.mark.slow
def test_in_real_time_it_takes_as_long_as_it_took(recorded):
    began = clock.monotonic()
    replay(recorded, recorded.robot, window=(0.0, 0.7), real_time=True)
    assert clock.monotonic() - began >= 0.7


RUN = """
import sys
import tempfile
import time as clock
from pathlib import Path
from glissando.io.recording_folder import load_recording
from glissando.evaluation.replay import replay
recording = load_recording(sys.argv[1])
def watch(done, total, smoother):
    print(done, smoother.time, flush=True)
    if done == 9:
        sys.stdin.read()  # until it is killed
replay(recording, recording.robot, journal=Path(sys.argv[2]), watch=watch)
"""


def test_only_the_same_run_is_gone_on_with(recorded, tmp_path):
    log, robot = tmp_path / "log", recorded.robot

    def stop(done, total, smoother):
        if done == 2:
            raise KeyboardInterrupt

    short = {"window": (0.0, 0.5), "journal": log}
    with pytest.raises(KeyboardInterrupt):
        replay(recorded, robot, **short, watch=stop)
    for changed, named in (
        ({"window": (0.0, 0.7)}, "window, readings"),
        ({"lag": 0.0}, "lag"),
        ({"use": ["coil"]}, "readings"),
    ):
        with pytest.raises(RecordingError, match=f"differs in: {named}; repeat"):
            replay(recorded, robot, **short | changed)
    beside = {k: replace(s, channel=Channel(5e-3)) for k, s in recorded.streams.items()}
    with pytest.raises(RecordingError, match="differs in: readings; repeat"):
        replay(replace(recorded, streams=beside), robot, **short)
    with pytest.raises(RecordingError, match="differs in: robot; repeat"):
        replay(recorded, load_robot("tdcr466"), **short)
    assert len(replay(recorded, robot, **short).time) == 4


@pytest.mark.slow
def test_killed_in_mid_run_it_has_everything_on_disk_and_goes_on_from_there(recorded, tmp_path):
    log = tmp_path / "live" / "log"
    log.parent.mkdir()
    command = [sys.executable, "-c", RUN, str(recorded.folder), str(log)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        lines = [process.stdout.readline() for _ in range(9)]
        os.kill(process.pid, signal.SIGKILL)
    reached = float(lines[-1].split()[1])
    logged = load_recording(log)
    for name, stream in logged.streams.items():
        time = recorded.streams[name].rows.time
        np.testing.assert_array_equal(stream.rows.time, time[time <= reached])
    on = replay(recorded, recorded.robot, journal=log)
    through = replay(recorded, recorded.robot)
    assert len(on.time) == len(through.time) - 9
    begins = [found.as_json()["judged_from"] for found in (through, on)]
    assert begins == [through.window[0], on.time[0]]
    np.testing.assert_allclose(on.states[-1].pose, through.states[-1].pose, atol=1e-4)
    np.testing.assert_allclose(on.states[-1].cov, through.states[-1].cov, rtol=0.05, atol=1e-8)
    for name, stream in load_recording(log).streams.items():
        np.testing.assert_array_equal(stream.rows.time, recorded.streams[name].rows.time)
    again = replay(recorded, recorded.robot, journal=log)  # as if killed before its report
    np.testing.assert_array_equal(again.states[-1].cov, through.states[-1].cov)
