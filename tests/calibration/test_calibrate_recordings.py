"""A recording whose tracker stands nobody knows where is calibrated, and says so before."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from scipy.stats import chi2

import rigs_drawn as rigs
from draws import generators, law
from glissando.calibration.rig.calibrate import calibrate
from glissando.calibration.rig.recording_data import calibrated, recording_data
from glissando.calibration.rig.result import Calibration, apply, load_calibration
from glissando.calibration.rig.rig import PARAMETERS, Rig
from glissando.cli.main import main
from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.io.csv_stream import Rows, Stream
from glissando.io.recording import Recording
from glissando.io.recording_folder import load_recording, save_recording
from glissando.io.shipped_robots import robot_file
from glissando.model.tendons.channel import Channel


def recording_of(data, *, thin=1):
    """What import makes of the exports of a rig: arclengths by the encoder, the frame unknown."""
    off = data.travel if data.coil_arclength > 0.65 else -data.travel
    place = data.coil_arclength - np.interp(data.coil_time, data.slide_time, off)
    rows = Rows("coil", data.coil_time, place, data.coil, {})
    streams = {"coil": Stream("coil", rows, keep_repeats=True, frame="tracker")}
    std = np.repeat(data.noise.mocap, 3)
    for name, b in data.bodies.items():
        at = np.full(b.time.size, b.arclength)
        truth = Rows("pose", b.time[::thin], at[::thin], b.poses[::thin], {})
        streams[name] = Stream(name, truth, True, std, b.mount, keep_repeats=True)
    unknown = frozenset({"tracker"})
    return Recording("drawn", Path(), streams, None, None, unknown_frames=unknown)


def off_in_space(recording, shape, seed, mount):
    """RMS distance of the coil's positions from where the simulated robot was, m."""
    rows = recording.streams["coil"].rows
    inside = (rows.time > 0.5) & (rows.time < rigs.DURATION - 0.5)
    at = rigs.motion(shape, seed).at(rows.arclength[inside], rows.time[inside]).pose @ mount
    return np.sqrt(np.mean((at[:, :3, 3] - rows.values[inside, :3, 3]) ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_frame_delay_and_arclength_of_a_recording_are_found_within_their_confidence(seed):
    data, known = rigs.drawn(seed)
    recording, robot = recording_of(data), rigs.robot(rigs.NODES)
    own = recording_data(recording)
    assert own.slides
    found = calibrate(own, robot, readings=rigs.READINGS)
    true = rigs.at_epoch(known, found.rig.epoch)
    off = np.r_[found.rig.minus(true)[:6], found.rig.tracker_clock[0] - true.tracker_clock[0]]
    std = np.r_[found.std[:6], found.std[13]]
    print("off in standard deviations", off / std)
    assert np.all(np.abs(off) < 4.0 * std)
    assert found.std[13] < 5e-3
    made = calibrated(recording, found, own, robot)
    assert not made.unknown_frames
    assert off_in_space(made, "waving", seed, known.coil_mount) < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "pitch"), [(6, np.inf), (7, 0.3)])
def test_zero_and_place_of_a_coils_channel_are_found_within_their_confidence(seed, pitch):
    stated = Channel(0.005, 0.7, pitch)
    found, known, data = rigs.calibrated(seed, channel=stated)
    shown = [k for k, name in enumerate(PARAMETERS) if not name.endswith(("rate", "backlash"))]
    off = found.rig.minus(known)[shown]
    nees = off @ np.linalg.solve(found.cov[np.ix_(shown, shown)], off)
    low, high = chi2.ppf([0.005, 0.995], len(shown))
    assert low < nees < high
    zero, x = PARAMETERS.index("zero"), PARAMETERS.index("mount x")
    assert found.std[zero] < 3e-4
    assert (found.std[x] < 1e-4) == np.isfinite(pitch)  # only a winding one shows its radius
    (coil,) = (s for s in apply(found, data).streams.values() if s.channel)
    assert coil.channel == found.channel == found.rig.channel(data)


def test_a_mount_that_a_recording_states_stays_and_what_is_found_comes_after_it():
    data, known = rigs.drawn(0, "bent", direction=-1)
    recording, robot = recording_of(data), rigs.robot(rigs.NODES)
    stated = se3.exp(np.array([0.005, 0.002, 0.0, 0.05, 0.0, 0.0]))
    streams = recording.streams | {"coil": replace(recording.streams["coil"], mount=stated)}
    recording = replace(recording, streams=streams)
    own = recording_data(recording)
    made = Calibration(known, np.zeros((len(PARAMETERS),) * 2), "coil", np.inf)
    written = calibrated(recording, made, own, robot).streams["coil"]
    np.testing.assert_allclose(written.mount, stated @ known.coil_mount, atol=1e-12)
    inside = np.isin(known.true_time(own.coil_time), written.rows.time)
    np.testing.assert_allclose(written.rows.values, known.T_wt @ own.coil[inside])


