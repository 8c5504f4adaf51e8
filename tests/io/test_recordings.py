import tomllib

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from glissando import Huber, load_robot
from glissando.errors import RecordingError, RobotFileError
from glissando.geometry import se3
from glissando.io.csv_stream import Rows, clean, read_named, steady, write_named
from glissando.io.recording_folder import load_recording
from glissando.io.recording_writer import _value
from glissando.io.shipped_robots import robot_file, shipped_robots
from glissando.model.sensors.sensors import sensor_kinds
from scenes import LENGTH, arc

PUBLIC = "sensor type:,aurora\ntime (s),arclength (m),data\n"
ROW = "{t},{s},0.001,0.002,0.4,0.0{i},0,0\n"


def public_folder(folder, text=None):
    """A folder in the public layout with one tracker at the tip."""
    rows = "".join(ROW.format(t=i / 10, s=LENGTH, i=i % 10) for i in range(10))
    (folder / "aurora1.csv").write_text(PUBLIC + rows if text is None else text)
    return folder


def described_folder(
    folder, toml, columns="time,arclength,x,y,z", row="0,0.1,1,2,3\n1,0.1,4,5,6\n"
):
    (folder / "recording.toml").write_text(toml)
    (folder / "marker.csv").write_text(f"{columns}\n{row}")
    return folder


MARKER = (
    'robot = "tdcr466"\n[[streams]]\nname = "marker"\nkind = "position"\nstd = [1e-3, 1e-3, 1e-3]\n'
)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("time,arclength\n1,2\n", "line 1: the header has no sensor type"),
        ("", "line 1: the header has no sensor type"),
        ("sensor type:,sonar\nx\n", "line 1: unknown sensor type 'sonar'"),
        (PUBLIC, "holds no rows"),
        (PUBLIC + "0,0.4,1,2\n", "line 3: 4 columns where 8 are expected"),
        (PUBLIC + "0,0.4,1,2,3,4,5,x\n", "line 3: 'x' is not a number"),
        (PUBLIC + "0,0.4,1,2,3,4,5,nan\n", "line 3: a value is not finite"),
        (
            PUBLIC + "1,0.4,1,2,3,4,5,6\n\n0.5,0.4,1,2,3,4,5,6\n",
            "line 5: time goes back from 1 to 0.5 s",
        ),
    ],
)
def test_a_bad_stream_is_named_with_its_line(tmp_path, text, sentence):
    with pytest.raises(RecordingError, match=sentence):
        load_recording(public_folder(tmp_path, text))


def test_missing_folders_and_streams_are_named(tmp_path):
    with pytest.raises(RecordingError, match="There is no recording folder"):
        load_recording(tmp_path / "nowhere")
    with pytest.raises(RecordingError, match="no CSV stream"):
        load_recording(tmp_path)
    recording = load_recording(public_folder(tmp_path))
    with pytest.raises(RecordingError, match="no stream 'aurora7'; it has aurora1"):
        recording.readings(["aurora7"], recording.robot, (0, 1))
    (tmp_path / "recording.toml").write_text('[[streams]]\nname = "gone"\nkind = "gyro"\n')
    with pytest.raises(RecordingError, match=r"gone.csv cannot be read"):
        load_recording(tmp_path)


def test_an_arclength_off_the_robot_names_rows_and_excess(tmp_path):
    rows = "".join(ROW.format(t=i, s=LENGTH + 0.01 * (i in (3, 7)), i=i) for i in range(9))
    recording = load_recording(public_folder(tmp_path, PUBLIC + rows))
    with pytest.raises(RecordingError, match=r"2 rows lie outside.*rows 3, 7.*up to 0.01 m beyond"):
        recording.readings(["aurora1"], load_robot("tdcr466"), (0, 9))


