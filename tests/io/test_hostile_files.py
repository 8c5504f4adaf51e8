"""What others wrote leads nowhere else, takes no more than it holds, and ends in a sentence."""

import json
import os
import struct
from contextlib import suppress

import h5py
import lz4.frame
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from draws import law
from foreign_bags import bag, c3d
from glissando import estimate
from glissando.cli.main import main
from glissando.errors import GlissandoError, RecordingError, RobotFileError, SensorError
from glissando.io.csv_stream import Rows, Stream
from glissando.io.foreign import read_tracks
from glissando.io.foreign.recording import Choices, write_recording
from glissando.io.foreign.tracks import Track
from glissando.io.journal import Journal
from glissando.io.netcdf import load_posterior, save_posterior
from glissando.io.plain_file import file_stem
from glissando.io.recording_folder import load_recording, save_recording
from glissando.io.recording_writer import write_streams
from glissando.io.robot_file import load_robot
from glissando.io.session_log import read_session
from glissando.io.session_log.reader import Topic
from glissando.io.shipped_robots import beside, robot_file
from glissando.model.grid import Grid
from glissando.model.sensors.sensors import PoseReadings

PATHS = ["../x", "a/b", "/tmp/x", "..", ".hidden", "a\\b", "a\0b", "a\nb", "", " ", "n" * 300]


@pytest.mark.slow
@law
@given(st.text())
def test_a_name_that_is_taken_is_one_entry_of_its_folder(tmp_path_factory, name):
    folder = tmp_path_factory.mktemp("f")
    try:
        path = folder / f"{file_stem(name)}.csv"
    except GlissandoError:
        return
    path.write_text("")
    assert [entry.name for entry in folder.iterdir()] == [f"{name}.csv"]


@pytest.mark.parametrize("name", PATHS)
def test_no_name_from_a_file_becomes_a_path(tmp_path, name):
    rows = Rows("pose", np.zeros(1), np.zeros(1), np.eye(4)[None], {})
    out = tmp_path / "a" / "out"
    out.mkdir(parents=True)
    with pytest.raises(RecordingError, match="cannot be that of a file"):
        write_streams(out, "x", [Stream(name, rows)])
    at = {"time": np.zeros(1), "arclength": np.zeros(1), "cov": np.full(6, 1e-6)}
    readings = PoseReadings(values=np.eye(4)[None], name=name, **at)
    with Journal(out / "log") as log, pytest.raises((SensorError, ValueError)):
        log.write(readings if name else PoseReadings(values=np.eye(4)[None], name="..", **at))
    assert {p.name for p in tmp_path.rglob("*")} <= {"a", "out", "log", "recording.toml"}


def log_of(path, topics, compression=CompressionType.NONE):
    """A log of messages by topic, as some other program writes it."""
    with path.open("wb") as file:
        log = Writer(file, compression=compression)
        log.start(profile="", library="")
        setup = {"robot": "sliding700", "coil_arclength": 0.7, "coil_arclength_std": 0.002}
        setup["coils"] = {t.removeprefix("/tracker/"): {"arclength": 0.5} for t in topics}
        log.add_metadata("session", {"setup": json.dumps(setup)})
        made = log.register_schema("s", "jsonschema", b"{}")
        for topic, messages in topics.items():
            channel = log.register_channel(topic, "json", made)
            for time, data in messages:
                log.add_message(channel, time, data, time)
        log.finish()
    return path


def pose(k):
    return json.dumps({"time": k, "frame": k, "position": [0, 0, k], "quaternion": [1, 0, 0, 0]})


def test_a_coil_named_as_a_path_writes_nothing_outside(tmp_path, capsys):
    messages = [(k, pose(k).encode()) for k in range(9)]
    folder = tmp_path / "a" / "session"
    folder.mkdir(parents=True)
    log_of(folder / "session.mcap", {"/tracker/../../x": messages})
    before = sorted(tmp_path.rglob("*"))
    out = ["--out", str(tmp_path / "c.toml"), "--recording", str(tmp_path / "a" / "made")]
    assert main(["calibrate", str(folder), *out]) == 2
    with pytest.raises(RecordingError, match="cannot be that of a file"):
        save_recording(load_recording(folder), tmp_path / "a" / "made")
    assert sorted(tmp_path.rglob("*")) == before
    assert "Traceback" not in capsys.readouterr().err


