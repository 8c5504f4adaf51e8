"""What was put into a foreign file is what comes out of it, in SI, or a sentence."""

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from draws import generators, law, poses
from foreign_bags import bag, c3d
from foreign_files import hole, ndi_csv, tracker_csv
from glissando.errors import GlissandoError, RecordingError
from glissando.io.foreign import read_tracks, rosbag


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
    points = c3d(tmp_path / "trial.c3d", unit)
    tip, mid = read_tracks(tmp_path / "trial.c3d")
    (tmp_path / "trial.c3d").rename(tmp_path / "unnamed.dat")
    assert len(read_tracks(tmp_path / "unnamed.dat")) == 2  # known by what stands in it
    assert (tip.name, mid.name, tip.missing, mid.missing) == ("tip", "mid_one", 1, 1)
    np.testing.assert_allclose(tip.values, np.delete(points[0], 4, axis=0), atol=1e-6)
    np.testing.assert_allclose(mid.time, np.delete(np.arange(20), 6) / 120)


@pytest.mark.slow
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


@pytest.mark.slow
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
        (
            text(HEADS + "9,0,0,0,0,1,2,3\n2,0,0,0,0,1,2,3\n"),
            100.0,
            "line 7: frame or time 2 foll",
        ),
        (text("Devices\n\nTrajectories\n10\n,,\nF,S\n,,\n1,0\n"), 9.0, "is of no known kind"),
        (text("Trajectories\n10\n,,A\nFrame,Sub Frame,Fx\n,,N\n1,0,3\n"), None, "holds no objects"),
        (text("Trajectories\nfast\n,,A\nF,S,X,Y,Z\n,,mm,mm,mm\n"), None, "says 'fast'"),
        (text(TOOL), 40.0, "holds no rows"),
        (text(TOOL + "P,1,OK,1,0,0,0,1,2,3,0\n"), None, "has no times; give the rate"),
        (text(TOOL + "P,1,OK,1,0,y,0,1,2,3,0\n"), 40.0, "line 2: '1,0,y,0,1,2,3' is not all num"),
        (
            text(TOOL + "P,2,,1,0,0,0,1,2,3\nP,1,,1,0,0,0,1,2,3\n"),
            40.0,
            "line 3: frame or time",
        ),
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


def test_a_missing_package_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    (tmp_path / "a.bag").write_bytes(b"")
    with pytest.raises(GlissandoError, match=r"pip install 'glissando\[ros\]'"):
        read_tracks(tmp_path / "a.bag")


def topic_of(stamps, logged, names=lambda k: {}):
    """A topic of transforms with the stamps and the times of logging given, ns, and its bag."""

    def message(k):
        name = {"frame_id": "world", "child_frame_id": "tip"} | names(k)
        stamp = SimpleNamespace(sec=stamps[k] // 10**9, nanosec=stamps[k] % 10**9)
        turn = SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0)
        transform = SimpleNamespace(translation=turn, rotation=turn)
        header = SimpleNamespace(stamp=stamp, frame_id=name["frame_id"])
        return SimpleNamespace(header=header, transform=transform, **name)

    topic = SimpleNamespace(topic="/tf_tip", msgtype="geometry_msgs/msg/TransformStamped")
    return SimpleNamespace(
        connections=[topic],
        messages=lambda _: [(topic, at, k) for k, at in enumerate(logged)],
        deserialize=lambda raw, _: message(raw),
    )


def tracks_of(bag):
    """The tracks of the topic of a bag."""
    types = {c.topic: c.msgtype for c in bag.connections}
    return rosbag._tracks(bag, types, list(types), [])


def test_a_bag_without_poses_says_what_it_holds(tmp_path):
    store, joint = get_typestore(Stores.ROS2_HUMBLE), "sensor_msgs/msg/JointState"
    with Writer(tmp_path / "run", version=9) as out:
        for topic, kind in {"/joint": joint, "/imu": "sensor_msgs/msg/Imu"}.items():
            out.add_connection(topic, kind, typestore=store)
    with pytest.raises(
        RecordingError, match=r"It holds /joint \(sensor_msgs/msg/JointState\), /imu"
    ):
        read_tracks(tmp_path / "run")


@pytest.mark.parametrize("several", ["frame_id", "child_frame_id"])
def test_a_topic_of_several_frames_is_refused(several):
    bag = topic_of([1, 2, 3, 4], [1, 2, 3, 4], lambda k: {several: f"f{k % 2}"})
    with pytest.raises(RecordingError, match="poses of several frames, f0, f1"):
        tracks_of(bag)


@law
@given(generators)
def test_a_stamp_of_zero_is_a_time_only_on_a_clock_that_begins_there(rng):
    steps = np.cumsum(rng.integers(1, 10**8, 6)) - 1
    logged = 1778067471_000000000 + steps + rng.integers(10**6, 10**9)
    simulated = (steps - steps[0]).tolist()
    (found,) = tracks_of(topic_of(simulated, logged.tolist()))
    np.testing.assert_allclose(found.time, 1e-9 * np.array(simulated), atol=1e-12)
    unset = np.where(rng.random(6) < 0.5, 0, logged - 1000)
    (found,) = tracks_of(topic_of(unset.tolist(), logged.tolist()))
    np.testing.assert_allclose(found.time, 1e-9 * logged, rtol=0, atol=2e-6)