@given(
    seed=st.integers(0, 2**32 - 1),
    off=st.floats(-1.8e-3, 1.8e-3),
    asked=st.floats(0.008, 0.02),
    phase=st.floats(0.0, 1.0),
)
def test_a_steady_tracker_asked_too_fast_gets_its_own_times_back(seed, off, asked, phase):
    """However both clocks stand, and with frames that were never picked up.

    Unless it is asked in step with it: lateness then drifts as slowly as clocks do.
    """
    ticks = asked / (0.025 * (1.0 + off)) * np.arange(1, 7)
    assume(np.abs(ticks - np.round(ticks)).min() > 0.003)
    rng = np.random.default_rng(seed)
    made = (np.arange(1000) + phase) * 0.025 * (1.0 + off)
    made = made[rng.random(made.size) > 0.02]
    host = np.arange(made[0] + 0.03, made[-1], asked)
    newest = np.searchsorted(made, host, side="right") - 1
    values = np.tile(np.eye(4), (host.size, 1, 1))
    values[:, 0, 3] = newest
    rows = clean(Rows("pose", host, np.zeros(host.size), values, {}))
    assume(host.size > 1.1 * rows.time.size)
    late = rows.time - made[rows.values[:, 0, 3].astype(int)]
    better = steady(rows, 40.0).time - made[rows.values[:, 0, 3].astype(int)]
    np.testing.assert_allclose(better[1:], late.mean(), atol=1.5e-3)  # the first may be old
    assert better[1:].std() < 0.25 * late[1:].std()


def test_rows_that_were_not_asked_for_too_fast_keep_their_times():
    rows = Rows("pose", np.arange(5.0), np.zeros(5), np.tile(np.eye(4), (5, 1, 1)), {})
    assert steady(rows, 40.0) is rows


def test_stamps_of_no_steady_device_are_said_to_be_none():
    time = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.2, 400))
    rows = Rows("pose", time, np.zeros(400), np.tile(np.eye(4), (400, 1, 1)), {"repeated": 1})
    with pytest.raises(RecordingError, match="measures 40 times a second; correct or leave out"):
        steady(rows, 40.0)


MOVES = np.tile(np.eye(4), (4, 1, 1))
MOVES[1:, 0, 3] = [0.0, 1.0, 1.0]
TURNS = np.diag([0.0, -5.0, 0.0, 0.0])[:, :3]


@pytest.mark.parametrize(
    ("kind", "values", "options", "dropped"),
    [
        ("pose", MOVES, {}, {"repeated": 2}),
        ("pose", MOVES, {"keep_repeats": True}, {}),
        ("orientation", MOVES[:, :3, :3], {}, {"repeated": 1}),  # straight: alike at many places
        ("gyro", TURNS, {"clip": 5.0}, {"clipped": 1}),
        ("gyro", TURNS, {}, {}),
    ],
)
def test_repeats_of_a_tracker_and_clipped_samples_are_dropped_and_counted(
    kind, values, options, dropped
):
    rows = Rows(kind, np.arange(4.0), np.array([0.1, 0.2, 0.2, 0.3]), values, {})
    kept = clean(rows, **options)
    assert kept.dropped == dropped
    assert len(kept.time) == 4 - sum(dropped.values())


@pytest.mark.parametrize("kind", sensor_kinds())
def test_what_is_written_is_read_back(tmp_path, kind):
    rng = np.random.default_rng(0)
    time, place = 1.7e9 + np.sort(rng.random(6)), np.linspace(0.1, 0.4, 6)
    pose = arc(place, time - 1.7e9) @ se3.exp(rng.standard_normal((6, 6)))
    three = dict.fromkeys(("position", "gyro", "accelerometer"), 3)
    width = {**three, "strain": 6, "fbg": 4, "tendon": 8}.get(kind, 0)
    values = {"pose": pose, "coil": pose, "orientation": pose[:, :3, :3]}.get(
        kind, rng.standard_normal((6, width))
    )
    settings = {
        "fbg": {"core_radius": np.zeros(4), "core_angle": np.zeros(4)},
        "tendon": {"radius": np.ones(4), "compliance": np.ones(4)},
    }.get(kind, {})
    write_named(tmp_path / "a.csv", Rows(kind, time, place, values, {}, settings))
    rows = read_named(tmp_path / "a.csv", kind, settings)
    assert rows.time.tolist() == time.tolist()
    assert rows.values == pytest.approx(values, abs=1e-9)
    assert rows.arclength == pytest.approx(place)


def test_units_and_frames_are_turned_into_the_world(tmp_path):
    toml = MARKER + (
        'length_unit = "mm"\nframe = "camera"\n[frames.camera]\nposition = [0, 0, 1]\n'
        "quaternion = [0.70710678, 0, 0, 0.70710678]\n"
    )
    described_folder(tmp_path, toml, row="0,100,1000,0,0\n1,100,2000,0,0\n")
    recording = load_recording(tmp_path)
    (found,), _ = recording.readings(["marker"], recording.robot, (0, 2))
    assert found.values == pytest.approx(np.array([[0, 1, 1], [0, 2, 1.0]]), abs=1e-6)
    assert found.arclength == pytest.approx([0.1, 0.1])


