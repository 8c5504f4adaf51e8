"""Foreign files become recordings: what was put into a file is what comes out of it, in SI."""

import json
import re
import sys
import tomllib

import ezc3d
import numpy as np
import pytest
from hypothesis import given
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from draws import generators, law, poses
from glissando import cli, se3
from glissando.dataset import load_recording
from glissando.errors import GlissandoError, RecordingError
from glissando.interchange import Choices, Track, read_tracks, write_recording
from glissando.robot import robot_file


def run(*arguments):
    return cli.main([str(a) for a in arguments])


def tracker_csv(path, tracks, frames=None, unit="rad"):
    """A Tracker CSV of poses by name, missing where NaN; rotations by SciPy's rotation vectors."""
    count = len(next(iter(tracks.values())))
    heads = [""] * 2
    for name in tracks:
        heads += [f"Global Angle {name}:{name}"] + [""] * 5
    lines = ["Objects", str(len(tracks)), ",".join(heads)]
    lines += [",".join(["Frame", "Sub Frame", *["RX", "RY", "RZ", "TX", "TY", "TZ"] * len(tracks)])]
    lines += [",".join(["", "", *[*[unit] * 3, *["mm"] * 3] * len(tracks)])]
    for k in range(count):
        cells = [str(k + 1 if frames is None else frames[k]), "0"]
        for track in tracks.values():
            if np.isnan(track[k, 0, 3]):
                cells += [""] * 6
                continue
            turn = Rotation.from_matrix(track[k, :3, :3]).as_rotvec(degrees=unit == "deg")
            cells += [repr(float(v)) for v in [*turn, *(1e3 * track[k, :3, 3])]]
        lines.append(",".join(cells))
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def ndi_csv(path, tools, frames, *, clock=None, markers=0):
    """An NDI CSV of poses by name, 'Missing' where NaN."""
    seen = ["State", "Tx", "Ty", "Tz"] * markers
    block = ["Frame", *(["Time [sec]"] if clock is not None else []), "Face", "State"]
    block += ["Q0", "Qx", "Qy", "Qz", "Tx", "Ty", "Tz", "Error", *["Markers"] * bool(markers)]
    heads = ["Tools"]
    for port, name in enumerate(tools, start=1):
        heads += [f"Port 0x{port:02X}: {name}  s/n:3E4C880C", *block, *seen]
    lines = [",".join(heads)]
    for k, frame in enumerate(frames):
        cells = [str(len(tools))]
        for port, (name, track) in enumerate(tools.items(), start=1):
            cells += [f"Port 0x{port:02X}: {name}  s/n:3E4C880C", str(frame)]
            cells += [repr(float(clock[k])), "1"] if clock is not None else ["1"]
            if np.isnan(track[k, 0, 3]):
                cells += ["Missing", *["-3.697314E28"] * 7, "0.0"]
            else:
                x, y, z, w = Rotation.from_matrix(track[k, :3, :3]).as_quat()
                cells += ["OK", *(repr(float(v)) for v in [w, x, y, z, *(1e3 * track[k, :3, 3])])]
                cells += ["0.1"]
            cells += [str(markers)] * bool(markers) + ["OK", "9", "8", "7"] * markers
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path


def hole(track, *rows):
    track = track.copy()
    track[list(rows)] = np.nan
    return track


@law
@given(generators)
def test_a_tracker_csv_is_read_back_with_helical_rotations_and_gaps(tmp_path_factory, rng):
    tip, mid = poses(rng, 6, largest_angle=np.pi), poses(rng, 6)
    unit = ("rad", "deg")[rng.integers(2)]
    file = tmp_path_factory.mktemp("f") / "take.csv"
    tracker_csv(file, {"Tip": hole(tip, 2, 5), "my mid": mid}, unit=unit)
    found = {t.name: t for t in read_tracks(file, rate=200.0)}
    assert list(found) == ["Tip", "my_mid"]
    np.testing.assert_allclose(found["Tip"].values, tip[[0, 1, 3, 4]], atol=1e-12)
    np.testing.assert_allclose(found["my_mid"].values, mid, atol=1e-12)
    np.testing.assert_allclose(found["Tip"].time, np.array([0, 1, 3, 4]) / 200)
    assert (found["Tip"].missing, found["my_mid"].missing, found["Tip"].kind) == (2, 0, "pose")