def test_a_calibration_file_keeps_the_channel(tmp_path):
    rig = Rig(np.eye(4), -1, 0.7, 0.0)
    made = Calibration(rig, np.eye(len(PARAMETERS)), "coil", 0.0, channel=Channel(0.005, 0.7))
    made.save(tmp_path / "rig.toml")
    assert load_calibration(tmp_path / "rig.toml").channel == made.channel
    assert {"channel radius", "channel angle"} <= {row[0] for row in made.displayed()}


@law
@given(generators)
def test_the_frame_is_printed_with_deviations_in_the_world(rng):
    rig = Rig(se3.exp(rng.standard_normal(6)), 1, 0.7, 0.0)
    root = 1e-3 * rng.standard_normal((len(PARAMETERS), len(PARAMETERS)))
    made = Calibration(rig, root @ root.T, "coil", 0.0)

    def numbers(off):
        pose = rig.T_wt @ se3.exp(off)
        return np.concatenate([pose[:3, 3], se3.so3_log(pose[:3, :3])])

    slope = np.stack([(numbers(d) - numbers(-d)) / 2e-6 for d in 1e-6 * np.eye(6)], axis=1)
    true = np.sqrt(np.diagonal(slope @ made.cov[:6, :6] @ slope.T))
    stated = [std for _, std in made.values().values()][:6]
    # Positions and turns are printed apart, so what couples them does not show.
    np.testing.assert_allclose(stated, true, rtol=1e-5)


def test_a_file_of_a_channel_states_the_mount_in_the_channel_that_was_found(tmp_path):
    rig = Rig(np.eye(4), -1, 0.7, 0.0, mount=np.array([5e-4, -4e-4, 0.01, 0.02]))
    made = Calibration(
        rig, 1e-6 * np.eye(len(PARAMETERS)), "coil", 0.0, channel=Channel(0.005, 0.7)
    )
    made.save(tmp_path / "rig.toml")
    found = load_calibration(tmp_path / "rig.toml")
    np.testing.assert_allclose(found.rig.mount, rig.mount, atol=1e-12)
    (mount,) = (p.value for p in found.sensor_parameters() if p.kind == "mount")
    np.testing.assert_allclose(mount, [0.0, 0.0, 0.0, 0.01, 0.02, 0.0], atol=1e-5)


@pytest.fixture
def folder(tmp_path):
    data, _ = rigs.drawn(0, "bent")
    few = data.at(np.arange(0, data.coil_time.size, 4))
    save_recording(recording_of(few, thin=4), tmp_path / "bench", "sliding700")
    return tmp_path / "bench"


@pytest.mark.slow
def test_an_estimate_asks_for_calibration_and_takes_its_result(folder, capsys, monkeypatch):
    assert main(["estimate", str(folder)]) == 2
    told = capsys.readouterr().err
    assert f"run glissando calibrate {folder}" in told
    assert "frame 'tracker'" in told
    before = (folder / "recording.toml").read_bytes()
    monkeypatch.chdir(folder)
    assert main(["calibrate", ".", "--out", str(folder.parent / "rig.toml")]) == 0
    told = capsys.readouterr().out
    assert "tracker delay" in told
    assert "ms" in told
    kept = folder.with_name("bench.uncalibrated")
    assert (kept / "recording.toml").read_bytes() == before
    listed = tomllib.loads((folder / "recording.toml").read_text())["calibration"]
    assert listed["frame x"]["unit"] == "mm"
    assert listed["tracker delay"]["unit"] == "ms"
    assert all(entry["std"] > 0.0 for entry in listed.values())
    robot = load_recording(folder).robot
    load_recording(folder).readings(["coil"], robot, (0.0, 5.0))
    assert main(["calibrate", str(folder)]) == 2  # the kept one is not overwritten
    told = capsys.readouterr().err
    assert "bench.uncalibrated exists" in told
    assert "give --recording DIR" in told


def test_any_folder_without_a_log_is_a_recording(tmp_path, monkeypatch, capsys):
    """Also one of the public layout, whose robot is the shipped one that fits."""
    data, known = rigs.drawn(0, "bent")
    folder = tmp_path / "public"
    folder.mkdir()
    for name, kind in (("middle", "aurora"), ("tip", "vicon")):
        b = data.bodies[name]
        rows = np.column_stack([b.time, np.full(b.time.size, b.arclength), se3.log(b.poses)])
        text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
        (folder / f"{name}.csv").write_text(f"Sensor Type, {kind}\nTime, Arclength\n{text}\n")
    found = Calibration(known, np.eye(len(PARAMETERS)) * 1e-6, "middle", np.inf)
    found = replace(found, rig=replace(known, zero=0.34))
    monkeypatch.setattr("glissando.cli.calibrate.calibrate", lambda data, robot: found)
    made = tmp_path / "made"
    assert main(["calibrate", str(folder), "--recording", str(made)]) == 0
    again = load_recording(made)
    assert again.robot.name == "sliding700"
    assert set(again.streams) == {"middle", "tip"}
    assert main(["calibrate", str(tmp_path / "nowhere")]) == 2
    assert "There is no recording folder" in capsys.readouterr().err