@pytest.mark.parametrize(
    ("toml", "sentence"),
    [
        (MARKER.replace("kind", "kinf"), r"kind is missing; give one of"),  # codespell:ignore kinf
        (MARKER.replace("position", "sonar"), "kind is 'sonar'; give one of .*pose"),
        (MARKER + 'frame = "camera"\n', "frame is 'camera'; give one of world"),
        (MARKER.replace("1e-3]", "-1]"), "std is .* above zero"),
        (MARKER + "tru = true\n", "tru is not a key.*did you mean 'truth'"),  # codespell:ignore tru
        (MARKER.replace("tdcr466", "tdcr999"), "no robot named 'tdcr999'"),
        ("streams = 3", "must be an array of tables"),
        ("", "names no"),
        ("x = [", "is not valid TOML"),
    ],
)
def test_a_bad_description_names_the_key(tmp_path, toml, sentence):
    with pytest.raises((RecordingError, RobotFileError), match=sentence):
        load_recording(described_folder(tmp_path, toml))


def test_columns_may_stand_in_any_order_but_must_be_there(tmp_path):
    described_folder(tmp_path, MARKER, "z,y,x,arclength,time", "3,2,9,0.1,0\n6,5,4,0.1,1\n")
    rows = load_recording(tmp_path).streams["marker"].rows
    assert (rows.values[0].tolist(), rows.time.tolist()) == ([9, 2, 3], [0, 1])
    for columns, row, sentence in (
        ("time,arclength,x,y", "0,0.1,1,2\n", r"needs the columns .*; z is missing"),
        (
            "x,y,z,arclength,time",
            "1,2,3,0.1,1\n2,5,6,0.1,0\n",
            "line 3: time goes back from 1 to 0 s",
        ),
        ("time,arclength,x,y,z,x", "0,0.1,1,2,3,4\n", "column x stands there twice"),
    ):
        described_folder(tmp_path, MARKER, columns, row)
        with pytest.raises(RecordingError, match=sentence):
            load_recording(tmp_path)


def test_a_stream_given_twice_is_refused(tmp_path):
    described_folder(tmp_path, MARKER + MARKER[MARKER.index("[[") :])
    with pytest.raises(RecordingError, match="'marker' is given twice"):
        load_recording(tmp_path)


def test_a_truth_stream_used_as_a_sensor_has_a_sensors_noise(tmp_path):
    toml = 'robot = "tdcr466"\n[[streams]]\nname = "marker"\nkind = "position"\ntruth = true\n'
    recording = load_recording(described_folder(tmp_path, toml))
    (judge,), _ = recording.readings(["marker"], recording.robot, (0, 1), as_truth=True)
    assert np.sqrt(judge.cov[0, 0]) < 1e-5
    with pytest.raises(RecordingError, match="states the noise of a position sensor"):
        recording.readings(["marker"], recording.robot, (0, 1))


def test_naming_a_stream_twice_uses_it_once(tmp_path):
    recording = load_recording(public_folder(tmp_path))
    assert recording.choose(["aurora1", "aurora1"], None)[0] == ["aurora1"]


def test_units_reach_strains_and_fibre_cores(tmp_path):
    (tmp_path / "recording.toml").write_text(
        'robot = "tdcr466"\n[[streams]]\nname = "f"\nkind = "fbg"\nlength_unit = "mm"\n'
        'angle_unit = "deg"\ncore_radius = [1.0]\ncore_angle = [180]\nstd = [1e-6]\n'
        '[[streams]]\nname = "s"\nkind = "strain"\nlength_unit = "mm"\nstd = [1, 1]\n'
    )
    (tmp_path / "f.csv").write_text("time,arclength,strain_0\n0,300,0.002\n")
    (tmp_path / "s.csv").write_text(
        "time,arclength,nu_x,nu_y,nu_z,u_x,u_y,u_z\n0,300,0,0,1,0,0.002,0\n"
    )
    recording = load_recording(tmp_path)
    (fibre, strain), _ = recording.readings(["f", "s"], recording.robot, (0, 1))
    assert fibre.core_radius == pytest.approx([1e-3])
    assert fibre.core_angle == pytest.approx([np.pi])
    assert fibre.arclength == pytest.approx([0.3])
    assert strain.values[0] == pytest.approx([0, 0, 1, 0, 2.0, 0])