def test_one_bad_message_does_not_spoil_a_log(tmp_path):
    good = [(k, pose(k).encode()) for k in range(5)]
    bad = [(5, b"[" * 100_000), (1 << 63, pose(6).encode()), (6, b'{"time": 1' + b"0" * 5000)]
    topic = read_session(log_of(tmp_path / "a.mcap", {"/tracker/c": good + bad})).topics
    assert topic["/tracker/c"].column("time").tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("kind", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_log_that_unpacks_to_much_more_than_it_holds_is_not_unpacked(tmp_path, kind):
    sound = [(k, pose(k).encode()) for k in range(20)]
    path = log_of(tmp_path / "a.mcap", {"/tracker/c": sound}, kind)
    assert len(read_session(path).topics["/tracker/c"].messages) == 20
    bomb = log_of(tmp_path / "b.mcap", {"/tracker/c": [(0, bytes(1 << 25))]}, kind)
    assert bomb.stat().st_size < 300_000
    assert read_session(bomb).damaged == 1


@law
@given(st.integers(0, 2**64 - 1))
def test_sizes_that_a_log_announces_allocate_nothing(tmp_path_factory, size):
    path = tmp_path_factory.mktemp("f") / "a.mcap"
    packed = lz4.frame.compress(bytes(100))
    body = struct.pack("<QQQII", 0, 0, size, 0, 3) + b"lz4"
    body += struct.pack("<Q", size) + packed
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(body)) + body)
    assert not read_session(path).topics


@pytest.mark.parametrize("place", ["/dev/zero", "fifo", "folder", "a\0b"])
def test_a_pipe_a_device_and_a_folder_are_no_files_to_read(tmp_path, place):
    if place == "fifo":
        os.mkfifo(tmp_path / place)
    if place == "folder":
        (tmp_path / place).mkdir()
    name = json.dumps(place)
    text = f'name = "a"\n[[streams]]\nname = "c"\nkind = "pose"\nfile = {name}\n'
    (tmp_path / "recording.toml").write_text(text)
    with pytest.raises(RecordingError, match="cannot be read"):
        load_recording(tmp_path)
    with pytest.raises(RobotFileError):
        load_robot(tmp_path / place)


@pytest.mark.parametrize(
    "line",
    [
        "length = " + "[" * 5000 + "]" * 5000,
        "length = 1" + "0" * 400,
        "length = 1" + "0" * 5000,
        "length = 2026-13-45T99:99:99",
        "length = 0.466\n[grid]\ntime_rate = 30\narclength_nodes = 1e9",
    ],
)
def test_numbers_dates_and_depths_that_cannot_be_are_sentences(tmp_path, line):
    text = robot_file("tdcr466").read_text()
    kept = text[text.index("[base]") :] if "[base]" in text else text
    kept = kept.replace("[grid]", "[unused]") if "[grid]" in line else kept
    (tmp_path / "r.toml").write_text(f"{line}\n{kept}")
    with pytest.raises(RobotFileError):
        load_robot(tmp_path / "r.toml")


def test_a_posterior_that_announces_more_than_it_holds_is_refused_before_it_is_read(tmp_path):
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.attrs["format"] = "glissando posterior 1"
        file.create_dataset("information", (1 << 20, 1 << 12), "f8", chunks=True)
    with pytest.raises(GlissandoError, match="announces 34,359,738,368 bytes"):
        load_posterior(tmp_path / "a.nc")


@pytest.mark.slow
def test_a_posterior_of_fine_nodes_is_read_though_its_zeros_pack_well(tmp_path, monkeypatch):
    robot = load_robot("tdcr466")
    grid = Grid(np.linspace(0.0, robot.length, 60), np.array([0.0, 0.05]))
    tip = np.eye(4)
    tip[2, 3] = robot.length
    at = {"time": np.zeros(1), "arclength": np.full(1, robot.length), "cov": np.full(6, 1e-6)}
    posterior = estimate(robot.prior, grid, [PoseReadings(values=tip[None], name="tip", **at)])
    path = tmp_path / "fine.nc"
    save_posterior(posterior, path)
    assert posterior.system.diagonal.nbytes > 30 * path.stat().st_size
    read = load_posterior(path)
    np.testing.assert_allclose(read.marginals.cov, posterior.marginals.cov, atol=1e-9)
    monkeypatch.setattr("os.sysconf", lambda name: 1 << 12)  # a machine of 16 MiB
    with pytest.raises(GlissandoError, match=r"announces .* bytes"):
        load_posterior(path)


