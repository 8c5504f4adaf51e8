"""A posterior of another robot or time than the recording's is refused."""

import shutil

import numpy as np
import pytest

from glissando import Grid, PoseReadings, estimate, load_robot
from glissando.cli.main import main
from glissando.cli.shared import chosen_robot
from glissando.io.netcdf import save_posterior
from glissando.io.recording_folder import load_recording
from glissando.io.shipped_robots import robot_file

pytest.importorskip("h5netcdf")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs") / "rec"
    folder.mkdir()
    truth = "keep_repeats = true\ntruth = true\n"
    streams = f'[[streams]]\nname = "tip"\nkind = "pose"\n{truth}'
    (folder / "recording.toml").write_text('robot = "sliding700"\n' + streams)
    rows = [f"{k / 10},0.7,0,0,0.7,1,0,0,0\n" for k in range(11)]
    (folder / "tip.csv").write_text("time,arclength,x,y,z,qw,qx,qy,qz\n" + "".join(rows))
    return folder


def posterior_of(length, start, file):
    robot = load_robot("sliding700")
    tip = np.eye(4)[None]
    tip[0, 2, 3] = length
    seen = PoseReadings(time=[start], arclength=[length], values=tip, cov=1e-6)
    grid = Grid(np.linspace(0.0, length, 8), start + np.array([0.0, 0.25, 0.5]))
    save_posterior(estimate(robot.prior, grid, [seen]), file)
    return file


@pytest.mark.parametrize(
    ("length", "start", "said"),
    [
        (0.5, 0.0, "is of a robot of 0.5 m, rec of sliding700"),
        (0.7, 50.0, "from 50 to 50.5 s, rec"),
    ],
)
@pytest.mark.parametrize(
    "words",
    [
        "view {file} --recording {rec} --html {file}.html",
        "estimate {rec} --use tip --truth= --start {file}",
        "check {file} --recording {rec}",
    ],
)
def test_a_posterior_of_another_robot_or_time_is_refused(
    recording, tmp_path, capsys, words, length, start, said
):
    file = posterior_of(length, start, tmp_path / "posterior.nc")
    assert main(words.format(file=file, rec=recording).split()) == 2
    assert said in capsys.readouterr().err


def test_a_posterior_is_compared_with_the_readings_that_it_is_of(recording, tmp_path, capsys):
    """Another motion of the same robot at the same time was judged without a word."""
    noisy, other, results = (tmp_path / name for name in ("noisy", "other", "results"))
    for folder in (noisy, other):
        shutil.copytree(recording, folder)
        with (folder / "recording.toml").open("a") as text:
            text.write("std = [1e-3, 0.01]\n")
    rows = (other / "tip.csv").read_text().replace("0.7,0,0,0.7", "0.7,0,0.01,0.69")
    (other / "tip.csv").write_text(rows)
    assert main(f"estimate {noisy} --use tip --truth= --out {results}".split()) == 0
    for folder, named in ((noisy, False), (other, True)):
        main(f"check {results}/posterior.nc --recording {folder} --truth tip".split())
        said = capsys.readouterr().err
        assert ("was estimated from other readings" in said and "tip.csv differ" in said) == named


def test_sensor_parameters_of_streams_that_the_recording_lacks_are_named(
    recording, tmp_path, capsys
):
    file = tmp_path / "mine.toml"
    offset = '\n[[sensor_parameters]]\nname = "{0}"\nkind = "mount"\nstreams = ["{0}"]\n'
    text = robot_file("sliding700").read_text() + offset.format("tip") + offset.format("coil2")
    file.write_text(text)
    chosen_robot(load_recording(recording), str(file))
    assert capsys.readouterr().err == (
        "glissando: warning: sensor parameters of sliding700 are for 'coil', 'coil2', which "
        "rec lacks; its streams are tip.\n"
    )


def test_a_robot_of_another_length_than_the_recordings_own_is_said_to_be(recording, capsys):
    chosen_robot(load_recording(recording), "sliding700")
    assert "long" not in capsys.readouterr().err
    chosen_robot(load_recording(recording), "tdcr466")
    said = "tdcr466 is 0.466 m long, the robot that rec names 0.7 m."
    assert said in capsys.readouterr().err


def test_repeats_that_leave_no_time_are_counted(recording, tmp_path, capsys):
    still = tmp_path / "still"
    shutil.copytree(recording, still)
    text = (still / "recording.toml").read_text().replace("keep_repeats = true\ntruth = true\n", "")
    (still / "recording.toml").write_text(text)
    assert main(["estimate", str(still)]) == 2
    assert "no length (10 rows of tip repeat the one before; keep" in capsys.readouterr().err