def test_a_quaternion_that_is_not_unit_is_refused(tmp_path):
    (tmp_path / "recording.toml").write_text('[[streams]]\nname = "p"\nkind = "coil"\n')
    (tmp_path / "p.csv").write_text("time,arclength,x,y,z,qw,qx,qy,qz\n0,0.1,0,0,0,1,1,0,0\n")
    with pytest.raises(RecordingError, match=r"line 2: the quaternion has norm 1\.41"):
        load_recording(tmp_path)
    rows = "\n\n0,0.1,0,0,0,1,0,0,0\n\n1,0.1,0,0,0,2,0,0,0\n"
    (tmp_path / "p.csv").write_text("time,arclength,x,y,z,qw,qx,qy,qz" + rows)
    with pytest.raises(RecordingError, match="line 5: the quaternion has norm 2"):
        load_recording(tmp_path)


@pytest.mark.parametrize("name", shipped_robots())
def test_shipped_robots_load(name):
    robot = load_robot(name)
    assert robot.grid(0.0, 1.0).arclength[-1] == robot.length


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("length = 0.466", "lenght = 0.466", "length is missing"),  # codespell:ignore lenght
        ("length = 0.466", "length = -1", "length is -1; give a number above zero"),
        ("length = 0.466", 'length = "long"', "length is 'long'"),
        ("time_rate = 30.0", "", r"\[grid\]: time_rate is missing"),
        ("arclength_nodes = 5", "arclength_nodes = 1", "whole number from 2 up"),
        ("arclength_nodes = 5", "arclength_nodes = [0, 0.2]", "end it at the length"),
        ("arclength_nodes = 5", "arclength_nodes = [0.1, 0.466]", "must begin at 0"),
        ("psd_pose = [4e-7, 5e-6]", "psd_pose = [1, 2, 3]", "give 6 numbers, or 2 for"),
        ("psd_pose = [4e-7, 5e-6]", "psd_pose = [0, 1]", "above zero"),
        ('kind = "white-noise"', 'kind = "magic"', "give one of white-noise"),
        ("quaternion = [1, 0, 0, 0]", "quaternion = [1, 1, 0, 0]", "has norm 1.414"),
        ("clip = 5.0", 'loss = "hubris"', "loss is 'hubris'; give one of none, huber"),
        ("[sensors.gyro]", "[sensors.nose]", r"\[sensors.nose\] is not a kind of sensor"),
        ("[prior]", "[prior]\npsd_velocity_tim = [1, 1]", "did you mean 'psd_velocity_time'"),
        ("[prior]", "[prier]", r"\[prior\] is missing"),
    ],
)
def test_a_bad_robot_file_names_the_key(tmp_path, old, new, sentence):
    text = robot_file("tdcr466").read_text()
    assert old in text
    path = tmp_path / "robot.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(RobotFileError, match=sentence):
        load_robot(path)


def test_a_robust_loss_is_set_in_the_robot_file(tmp_path):
    text = robot_file("tdcr466").read_text()
    path = tmp_path / "robot.toml"
    path.write_text(text.replace("clip = 5.0", 'clip = 5.0\nloss = "huber"\nthreshold = 2.0'))
    robot = load_robot(path)
    assert robot.sensor_loss == {"gyro": Huber(2.0)}


def test_a_robot_without_a_base_is_allowed(tmp_path):
    path = tmp_path / "free.toml"
    psd = "\n".join(
        f"psd_{n} = [1, 1]"
        for n in ("velocity_time", "strain_arclength", "strain_time", "velocity_arclength")
    )
    path.write_text(
        f"length = 1\n[grid]\narclength_nodes = 3\ntime_rate = 5\n[prior]\n{psd}\n"
        'kind = "white-noise"\n'
    )
    robot = load_robot(path)
    assert robot.prior.base is None
    assert robot.name == "free"


def test_a_setting_without_an_end_is_read_back():
    text = _value(np.array([1.0, np.inf, -np.inf]))
    assert tomllib.loads(f"limit = {text}") == {"limit": [1.0, np.inf, -np.inf]}
