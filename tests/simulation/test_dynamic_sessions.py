"""Sessions of robots with inertia: the command, scenario files, the drive tube, the tracker."""

import csv
import re
from dataclasses import replace

import numpy as np
import pytest

from glissando.cli.main import main
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording
from glissando.io.shipped_robots import robot_file
from glissando.simulation import SlidePath, load_bench
from glissando.simulation.drive_tube import STEP, DriveTube
from glissando.simulation.dynamics.scenario_file import scenario_of
from glissando.simulation.tracker import coil_rows

BENCH = load_bench(robot_file("sliding700"))
PURE = BENCH.flaws.without("all")
BUSY = """
time = [0, 0.1, 0.3]
displacements = [[0, 0], [0.006, 0], [0.002, 0]]
tendon_stiffness = [3000, 3000]
[[loads]]
arclength = 0.7
force = [0, 0.05, 0]
until = 0
[[half_spaces]]
point = [0.12, 0, 0]
normal = [-1, 0, 0]
stiffness = 200
damping = 1
[[holds]]
arclength = 0.5
stiffness = 100
damping = 0.5
from = 0.1
until = 0.2
[base]
time = [0, 0.3]
positions = [[0, 0, 0], [0.05, 0, 0]]
rotations = [[0, 0, 0], [0, 0.2, 0]]
"""


def test_a_dynamic_session_records_inertial_sensors_that_agree_with_its_truth(tmp_path):
    (tmp_path / "busy.toml").write_text(BUSY)
    options = ["--shape", tmp_path / "busy.toml", "--slide", "hold", "--duration", 0.3]
    options += ["--without", "all", "--out", tmp_path / "s"]
    assert main(["simulate", "--dynamic", *map(str, options)]) == 0
    recording = load_recording(tmp_path / "s")
    gyro = recording.streams["gyro_700"].rows
    with (tmp_path / "s" / "truth.csv").open() as file:
        truth = [row for row in csv.DictReader(file) if float(row["arclength"]) == 0.7]
    spin = np.array([[float(row[f"w{a}"]) for a in "xyz"] for row in truth])
    np.testing.assert_allclose(gyro.values, spin, rtol=0.0, atol=1e-6)
    turn = se3.rotation_from_quaternion(
        np.array([[float(row[f"q{a}"]) for a in "wxyz"] for row in truth])
    )
    moved = np.array([[float(row[f"a{a}"]) for a in "xyz"] for row in truth])
    felt = np.loadtxt(tmp_path / "s" / "accelerometer_700.csv", delimiter=",", skiprows=1)
    weight = np.einsum("mji,j->mi", turn, BENCH.gravity)
    np.testing.assert_allclose(felt[:, 2:], moved - weight, rtol=0.0, atol=1e-4)


@pytest.mark.slow
def test_a_slow_dynamic_motion_passes_through_the_static_shapes():
    slow = BENCH.shape("C-to-S").lasting(40.0)
    still = BENCH.move(slow, PURE, 0)
    moved = BENCH.move_dynamically(scenario_of(slow), PURE, 0, 20.0)
    s = np.linspace(0.0, 0.7, 8)
    gap = moved.at(s, 20.0).pose[:, :3, 3] - still.at(s, 20.0).pose[:, :3, 3]
    travel = still.at(0.7, 20.0).pose[:3, 3] - still.at(0.7, 0.0).pose[:3, 3]
    assert np.abs(gap).max() < 0.01 * np.linalg.norm(travel)


def moving(speed, seconds=1.0, rest=1.0):
    """A motor that goes at a speed and then rests."""
    time = np.arange(0.0, seconds + rest, STEP)
    return time, speed * np.minimum(time, seconds)


def test_a_stiff_drive_tube_is_no_drive_tube_and_a_soft_one_lags_by_its_stretch():
    time, motor = moving(0.05)
    stiff = DriveTube(1e7, 2e-3, 0.5, 0.2, 1.5).follow(motor)
    assert np.abs(stiff - motor).max() < 1e-6
    soft = DriveTube(500.0, 2e-3, 0.5, 0.2, 1.0).follow(motor)
    lag = (motor - soft)[time < 0.99][-1]
    assert lag == pytest.approx((0.2 + 0.5 * 0.05) / 500.0, rel=1e-3)
    left = motor[-1] - soft[-1]  # friction holds some of it when the motor stops
    assert abs(left) <= 0.2 / 500.0 + 1e-9


def test_a_coil_that_sticks_moves_by_jerks_and_without_friction_it_does_not():
    _, motor = moving(0.002)
    gritty = DriveTube(200.0, 2e-3, 0.05, 0.1, 2.0).follow(motor)
    speed = np.diff(gritty)[100:3900] / STEP
    assert np.mean(speed == 0.0) > 0.3
    assert speed.max() > 5.0 * 0.002
    smooth = DriveTube(200.0, 2e-3, 0.05, 0.0, 1.0).follow(motor)
    assert np.all(np.diff(smooth)[2000:3900] > 0.0)


def coil(flaws, motion, path):
    time = np.arange(0.5, 1.5, 1 / 40)
    return coil_rows(motion, path, time, 0.0, BENCH.tracker, flaws, np.random.default_rng(0))


def test_latency_shows_the_coil_as_it_was_and_exposure_the_mean_of_its_way():
    motion = BENCH.move(BENCH.shape("C"), PURE, 0)
    path = SlidePath.oscillate(1, 0.05, BENCH.slide, speed=0.02)
    rows = coil(PURE, motion, path)
    for flaws, late in ((replace(PURE, latency=0.03), 0.03), (replace(PURE, exposure=0.05), 0.025)):
        seen = coil(flaws, motion, path)
        then = motion.at(0.7 - path.at(rows.time - late), 0.0).pose[:, :3, 3]
        place = (BENCH.tracker @ seen.values)[:, :3, 3]
        assert np.abs(place - then).max() < 2e-6
        assert np.array_equal(seen.arclength, rows.arclength)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[0.05, 0, 0]]\nrot", "[50, 0, 0]]\nrot", "positions is .*; give metres"),
        ("[0, 0.2, 0]", "[0, 20, 0]", "rotations is .*; give radians"),
        ("[0.006, 0]", "[60, 0]", "displacements is .*; give metres"),
        ("until = 0.2", "until = 0.05", "until is 0.05 s, before from = 0.1 s"),
        ("damping = 1\n", "dampng = 1\n", "did you mean 'damping'"),
        ("tendon_stiffness = [3000, 3000]", "", "tendon_stiffness is missing"),
    ],
)
def test_a_mistake_in_a_scenario_is_one_sentence(tmp_path, capsys, old, new, sentence):
    assert old in BUSY
    (tmp_path / "busy.toml").write_text(BUSY.replace(old, new, 1))
    options = ["--shape", tmp_path / "busy.toml", "--out", tmp_path / "s"]
    assert main(["simulate", "--dynamic", *map(str, options)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(sentence, error)
    assert not (tmp_path / "s").exists()