@pytest.mark.parametrize("cut", [0.1, 0.5, 0.9, 0.999])
def test_a_c3d_that_is_cut_short_is_refused_and_not_filled_up(tmp_path, cut):
    c3d(tmp_path / "a.c3d")
    data = (tmp_path / "a.c3d").read_bytes()
    whole = len(data.rstrip(b"\0"))
    (tmp_path / "a.c3d").write_bytes(data[: int(cut * whole)])
    with pytest.raises(RecordingError, match="cannot be read as c3d"):
        read_tracks(tmp_path / "a.c3d")


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_c3d_of_integers_is_read_whatever_processor_wrote_it(tmp_path, order):
    """The parameters as the guide has them, by hand, in either order of bytes."""
    points = np.arange(24).reshape(4, 2, 3)

    def parameter(name, kind, shape, data):
        head = struct.pack("bb", len(name), 1) + name
        body = struct.pack("bB", kind, len(shape)) + bytes(shape) + data + b"\0"
        return head + struct.pack(f"{order}H", len(body) + 2) + body

    group = struct.pack("bb", 5, -1) + b"POINT" + struct.pack(f"{order}H", 3) + b"\0"
    blocks = group + parameter(b"UNITS", -1, (2,), b"mm")
    blocks += parameter(b"LABELS", -1, (3, 2), b"tipmid")
    blocks += parameter(b"RATE", 4, (), struct.pack(f"{order}f", 100.0)) + b"\0\0"
    head = b"\x02\x50" + struct.pack(f"{order}5HfHHf", 2, 0, 1, 4, 0, 0.5, 3, 0, 50.0)
    rows = np.concatenate([points, np.zeros((4, 2, 1), int)], axis=2)
    rows[2, 0, 3] = -1
    data = head.ljust(512, b"\0") + b"\1\x50\1" + bytes([84 if order == "<" else 86])
    data = (data + blocks).ljust(1024, b"\0") + rows.astype(f"{order}i2").tobytes()
    (tmp_path / "a.c3d").write_bytes(data)
    tip, mid = read_tracks(tmp_path / "a.c3d")
    assert (tip.name, mid.name, tip.missing) == ("tip", "mid", 1)
    np.testing.assert_allclose(mid.values, 0.5e-3 * points[:, 1])
    np.testing.assert_allclose(tip.time, [0.0, 0.01, 0.03])


def test_a_bag_that_is_damaged_anywhere_is_read_or_refused(tmp_path):
    bag(tmp_path / "run.bag", 1, np.random.default_rng(0))
    data = (tmp_path / "run.bag").read_bytes()
    for seed in range(30):
        rng = np.random.default_rng(seed)
        spoilt = bytearray(data)
        for at in rng.integers(len(data), size=3):
            spoilt[at : at + 4] = rng.bytes(4)
        (tmp_path / "bad.bag").write_bytes(spoilt)
        with suppress(GlissandoError):
            read_tracks(tmp_path / "bad.bag")


@law
@given(st.lists(st.sampled_from(["a", "a_1", "a_2", "b"]), min_size=1, max_size=8))
def test_objects_of_one_name_are_streams_of_their_own(tmp_path_factory, names):
    rest = np.tile(np.eye(4), (2, 1, 1))
    tracks = [Track(name, "pose", np.arange(2.0), rest) for name in names]
    unique = {n for n in names if names.count(n) == 1}
    places = dict.fromkeys(unique or {f"{names[0]}_1"}, 0.1)
    out = tmp_path_factory.mktemp("f") / "out"
    try:
        lines = write_recording(tracks, out, Choices(places))
    except RecordingError:
        lines = None  # the first number was taken by an object of that name
    if lines is not None:
        assert len({line.split(":")[0] for line in lines}) == len(names)


def test_a_frame_of_any_name_is_read_back(tmp_path):
    rows = Rows("pose", np.arange(2.0), np.zeros(2), np.tile(np.eye(4), (2, 1, 1)), {})
    for k, frame in enumerate(["aurora.1", "Büro", "a b", 'q"uote', "x" * 200]):
        folder = tmp_path / str(k)
        folder.mkdir()
        stream = Stream("tip", rows, std=np.full(6, 1e-3), frame=frame, keep_repeats=True)
        write_streams(folder, "x", [stream], frames={frame: None})
        assert load_recording(folder).unknown_frames == {frame}


def test_names_lists_and_tables_of_no_use_are_sentences(tmp_path):
    with pytest.raises(GlissandoError, match="no robot named"):
        load_robot(beside(tmp_path, "n" * 5000))
    with pytest.raises(GlissandoError, match="not a number"):
        Topic("/slide", {}, {}, np.zeros(1, int), [{"travel": [1, [2, 3]]}]).column("travel")


def test_one_program_at_a_time_writes_a_journal(tmp_path):
    with Journal(tmp_path / "log"), pytest.raises(RecordingError, match="Another program writes"):
        Journal(tmp_path / "log")
    Journal(tmp_path / "log").close()


def test_a_journal_writes_to_its_own_files_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("no end of line")
    Journal(tmp_path / "log").close()
    (tmp_path / "log" / "tip.csv").symlink_to(tmp_path / "mine.txt")
    with pytest.raises(RecordingError, match="not a regular file"):
        Journal(tmp_path / "log")
    assert (tmp_path / "mine.txt").read_text() == "no end of line"
    plain = tmp_path / "plain"
    plain.mkdir()
    (plain / "recording.toml").write_text('name = "a"\n')
    with pytest.raises(RecordingError, match="not a journal"):
        Journal(plain)
