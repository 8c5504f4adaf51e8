"""A whole experiment on simulated devices: what is recorded is what happened, whatever happens."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from glissando.calibration.rig.session_data import rig_data
from glissando.cli import record
from glissando.cli.main import main
from glissando.errors import DeviceError, RecordingError
from glissando.evaluation.run import run_estimate
from glissando.hardware.capture import Body, Coil, Rig, load_rig, simulated_rig, write_recording
from glissando.io.recording_folder import load_recording
from glissando.io.session_log import SessionWriter, read_session
from glissando.io.session_recording import session_streams
from glissando.io.shipped_robots import robot_file
from glissando.model.tendons.channel import Channel
from glissando.simulation import SlidePath, load_bench
from glissando.simulation.simulated_session import simulate_session, write_session
from waiting import until

pytestmark = pytest.mark.alone

SETUP = """
name = "bench"
robot = "sliding700"

[tracker]
address = "/dev/ttyUSB0"
position = [0.1, 0, 0]
quaternion = [1, 0, 0, 0]
[[tracker.coils]]
name = "coil"
arclength = 0.70
[[tracker.coils]]
name = "mid"
arclength = 0.35
fixed = true
serial = "3D0A"

[slide]
address = "/dev/ttyUSB1"
lead = 0.0254
stroke = [0.0, 0.06]
standing = 0.0