def test_a_calibrated_recording_has_no_readings_of_a_frozen_tracker():
    data, known = rigs.drawn(0, "bent")
    half = data.coil_time.size // 2
    data.coil[half:] = data.coil[half]
    recording, robot = recording_of(data), rigs.robot(rigs.NODES)
    outer = replace(recording.streams["coil"], name="outer")
    both = replace(recording, streams={**recording.streams, "outer": outer})
    own = recording_data(both, "coil")
    result = Calibration(known, 1e-6 * np.eye(len(PARAMETERS)), "coil", np.inf)
    made = calibrated(both, result, own, robot)
    for name in ("coil", "outer"):
        (read,), lost = made.readings([name], robot, made.span())
        assert len(read) == pytest.approx(half, abs=0.1 * half)
        assert lost[name]["repeated"] > 0.8 * half


@pytest.mark.slow
def test_a_calibrated_recording_can_be_another_one(folder, capsys):
    made = folder.parent / "made"
    assert main(["calibrate", str(folder), "--recording", str(made), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["values"]["tracker delay"]["std"] > 0.0
    assert load_recording(folder).unknown_frames == {"tracker"}
    again = load_recording(made)
    assert not again.unknown_frames
    assert again.streams.keys() == load_recording(folder).streams.keys()
    assert again.robot.name == "sliding700"


def test_a_recording_that_cannot_be_calibrated_says_why(tmp_path):
    data, _ = rigs.drawn(0, "bent")
    recording = recording_of(data)
    alone = replace(recording, streams={"coil": recording.streams["coil"]})
    with pytest.raises(RecordingError, match="no motion capture to calibrate against"):
        recording_data(alone)
    coil = recording.streams["coil"]
    two = replace(recording, streams={**recording.streams, "b": replace(coil, name="b")})
    with pytest.raises(RecordingError, match=r"say with --coil .* coil, b"):
        recording_data(two)
    assert recording_data(two, "b").coil_name == "b"
    gyro = Rows("gyro", coil.rows.time, coil.rows.arclength, np.zeros((len(coil.rows.time), 3)), {})
    beside = replace(recording, streams={**recording.streams, "g": Stream("g", gyro)})
    with pytest.raises(RecordingError, match=r"of coils or poses, .* it has coil\.$"):
        recording_data(beside, "g")


def test_a_fixed_coil_states_no_direction_and_poses_stay_as_noisy_as_their_robot_says():
    data, known = rigs.drawn(0, "bent")
    recording = recording_of(data)
    coil = recording.streams["coil"]
    at = np.full(coil.rows.time.size, 0.65)
    fixed = replace(coil, rows=Rows("pose", coil.rows.time, at, coil.rows.values, {}))
    recording = replace(recording, streams={**recording.streams, "coil": fixed})
    own = recording_data(recording)
    assert own.direction == 0
    robot = replace(rigs.robot(rigs.NODES), sensor_std={"pose": np.repeat([1e-3, 2e-2], 3)})
    result = Calibration(known, 1e-6 * np.eye(len(PARAMETERS)), "coil", np.inf)
    made = calibrated(recording, result, own, robot).streams["coil"]
    assert made.rows.kind == "coil"
    np.testing.assert_array_equal(made.std, [1e-3, 1e-3, 1e-3, 2e-2, 2e-2])


@pytest.mark.parametrize(("end", "beyond"), [(0.7, 2.3e-3), (0.7, 4e-4), (0.0, -3e-3)])
def test_a_fixed_coil_found_beyond_an_end_is_mounted_ahead_of_it(end, beyond):
    data, known = rigs.drawn(0, "bent")
    recording = recording_of(data)
    coil = recording.streams["coil"]
    rows = replace(coil.rows, arclength=np.full(coil.rows.time.size, end))
    streams = {**recording.streams, "coil": replace(coil, rows=rows)}
    own = recording_data(replace(recording, streams=streams))
    rig = replace(known, direction=1, zero=end + beyond)
    result = Calibration(rig, 1e-6 * np.eye(len(PARAMETERS)), "coil", np.inf)
    made = apply(result, own, rigs.robot(rigs.NODES)).streams["coil"]
    assert made.rows.time.size == own.coil_time.size
    np.testing.assert_allclose(made.rows.arclength, end, atol=1e-12)
    ahead = np.eye(4)
    ahead[2, 3] = beyond
    np.testing.assert_allclose(made.mount, ahead @ rig.coil_mount, atol=1e-12)


def test_a_frame_parameter_of_the_robot_stands_for_an_unknown_frame(folder):
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(text.replace('"sliding700"', '"mine.toml"'))
    parameter = '[[sensor_parameters]]\nname = "f"\nkind = "frame"\nstreams = ["coil"]\n'
    parameter += f"std = {[1.0] * 6}\n"
    (folder / "mine.toml").write_text(robot_file("sliding700").read_text() + "\n" + parameter)
    recording = load_recording(folder)
    readings, _ = recording.readings(["coil"], recording.robot, (0.0, 5.0))
    assert len(readings[0])
