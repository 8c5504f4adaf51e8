"""Streams that were asked for and have no rows, and delays that are known."""

from pathlib import Path

import numpy as np
import pytest

from glissando.cli import importing
from glissando.cli.main import main
from glissando.geometry import se3
from glissando.io.csv_stream import Rows, Stream
from glissando.io.journal import Journal
from glissando.io.recording import Recording
from glissando.io.recording_writer import write_streams
from glissando.io.shipped_robots import robot_file

LENGTH, BEND = 0.7, np.array([0.0, 0.0, 1.0, 0.0, 0.5, 0.0])


def rows(late=0.0):
    """Poses of a tip that swings for two seconds."""
    time = np.arange(0.0, 2.0, 0.05)
    bend = BEND + np.outer(np.sin(time), [0, 0, 0, 0.5, 0, 0])
    noise = se3.exp(1e-3 * np.random.default_rng(0).standard_normal((time.size, 6)))
    place = np.full(time.size, LENGTH)
    return Rows("pose", time + late, place, se3.exp(LENGTH * bend) @ noise, {})


@pytest.fixture
def recording(tmp_path):
    """A folder with a tip's tracker and truth, of which one is on another clock by hours."""

    def write(late):
        streams = [Stream("tip", rows()), Stream("mocap", rows(late), truth=True)]
        write_streams(tmp_path / "rec", "rec", streams)
        return str(tmp_path / "rec")

    return write


NOISE = "\n[sensors.pose]\nstd = [1e-3, 1e-3]\n"
DELAY = """
[[sensor_parameters]]
name = "late"
kind = "time_offset"
streams = ["tip"]
value = [%g]
"""


@pytest.fixture
def robot(tmp_path):
    """The shipped robot's file with something added to it."""

    def write(more=""):
        file = tmp_path / "robot.toml"
        file.write_text(robot_file("sliding700").read_text() + NOISE + more)
        return str(file)

    return write


@pytest.mark.parametrize(
    "words",
    [
        ["estimate", "--truth", "mocap", "--window", "0", "2"],
        ["estimate", "--use", "mocap", "--window", "0", "2"],
        ["learn", "--truth", "mocap", "--steps", "1", "--window", "0", "2"],
        ["learn", "--hold-out", "mocap", "--steps", "1", "--window", "0", "2"],
    ],
)
def test_a_stream_on_another_clock_is_named_before_anything_is_computed(
    recording, robot, tmp_path, capsys, words
):
    command, *more = words
    out = ["--out", str(tmp_path / "out.toml")] if command == "learn" else []
    assert main([command, recording(7200.0), "--robot", robot(), *more, *out]) == 2
    said = capsys.readouterr().err
    assert "stream 'mocap' has no rows from 0 to 2 s; they go from 7200 to" in said
    assert "one clock" in said
    assert not (tmp_path / "out.toml").exists()


def test_a_stream_that_is_held_out_and_not_there_is_named_first(recording, robot, tmp_path, capsys):
    out = str(tmp_path / "out.toml")
    words = ["learn", recording(0.0), "--robot", robot(), "--hold-out", "mocup", "--out", out]
    assert main(words) == 2
    assert "has no stream 'mocup'; it has" in capsys.readouterr().err
    assert not (tmp_path / "out.toml").exists()


@pytest.mark.parametrize("delay", [0.02, -0.02])
def test_a_delay_that_is_known_moves_readings_and_the_window_with_them(
    recording, robot, capsys, delay
):
    for window in ([], ["--window", "0.5", "1.5"]):
        assert main(["estimate", recording(0.0), "--robot", robot(DELAY % delay), *window]) in (
            0,
            1,
        )
        assert "outside the grid" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        "estimate log --robot sliding700",
        "replay log --robot sliding700",
        "check log --robot sliding700",
        "view log --robot sliding700",
        "live --source log --robot sliding700",
        "learn log --robot sliding700 --out learned.toml",
        "export log --stream tip --out tip.csv",
        "export log --out tip.csv",
    ],
)
def test_a_journal_that_heard_nothing_ends_in_a_sentence(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    Journal("log").close()
    assert main(words.split()) == 2
    said = "glissando: log holds no readings; see that its sensors send, and record again.\n"
    assert capsys.readouterr().err.endswith(said)
    assert [path.name for path in tmp_path.iterdir()] == ["log"]


@pytest.mark.slow
def test_a_delay_that_no_other_stream_determines_is_said_to_be_as_it_was_stated(
    recording, robot, tmp_path, capsys
):
    file = robot(DELAY.replace("value = [%g]", "std = [0.02]"))
    words = ["--robot", file, "--truth", "mocap", "--out", str(tmp_path / "out")]
    assert main(["estimate", recording(0.0), *words]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "± 20 ms; as stated, the readings do not determine it" in said


@pytest.mark.parametrize(
    ("names", "said"), [(["tip"], "calibrate bench"), (["tip", "b"], "calibrate bench --coil tip")]
)
def test_the_next_step_of_an_import_names_one_of_several_coils(names, said):
    streams = {name: Stream(name, rows(), frame="tracker") for name in names}
    known = {"unknown_frames": frozenset({"tracker"})}
    made = Recording("bench", Path("bench"), streams, None, None, **known)
    assert importing._next(Path("bench"), made, truth=True).endswith(f"glissando {said}")