[mocap]
port = 51001
[[mocap.bodies]]
name = "tip"
arclength = 0.7
position = [0, 0, 0.02]
"""

BODY = '[[mocap.bodies]]\nname = "tube"\nslides = true\n'
OUTER = """
[[slides]]
name = "outer"
protocol = "grbl"
address = "/dev/ttyACM1"
stroke = [0.0, 0.1]
home = 0.0
"""


def test_a_setup_says_which_devices_there_are_and_where(tmp_path):
    file = tmp_path / "bench.toml"
    file.write_text(SETUP)
    rig = load_rig(file)
    assert [c.name for c in rig.coils] == ["coil", "mid"]
    np.testing.assert_allclose(rig.coils[0].arclengths(np.array([0.0, 0.06]), 0.7), [0.70, 0.64])
    np.testing.assert_allclose(rig.coils[1].arclengths(np.array([0.0, 0.06]), 0.7), 0.35)
    assert rig.stage.stroke == (0.0, 0.06)
    assert rig.frame[0, 3] == 0.1
    assert rig.bodies[0].mount[2, 3] == 0.02


def test_a_coil_of_a_setup_may_slide_in_a_channel_and_its_session_says_so(tmp_path):
    file = tmp_path / "bench.toml"
    beside = "arclength = 0.70\n[tracker.coils.channel]\nradius = 0.004\nangle = 0.5\n"
    file.write_text(SETUP.replace("arclength = 0.70\n", beside, 1))
    rig = load_rig(file)
    assert rig.coils[0].channel == Channel(0.004, 0.5)
    assert rig.coils[0].arclengths(np.array([-0.01]), 0.7)[0] == pytest.approx(0.71)
    with SessionWriter(tmp_path / "log.mcap", {"setup": json.dumps(rig.described())}) as log:
        log.add_topic("/tracker/coil", {"type": "object"})
        row = {"time": 0.1, "frame": 1, "position": [0, 0, 0], "quaternion": [1, 0, 0, 0]}
        log.write("/tracker/coil", row, 1)
    session = read_session(tmp_path / "log.mcap")
    (stream,) = session_streams(session, rig.described()).streams
    assert stream.channel == rig_data(session).channel == rig.coils[0].channel
    assert json.loads(json.dumps(rig.described()))["coil_arclength"] == 0.70


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("standing = 0.0", "", "position of the stage is unknown"),
        ("arclength = 0.35", "arclength = 0.95", "off the robot"),
        ("[0.1, 0, 0]", "[100, 0, 0]", "more than 3 m away; give metres"),
        ("[0, 0, 0.02]", "[0, 0, 20]", "more than 1 m away"),
        ("arclength = 0.70", "arclength = 0.70\narclength_std = 2", "arclength_std is 2 m; give"),
        ("stroke = [0.0, 0.06]", "stroke = [-0.01, 0.06]", r"coil at 0.7 m leaves .* by 0.01 m on"),
        ("arclength = 0.70", "arclength = 0.05", r"coil at 0.05 m leaves .* by 0.01 m .* correct"),
        ("standing = 0.0", "home = -2", "Home at -2 m lies far off the stroke"),
        ('address = "/dev/ttyUSB1"', "", "address is missing"),
        ("lead = 0.0254", "leed = 0.0254", "lead is missing"),
        ("lead = 0.0254", "lead = 0.002", "rpm"),
        ("port = 51001", "prot = 51001", "did you mean 'port'"),
        ('name = "mid"', 'name = "coil"', "two coils are 'coil'; give each its own"),
        ('"coil"', '"coil"\nserial = "3D0A"', "two serial numbers of coils are '3D0A'"),
        ("port = 51001", "port = 51001\n" + 2 * BODY, "two bodies are 'tube'"),
        ("[mocap]", 2 * OUTER + "[mocap]", "two slides are 'outer'"),
    ],
)
def test_a_wrong_setup_is_one_sentence(tmp_path, old, new, sentence):
    file = tmp_path / "bench.toml"
    file.write_text(SETUP.replace(old, new))
    with pytest.raises(DeviceError, match=sentence):
        load_rig(file)


def recorded(folder, *options, **popen):
    command = [sys.executable, "-m", "glissando.cli.main", "record", "--simulate", "--out", folder]
    return subprocess.Popen(
        [*map(str, command), *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        **popen,
    )  # fmt: skip


@pytest.mark.slow
def test_devices_change_nothing_a_recording_of_them_is_estimated_as_one_without(tmp_path, capsys):
    folder = tmp_path / "session"
    assert main(["record", "--simulate", "--cycles", "1", "--out", str(folder)]) == 0
    assert "was never seen" not in capsys.readouterr().out
    frames = read_session(folder / "session.mcap").topics["/tracker/coil"].column("frame")
    gaps = np.sort(np.diff(frames) - 1)
    print(
        f"{frames.size} frames while the slide moved, {np.sum(gaps):g} lost, {gaps[-1]:g} at once"
    )
    assert frames.size > 200
    # Beside four busy processes on two cores most runs lose none; a shared host may stand still for
    # a moment, which the longest gap is forgiven for (benchmarks/frames.py says what it was).
    assert np.sum(gaps[:-1]) <= 0.005 * frames.size
    assert gaps[-1] < 20
    recording = load_recording(folder)
    place = recording.streams["coil"].rows.arclength
    assert place.min() == pytest.approx(0.64, abs=5e-4)
    assert place.max() == pytest.approx(0.70, abs=5e-4)
    bench = load_bench(robot_file("sliding700"))
    path = SlidePath.oscillate(1, bench.slide.stroke, bench.slide)
    motion = bench.move(bench.shape("S"), bench.flaws, 0)
    without = []
    for seed in range(8):
        session = simulate_session(bench, motion, path, seed=seed)
        write_session(session, tmp_path / f"{seed}", "sliding700")
        without.append(judged(load_recording(tmp_path / f"{seed}")))
    found, without = judged(recording), np.array(without)
    apart = np.abs(found - without.mean(axis=0)) / without.std(axis=0, ddof=1)
    print("with devices", found, "without", without.mean(axis=0), "apart", apart)
    assert np.all(apart < 5.0)  # of a t with 7 degrees of freedom, 0.1 % each


def judged(recording):
    """RMSE of position (m) and rotation (rad), and NEES of position, where the shape is told."""
    run = run_estimate(recording, recording.robot, window=None, use=["coil"], truth=None)
    inner = [e.summary() for e in run.errors if 0.2 < e.arclength[0] < 0.6]
    told = ("position_rmse", "rotation_rmse", "nees_position")
    return np.array([np.sqrt(np.mean([e[what] ** 2 for e in inner])) for what in told])


@pytest.mark.slow
def test_recorded_calibrated_estimated_the_frame_is_found_and_the_shape_as_good(tmp_path, capsys):
    folder, made = tmp_path / "session", tmp_path / "calibrated"
    call = ["--simulate", "--shape", "C-to-S", "--cycles", "2", "--out", str(folder)]
    assert main(["record", *call]) == 0
    call = ["--out", str(tmp_path / "rig.toml"), "--recording", str(made), "--json"]
    capsys.readouterr()
    assert main(["calibrate", str(folder), *call]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["direction"] == -1
    truth = load_bench(robot_file("sliding700")).tracker[:3, 3]
    for name, true in (("zero", 0.70), *zip(("frame x", "frame y", "frame z"), truth, strict=True)):
        of = found["values"][name]
        assert abs(of["value"] - true) < 4.0 * of["std"] + 1e-4, name
    known, calibrated = judged(load_recording(folder)), judged(load_recording(made))
    print("frame known", known, "calibrated", calibrated)
    assert np.all(calibrated[:2] < 1.2 * known[:2])


@pytest.mark.slow
def test_unplugged_in_mid_session_it_goes_on_and_the_gap_is_told(tmp_path, capsys):
    """The coil first, then the link."""
    folder, faults = tmp_path / "session", "unplug=2.5,replug=3.7,cut=6.5,mended=7.7"
    call = ["record", "--simulate", "--cycles", "2", "--faults", faults, "--out", str(folder)]
    assert main(call) == 0
    told = capsys.readouterr().out
    gaps = re.findall(r"coil was not seen from ([\d.]+) to ([\d.]+) s", told)
    assert len(gaps) == 2, told
    rows = load_recording(folder).streams["coil"].rows
    ends = [0.0, *(float(at) for gap in gaps for at in gap), rows.time[-1]]
    for start, stop in zip(ends[1:-1:2], ends[2:-1:2], strict=True):
        assert 1.0 < stop - start < 4.0
        assert not np.any((rows.time > start + 0.1) & (rows.time < stop - 0.1))
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        assert np.sum((rows.time > start - 0.1) & (rows.time < stop + 0.1)) > 30
    bench = load_bench(robot_file("sliding700"))
    motion = bench.move(bench.shape("S"), bench.flaws, 0)
    true = motion.at(rows.arclength, rows.time).pose[:, :3, 3]
    off = np.linalg.norm(rows.values[:, :3, 3] - true, axis=1)
    after, before = off[rows.time > ends[4]], off[rows.time < ends[1]]
    assert np.median(after) < 2.0 * np.median(before) < 4e-3


@pytest.mark.slow
def test_unplugged_for_good_it_keeps_what_came_and_the_slide_runs_to_its_end(tmp_path, capsys):
    folder = tmp_path / "session"
    call = ["record", "--simulate", "--cycles", "1", "--faults", "unplug=3", "--out", str(folder)]
    assert main(call) == 0
    recording = load_recording(folder)
    last = recording.streams["coil"].rows.time[-1]
    assert f"coil was not seen from {last:.1f} to" in capsys.readouterr().out
    assert recording.streams["mocap_700"].rows.time[-1] > last + 1.0


@pytest.mark.slow
def test_killed_in_mid_session_it_keeps_all_but_the_last_second(tmp_path):
    folder = tmp_path / "session"
    with recorded(folder) as process:
        log = folder / "session.mcap"
        until(lambda: log.exists() and log.stat().st_size > 5000)
        time.sleep(2.0)
        killed = time.monotonic_ns()
        process.kill()
    session = read_session(log)
    assert not session.complete
    for topic in ("/slide", "/tracker/coil", "/mocap/mocap_700"):
        assert killed - session.topics[topic].time_ns[-1] < 1.5e9
        assert np.all(np.diff(session.topics[topic].time_ns) >= 0)


@pytest.mark.slow
def test_a_device_that_fails_ends_the_recording_and_says_what_is_kept(
    tmp_path, capsys, monkeypatch
):
    folder, whole = tmp_path / "session", record._capture_shown

    def fails(*call):
        whole(*call)
        raise DeviceError("The servo is gone.")

    monkeypatch.setattr(record, "_capture_shown", fails)
    call = ["record", "--simulate", "--slide", "hold", "--duration", "1", "--out", str(folder)]
    assert main(call) == 2
    told = capsys.readouterr().err
    assert "what was recorded is kept in" in told
    assert "The servo is gone." in told
    assert len(load_recording(folder).stream("coil").rows.time) > 10


@pytest.mark.slow
def test_interrupted_it_stops_the_slide_and_keeps_the_recording(tmp_path):
    folder = tmp_path / "session"
    with recorded(folder, start_new_session=True) as process:
        log = folder / "session.mcap"
        until(lambda: log.exists() and log.stat().st_size > 5000)
        time.sleep(1.0)
        os.kill(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 1, err
    assert "what was recorded is kept" in out
    session = read_session(log)
    assert session.complete
    recording = load_recording(folder)
    assert len(recording.streams["coil"].rows.time) > 10


def test_what_was_not_seen_is_said_and_an_empty_session_refused(tmp_path):
    coils, bodies = (Coil("coil", 0.7),), (Body("tip", 0.7, np.eye(4)),)
    rig = Rig("bench", "sliding700", coils=coils, bodies=bodies)
    with SessionWriter(tmp_path / "session.mcap", {}):
        pass
    with pytest.raises(RecordingError, match="coil was never seen; tip was never seen"):
        write_recording(read_session(tmp_path / "session.mcap"), rig, tmp_path)


@pytest.mark.slow
def test_a_record_command_without_a_rig_is_one_sentence(tmp_path, capsys):
    assert main(["record", "--out", str(tmp_path / "s")]) == 2
    assert "--setup FILE" in capsys.readouterr().err
    file = tmp_path / "bench.toml"
    file.write_text(SETUP)
    assert main(["record", "--setup", str(file), "--out", str(tmp_path / "s")]) == 2
    assert "/dev/ttyUSB0" in capsys.readouterr().err
    for lasts, said in (("1e12", "a day, 86400 s, at most"), ("0", "A slide of 0 s")):
        call = ["--slide", "hold", "--duration", lasts, "--out", str(tmp_path / "s")]
        assert main(["record", "--setup", str(file), *call]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


@pytest.mark.slow
def test_a_port_that_another_program_took_is_not_asked_for_again(monkeypatch):
    module = sys.modules["glissando.hardware.capture.simulated"]
    choose, given = module._free_port, []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))

        def free_port():
            given.append(taken.getsockname()[1] if len(given) in (1, 3) else choose())
            return given[-1]

        monkeypatch.setattr(module, "_free_port", free_port)
        with simulated_rig("sliding700", "straight") as rig:
            assert rig.slide
    assert len(given) == 5  # the tracker's and the motion capture's second ones were free
