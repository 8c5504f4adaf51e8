"""A journal goes on where it ended, and one stream is readings of one kind."""

import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glissando import load_robot
from glissando.errors import SensorError
from glissando.geometry import se3
from glissando.io.journal import Journal
from glissando.io.recording_folder import load_recording
from glissando.model.sensors.sensors import GyroReadings, PoseReadings


def _at(*times):
    return {"time": np.array(times), "arclength": np.zeros(len(times)), "name": "tip"}


def _pose(*times):
    return PoseReadings(
        values=np.tile(np.eye(4), (len(times), 1, 1)), cov=np.ones(6), **_at(*times)
    )


@pytest.mark.parametrize("own", [False, True])
def test_the_robot_is_named_or_its_file_kept_beside(tmp_path, own):
    robot = load_robot("tdcr466")
    if own:
        file = tmp_path / "mine.toml"
        file.write_text(robot.file.read_text(encoding="utf-8"), encoding="utf-8")
        robot = load_robot(file)
    with Journal(tmp_path / "log", robot=robot) as journal:
        journal.write(_pose(0.0, 0.5))
    read = load_recording(tmp_path / "log").robot
    assert read.file == (tmp_path / "log" / "robot.toml" if own else robot.file)
    assert read.length == robot.length


GYRO = GyroReadings(values=np.zeros((1, 3)), cov=np.ones(3), **_at(0.5))


@pytest.mark.parametrize("again", [False, True])
def test_readings_of_another_kind_under_a_streams_name_are_refused(tmp_path, again):
    with ExitStack() as stack:
        journal = stack.enter_context(Journal(tmp_path / "log"))
        journal.write(_pose(0.0))
        if again:
            journal.close()
            journal = stack.enter_context(Journal(tmp_path / "log"))
        assert journal.streams == ("tip",)
        with pytest.raises(SensorError, match=r"of kind 'pose' and those .* of kind 'gyro'"):
            journal.write(GYRO)
    assert load_recording(tmp_path / "log").streams["tip"].rows.time.tolist() == [0.0]


def test_rows_of_a_stream_that_is_not_described_are_kept(tmp_path):
    with Journal(tmp_path / "log") as journal:
        journal.write(_pose(0.0, 1.0))
    begun = (tmp_path / "log" / "recording.toml").read_text()
    (tmp_path / "log" / "recording.toml").write_text(begun.partition("[[streams]]")[0])
    with Journal(tmp_path / "log") as journal:
        journal.write(_pose(2.0))
    assert load_recording(tmp_path / "log").streams["tip"].rows.time.tolist() == [0.0, 1.0, 2.0]


def test_a_stream_that_was_cut_off_before_it_was_described_is_begun_anew(tmp_path):
    Journal(tmp_path / "log").close()
    (tmp_path / "log" / "tip.csv").write_text("time,arclength,wx,wy,wz\n")
    with Journal(tmp_path / "log") as journal:
        journal.write(_pose(0.0, 1.0))
    assert load_recording(tmp_path / "log").streams["tip"].rows.time.tolist() == [0.0, 1.0]


@pytest.mark.parametrize("again", [False, True])
def test_noise_or_a_mount_that_changes_is_refused_as_one_of_each_is_kept(tmp_path, again):
    mount = se3.exp(np.array([0.0, 0.02, 0.0, 0.3, -0.2, 0.1]))
    off = mount @ se3.exp(np.array([0.0, 0.0, 0.0, 1e-3, 0.0, 0.0]))

    def pose(time, std=0.1):
        return replace(_pose(time), cov=np.full(6, std**2), mount=mount)

    with ExitStack() as stack:
        journal = stack.enter_context(Journal(tmp_path / "log"))
        journal.write(pose(0.0))
        if again:
            journal.close()
            journal = stack.enter_context(Journal(tmp_path / "log"))
        for changed in (pose(1.0, std=0.2), replace(pose(1.0), mount=off)):
            with pytest.raises(SensorError, match="noise or mount is not that of the readings"):
                journal.write(changed)
        journal.write(pose(1.0))
    assert load_recording(tmp_path / "log").streams["tip"].rows.time.tolist() == [0.0, 1.0]


FULL = """
import resource, sys
import numpy as np
from glissando.errors import GlissandoError
from glissando.io.journal import Journal
from glissando.model.sensors.sensors import PositionReadings

def at(time, name):
    where = {"time": np.array([time]), "arclength": np.zeros(1), "values": np.zeros((1, 3))}
    return PositionReadings(**where, cov=np.ones(3), name=name)

journal = Journal(sys.argv[1])
journal.write(at(0.0, "other"))
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
try:
    with journal:
        for k in range(10_000):
            journal.write(at(0.1 * k, "tip"))
except GlissandoError as problem:
    print(problem)
Journal(sys.argv[1])  # nothing is locked
"""


@pytest.mark.parametrize("size", [4_001, 9_999])
def test_a_disk_that_is_full_is_one_sentence_and_what_came_before_is_kept(tmp_path, size):
    folder = tmp_path / "log"
    command = [sys.executable, "-c", FULL, str(folder), str(size)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert not done.stderr
    assert f"{folder} cannot be written to (File too large)" in done.stdout
    kept = load_recording(folder).streams
    time = kept["tip"].rows.time
    np.testing.assert_allclose(time, 0.1 * np.arange(time.size), atol=1e-12)
    assert Path(folder, "tip.csv").stat().st_size > size - 60
    assert kept["other"].rows.time.tolist() == [0.0]