@law
@given(generators)
def test_an_ndi_csv_is_read_back_by_its_frame_numbers(tmp_path_factory, rng):
    tip, ref = poses(rng, 5, largest_angle=np.pi), poses(rng, 5)
    frames = 650512279 + np.array([0, 1, 1, 4, 5])  # polled twice, then two lost
    file = tmp_path_factory.mktemp("f") / "track.csv"
    ndi_csv(file, {"Tip coil": hole(tip, 3), "Ref": ref}, frames, markers=int(rng.integers(3)))
    coil, other = read_tracks(file, rate=40.0)
    assert (coil.name, coil.kind, coil.frame, coil.missing) == ("Tip_coil", "coil", "tracker", 1)
    np.testing.assert_allclose(coil.time, np.array([0, 1, 5]) / 40)
    np.testing.assert_allclose(coil.values, tip[[0, 1, 4]], atol=1e-12)
    np.testing.assert_allclose(other.values, ref[[0, 1, 3, 4]], atol=1e-12)


def test_an_ndi_csv_has_its_own_clock_where_no_rate_is_given(tmp_path):
    rng = np.random.default_rng(0)
    clock = 1778067471.318767388 + np.array([0, 0.025, 0.051])
    file = ndi_csv(tmp_path / "a.csv", {"Tip": poses(rng, 3)}, [7, 8, 9], clock=clock)
    (track,) = read_tracks(file)
    assert track.absolute
    np.testing.assert_array_equal(track.time, clock)
    (track,) = read_tracks(file, rate=40.0)
    assert not track.absolute
    np.testing.assert_allclose(track.time, [0, 0.025, 0.05])


def test_one_tool_without_a_port_in_any_order_of_columns(tmp_path):
    file = tmp_path / "tip tool.csv"
    file.write_text(
        "Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,State,Frame#\n"
        "1,0,0,0,1,2,3,0.1,OK,10\n"
        "1,0,0,0,1,2,4,0.1,Missing,11\n"
        "1,0,0,0,1,2,4,0.1\n"
        "1,0,0,0,1,2,5,0.1,OK,12\n"
    )
    (track,) = read_tracks(file, rate=40.0)
    assert track.name == "tip_tool"
    assert track.time.tolist() == [0.0, 0.05]
    assert track.values[:, :3, 3].tolist() == [[0.001, 0.002, 0.003], [0.001, 0.002, 0.005]]
    assert track.missing == 2


NEXUS = """Trajectories
100
,,Snake:Tip,,,Snake:Mid,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
1,0,1,2,3,4,5,6
2,0,,,,7,8,9
3,0,10,11,12

Devices
1000
,,Force
Frame,Sub Frame,Fx
,,N
1,0,1.5
1,1,1.6

Segments
100
,,Snake:Snake,,,,,
Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ
,,deg,deg,deg,mm,mm,mm
5,0,0,90,0,100,0,0
"""


def test_nexus_sections_are_read_with_the_rate_they_state(tmp_path):
    (tmp_path / "trial.csv").write_text(NEXUS)
    tip, mid, snake = read_tracks(tmp_path / "trial.csv")
    assert (tip.name, mid.name, snake.name) == ("Snake_Tip", "Snake_Mid", "Snake")
    assert tip.time.tolist() == [0.0, 0.02]
    assert tip.values.tolist() == [[0.001, 0.002, 0.003], [0.01, 0.011, 0.012]]
    assert (tip.kind, tip.missing, mid.missing) == ("position", 1, 1)
    assert snake.time.tolist() == [0.04]
    np.testing.assert_allclose(snake.values[0, :3, 2], [1, 0, 0], atol=1e-15)  # z turned onto x


@pytest.mark.parametrize("unit", ["mm", "m", "cm"])
def test_c3d_points_are_read_back_in_their_units_without_gaps(tmp_path, unit):
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (2, 20, 3))  # m
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [120.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["tip", "mid one"]
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    written = np.ones((4, 2, 20))
    written[:3] = np.moveaxis(points, 2, 0) / {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[unit]
    residual = np.zeros((1, 2, 20))
    residual[0, 0, 4], written[:3, 1, 6] = -1.0, np.nan
    file["data"]["points"], file["data"]["meta_points"]["residuals"] = written, residual
    file.write(str(tmp_path / "trial.c3d"))
    tip, mid = read_tracks(tmp_path / "trial.c3d")
    (tmp_path / "trial.c3d").rename(tmp_path / "unnamed.dat")
    assert len(read_tracks(tmp_path / "unnamed.dat")) == 2  # known by what stands in it
    assert (tip.name, mid.name, tip.missing, mid.missing) == ("tip", "mid_one", 1, 1)
    np.testing.assert_allclose(tip.values, np.delete(points[0], 4, axis=0), atol=1e-6)
    np.testing.assert_allclose(mid.time, np.delete(np.arange(20), 6) / 120)


def bag(path, version, rng, storage=StoragePlugin.SQLITE3):
    """A bag of a PoseStamped, a TransformStamped and a text topic; poses and stamps in ns."""
    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    types = store.types
    more = {"seq": 0} if version == 1 else {}
    stamps = 1778067471_000000000 + np.cumsum(rng.integers(1, 10**8, 5))
    track = poses(rng, 5, largest_angle=np.pi)
    encode = store.serialize_ros1 if version == 1 else store.serialize_cdr
    made = Bag1(path) if version == 1 else Bag2(path, version=9, storage_plugin=storage)
    with made as out:
        kinds = {"/vicon/tip": "PoseStamped", "/vicon/mid": "TransformStamped"}
        for topic, kind in kinds.items():
            kind = f"geometry_msgs/msg/{kind}"
            connection = out.add_connection(topic, kind, typestore=store)
            for at, pose in zip(stamps.tolist(), track, strict=True):
                time = types["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9)
                header = types["std_msgs/msg/Header"](stamp=time, frame_id="aurora", **more)
                x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
                turn = types["geometry_msgs/msg/Quaternion"](x, y, z, w)
                if topic.endswith("tip"):
                    place = types["geometry_msgs/msg/Point"](*pose[:3, 3])
                    inner = types["geometry_msgs/msg/Pose"](place, turn)
                    message = types[kind](header, inner)
                else:
                    place = types["geometry_msgs/msg/Vector3"](*pose[:3, 3])
                    inner = types["geometry_msgs/msg/Transform"](place, turn)
                    message = types[kind](header, "mid", inner)
                for late in (10**6, 2 * 10**6):  # each stamp comes twice
                    out.write(connection, at + late, encode(message, kind))
        talk = out.add_connection("/talk", "std_msgs/msg/String", typestore=store)
        message = types["std_msgs/msg/String"]("hello")
        out.write(talk, int(stamps[0]), encode(message, "std_msgs/msg/String"))
    return track, stamps


@pytest.mark.parametrize(
    ("version", "storage"), [(1, None), (2, StoragePlugin.SQLITE3), (2, StoragePlugin.MCAP)]
)
def test_pose_topics_of_a_bag_are_read_back_with_their_stamps(tmp_path, version, storage):
    path = tmp_path / ("run.bag" if version == 1 else "run")
    track, stamps = bag(path, version, np.random.default_rng(version), storage)
    tip, mid = sorted(read_tracks(path), key=lambda t: t.name, reverse=True)
    assert (tip.name, mid.name, tip.frame) == ("vicon_tip", "vicon_mid", "aurora")
    for found in (tip, mid):
        np.testing.assert_allclose(found.values, track, atol=1e-12)
        np.testing.assert_allclose(found.time, stamps * 1e-9, atol=1e-6, rtol=0)
    (only,) = read_tracks(path, topics=["/vicon/mid"])
    assert only.name == "vicon_mid"
    with pytest.raises(RecordingError, match=r"no pose topic /talk; those .* /vicon/tip"):
        read_tracks(path, topics=["/talk"])


def test_a_mutilated_text_file_is_read_or_refused_with_a_sentence(tmp_path):
    rng = np.random.default_rng(0)
    whole = [
        tracker_csv(tmp_path / "a.csv", {"tip": poses(rng, 4), "mid": poses(rng, 4)}).read_bytes(),
        ndi_csv(tmp_path / "b.csv", {"tip": poses(rng, 4)}, [1, 2, 3, 4], markers=1).read_bytes(),
        NEXUS.encode(),
    ]
    refused = read = 0
    for trial in range(1500):
        data = bytearray(whole[trial % 3])
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.choice(list(b",\n,;.x0-9e\xff\x00 S"))
        (tmp_path / "c.csv").write_bytes(data[: rng.integers(len(data) // 3, len(data) + 1)])
        try:
            for found in read_tracks(tmp_path / "c.csv", rate=100.0):
                assert np.all(np.isfinite(found.time))
                assert np.all(np.isfinite(found.values))
                assert np.all(np.diff(found.time) > 0)
                assert len(found.time) == len(found.values)
            read += 1
        except RecordingError:
            refused += 1
    assert min(read, refused) > 150


def text(content):
    def write(folder):
        (folder / "take.csv").write_text(content)
        return folder / "take.csv"

    return write


HEADS = "Objects\n100\n,,Tip\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,rad,rad,rad,mm,mm,mm\n"
TOOL = "Port 1,Frame,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error\n"


@pytest.mark.parametrize(
    ("file", "rate", "sentence"),
    [
        (text("a,b\n1,2\n"), None, "is of no known kind (it begins with 'a,b'); known are CSV of"),
        (text(""), None, "is of no known kind"),
        (text("time,arclength,x\n"), None, "is a recording's stream already"),
        (text(HEADS), None, "frame rate cannot be trusted (line 2 says '100')"),
        (text(HEADS), -1.0, "A rate of -1 Hz cannot be"),
        (text("Objects\n1\n,,Tip\n"), 100.0, "Objects end before their units"),
        (text(HEADS.replace("mm", "inch")), 100.0, "the units of 'Tip' are not m, cm, mm"),
        (text(HEADS + "1,0,0,0,0,1,2,3\n2,0,0,0,x,1,2,3\n"), 100.0, "line 7: '0,0,x,1,2,3' is not"),
        (text(HEADS + "9,0,0,0,0,1,2,3\n2,0,0,0,0,1,2,3\n"), 100.0, "line 7: frame 2 follows fra"),
        (text("Devices\n\nTrajectories\n10\n,,\nF,S\n,,\n1,0\n"), 9.0, "is of no known kind"),
        (text("Trajectories\n10\n,,A\nFrame,Sub Frame,Fx\n,,N\n1,0,3\n"), None, "holds no objects"),
        (text("Trajectories\nfast\n,,A\nF,S,X,Y,Z\n,,mm,mm,mm\n"), None, "says 'fast'"),
        (text(TOOL), 40.0, "holds no rows"),
        (text(TOOL + "P,1,OK,1,0,0,0,1,2,3,0\n"), None, "has no times; give the rate"),
        (text(TOOL + "P,1,OK,1,0,y,0,1,2,3,0\n"), 40.0, "line 2: '1,0,y,0,1,2,3' is not all num"),
        (text(TOOL + "P,2,,1,0,0,0,1,2,3\nP,1,,1,0,0,0,1,2,3\n"), 40.0, "line 3: frame 1 follows"),
        (text(TOOL.strip() + ",Port 2,Frame\nP,1\n"), 40.0, "'Port 2' lacks the columns q0, qx"),
        (lambda f: f / "none.csv", None, "There is no file"),
        (lambda f: f / "none.bag", None, "cannot be read as a ROS bag"),
    ],
)
def test_a_file_that_cannot_be_imported_says_why(tmp_path, file, rate, sentence):
    with pytest.raises(RecordingError, match=re.escape(sentence)):
        read_tracks(file(tmp_path), rate=rate)


def test_broken_binary_files_say_so(tmp_path):
    (tmp_path / "bad.c3d").write_bytes(b"\x02\x50 and no more")
    with pytest.raises(RecordingError, match=r"bad\.c3d cannot be read as c3d"):
        read_tracks(tmp_path / "bad.c3d")
    (tmp_path / "bad.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    with pytest.raises(RecordingError, match="cannot be read as a ROS bag"):
        read_tracks(tmp_path / "bad.bag")
    (tmp_path / "run_0.db3").write_bytes(b"SQLite format 3")
    with pytest.raises(RecordingError, match="give the folder that it is in"):
        read_tracks(tmp_path / "run_0.db3")


@pytest.mark.parametrize(
    ("package", "file", "extra"),
    [("ezc3d", "a.c3d", "hardware"), ("rosbags.highlevel", "a.bag", "ros")],
)
def test_a_missing_package_names_the_extra(tmp_path, monkeypatch, package, file, extra):
    monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / file).write_bytes(b"")
    with pytest.raises(GlissandoError, match=rf"pip install 'glissando\[{extra}\]'"):
        read_tracks(tmp_path / file)


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
    assert "# Fill in where each frame" in (tmp_path / "out" / "recording.toml").read_text()


def test_times_since_1970_begin_at_the_first_of_them(tmp_path):
    early, late = track("a", absolute=True), track("b", absolute=True)
    early = Track(**{**vars(early), "time": early.time + 1.7e9})
    late = Track(**{**vars(late), "time": late.time + 1.7e9 + 3.0})
    write_recording([late, early], tmp_path / "out", Choices({"a": 0.1, "b": 0.2}))
    streams = load_recording(tmp_path / "out").streams
    np.testing.assert_allclose(streams["a"].rows.time, np.arange(5) / 10, atol=1e-6)
    np.testing.assert_allclose(streams["b"].rows.time, np.arange(5) / 10 + 3, atol=1e-6)


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
        (["--arclength", "tip"], "'tip' is no NAME=VALUE"),
        (["--arclength", "tip=far"], "'far' is not a number"),
        (["--arclength", "tip=nan"], "'nan' is not a number"),
        (["--arclength", "tip=0", "--truth", "top"], "The files hold no 'top'"),
        (["--arclength", "tip=0", "--shift", "tip=soon"], "--shift 'soon' is not a number"),
        (["--arclength", "tip=0", "--kind", "tip=gyro"], "cannot be read as 'gyro'"),
        (["--arclength", "tip=0", "--kind", "tip=position"], "cannot be read as 'position'"),
        (["--arclength", "tip=0", "--robot", "nobody"], "no robot named 'nobody'"),
        (["--arclength", "tip=0", "--rate", "b.csv=3"], "--rate names 'b.csv'; the files are"),
        (["--arclength", "tip=0", "--rate", "fast"], "--rate 'fast' is not a number"),
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


def test_a_folder_that_holds_something_is_left_alone(tmp_path, capsys):
    file = tracker_csv(tmp_path / "a.csv", {"tip": poses(np.random.default_rng(0), 3)})
    options = [file, "--rate", 100, "--arclength", "tip=0.1", "--out", tmp_path]
    assert run("import", *options) == 2
    assert "not empty" in capsys.readouterr().err


def test_an_imported_session_is_estimated_as_the_native_one(tmp_path, capsys):
    """A simulated session, written as a tracker and motion capture would, gives the same answer."""
    native, robot = tmp_path / "native", tmp_path / "robot.toml"
    text = robot_file("sliding700").read_text()
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
