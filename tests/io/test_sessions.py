"""Session logs: every number comes back, and a crash takes no more than the last second."""

import json
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

import rigs_drawn as rigs
from draws import law
from glissando.errors import GlissandoError, RecordingError
from glissando.geometry import se3
from glissando.hardware.capture import Body, Coil, Rig, write_recording
from glissando.io.recording_folder import load_recording
from glissando.io.session_log import (
    INTEGER,
    NUMBER,
    TEXT,
    SessionWriter,
    numbers,
    read_session,
    schema,
)

PLACE = schema("slide.Place", displacement=NUMBER, tick=INTEGER)
POSE = schema("tracker.Pose", position=numbers(3), state=TEXT)


def written(path, count=40, every=4):
    """A log of two topics, a chunk every few messages."""
    rng = np.random.default_rng(0)
    with SessionWriter(path, {"robot": "sliding700"}) as log:
        log.add_topic("slide", PLACE, device="servo 1")
        log.add_topic("tracker", POSE)
        for k in range(count):
            log.write("slide", {"displacement": rng.standard_normal(), "tick": k}, 1000 * k)
            log.write("tracker", {"position": rng.standard_normal(3), "state": "OK"}, 1000 * k + 1)
            if k % every == 0:
                log.sync()
    return path


finite = st.floats(allow_nan=False, allow_infinity=False)
json_values = st.recursive(
    st.none() | st.booleans() | finite | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=8,
)


@pytest.mark.slow
@law
@given(st.lists(st.dictionaries(st.text(), json_values, max_size=4), max_size=5))
def test_every_message_comes_back_bit_by_bit(tmp_path_factory, messages):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    with SessionWriter(path) as log:
        log.add_topic("t", schema("t"))
        for k, message in enumerate(messages):
            log.write("t", message, 2**62 + k)
    found = read_session(path)
    topic = found.topics.get("t")
    assert found.complete
    assert (topic.messages if topic else []) == messages
    assert (topic.time_ns.tolist() if topic else []) == [2**62 + k for k in range(len(messages))]


def test_schemas_metadata_and_columns_come_back(tmp_path):
    found = read_session(written(tmp_path / "a.mcap"))
    slide, tracker = found.topics["slide"], found.topics["tracker"]
    rng = np.random.default_rng(0)
    drawn = np.array([[rng.standard_normal(), *rng.standard_normal(3)] for _ in range(40)])
    assert np.array_equal(slide.column("displacement"), drawn[:, 0])
    assert np.array_equal(tracker.column("position"), drawn[:, 1:])
    assert slide.schema == PLACE
    assert slide.metadata == {"device": "servo 1"}
    assert found.metadata["robot"] == "sliding700"
    since = 1e-9 * (time.monotonic_ns() - int(found.metadata["monotonic_ns"]))
    assert 1e-9 * int(found.metadata["wall_ns"]) + since == pytest.approx(time.time(), abs=5)
    with pytest.raises(RecordingError, match="'state' is not a number"):
        tracker.column("state")


def test_other_readers_open_a_log_with_its_schemas(tmp_path):
    with written(tmp_path / "a.mcap").open("rb") as file:
        rows = list(make_reader(file, validate_crcs=True).iter_messages())
    assert len(rows) == 80
    kind, channel, message = rows[1]
    assert (kind.name, kind.encoding, channel.topic) == ("tracker.Pose", "jsonschema", "tracker")
    assert json.loads(message.data)["state"] == "OK"
    assert message.log_time == 1


def test_nan_is_null_and_comes_back_as_nan_in_a_column(tmp_path):
    with SessionWriter(tmp_path / "a.mcap") as log:
        log.add_topic("tracker", POSE)
        log.write("tracker", {"position": np.array([1.0, np.nan, 3.0])})
        log.write("tracker", {"state": "MISSING"})
        log.write("tracker", {"position": (np.float32(0.5), np.int64(2), float("nan"))})
    topic = read_session(tmp_path / "a.mcap").topics["tracker"]
    assert topic.messages[0] == {"position": [1.0, None, 3.0]}
    expected = [[1, np.nan, 3], [np.nan] * 3, [0.5, 2, np.nan]]
    np.testing.assert_array_equal(topic.column("position"), expected)
    assert np.all(np.diff(topic.time_ns) >= 0)


@pytest.mark.slow
def test_a_log_cut_off_at_any_byte_loses_only_its_tail(tmp_path):
    data = written(tmp_path / "a.mcap", count=12, every=3).read_bytes()
    whole = read_session(tmp_path / "a.mcap")
    cut, before = tmp_path / "cut.mcap", 0
    for size in range(len(data)):
        cut.write_bytes(data[:size])
        found = read_session(cut)
        count = 0
        for name, topic in found.topics.items():
            told = whole.topics[name]
            count += len(topic.messages)
            assert topic.messages == told.messages[: len(topic.messages)]
            assert np.array_equal(topic.time_ns, told.time_ns[: len(topic.messages)])
        assert count >= before  # more bytes, no fewer messages
        before = count
        assert found.complete == (size >= len(data) - 8)  # but for the magic at the end
        assert not found.damaged
    assert before == 24


@pytest.mark.slow
def test_damage_inside_is_counted_and_costs_no_more_than_its_chunk(tmp_path):
    data = bytearray(written(tmp_path / "a.mcap").read_bytes())
    whole = [m["tick"] for m in read_session(tmp_path / "a.mcap").topics["slide"].messages]
    rng = np.random.default_rng(1)
    torn = tmp_path / "torn.mcap"
    harmed = 0
    for _ in range(400):
        bad = bytearray(data)
        for at in rng.integers(8, len(data), 3):
            bad[at] = rng.integers(256)
        torn.write_bytes(bad)
        found = read_session(torn)
        harmed += found.damaged > 0
        slide = found.topics.get("slide")
        ticks = [m.get("tick") for m in slide.messages] if slide else []
        assert set(ticks) <= {*whole, None}
    assert harmed > 50


def test_a_disk_left_with_zeros_behind_the_last_chunk_is_read(tmp_path):
    data = written(tmp_path / "a.mcap").read_bytes()
    (tmp_path / "zeros.mcap").write_bytes(data[: len(data) // 2] + bytes(4096))
    found = read_session(tmp_path / "zeros.mcap")
    assert 0 < len(found.topics["slide"].messages) < 40


KILLED = """
import sys, time
from glissando.io.session_log import SessionWriter, schema
log = SessionWriter(sys.argv[1])
log.add_topic("t", schema("t"))
k = 0
while True:
    log.write("t", {"k": k, "pad": "x" * 50})
    print(k, time.monotonic_ns(), flush=True)
    k += 1
    time.sleep(0.002)
"""


@pytest.mark.slow
def test_after_kill_9_all_but_the_last_second_is_there(tmp_path):
    path = tmp_path / "killed.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True
    )
    said = []
    try:
        while not said or said[-1][1] < said[0][1] + 2.5e9:
            said.append(tuple(map(int, child.stdout.readline().split())))
    finally:
        child.kill()
        rest, _ = child.communicate(timeout=20)
    said += [tuple(map(int, line.split())) for line in rest.splitlines() if line.count(" ") == 1]
    found = read_session(path)
    kept = [m["k"] for m in found.topics["t"].messages]
    assert kept == list(range(len(kept)))
    old = [k for k, at in said if at < said[-1][1] - 1e9]
    assert len(old) > 20
    assert kept[-1] >= old[-1]
    assert not found.complete


def test_threads_may_write_at_once(tmp_path):
    with SessionWriter(tmp_path / "a.mcap") as log:

        def device(name):
            log.add_topic(name, PLACE)
            for k in range(300):
                log.write(name, {"tick": k})

        threads = [threading.Thread(target=device, args=(f"t{i}",)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(20)
    found = read_session(tmp_path / "a.mcap")
    for i in range(4):
        assert [m["tick"] for m in found.topics[f"t{i}"].messages] == list(range(300))


FULL = """
import resource, sys, numpy as np
from glissando.errors import GlissandoError
from glissando.io.session_log import SessionWriter, schema
resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
try:
    with SessionWriter(sys.argv[1]) as log:
        log.add_topic("t", schema("t"))
        for k in range(1_000):
            log.write("t", {"k": k, "x": np.random.default_rng(k).standard_normal(50)})
            log.sync()
except GlissandoError as problem:
    print(problem)
"""


def test_a_disk_that_is_full_is_one_sentence_and_what_came_before_is_kept(tmp_path):
    path = tmp_path / "full.mcap"
    command = [sys.executable, "-c", FULL, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert "could not be written on" in done.stdout
    assert "make room" in done.stdout
    assert not done.stderr
    kept = [m["k"] for m in read_session(path).topics["t"].messages]
    assert kept == list(range(len(kept)))
    assert len(kept) > 10


def test_mistakes_are_sentences(tmp_path):
    path = tmp_path / "a.mcap"
    with SessionWriter(path) as log:
        log.add_topic("t", schema("t"))
        log.add_topic("t", schema("other"))
        with pytest.raises(GlissandoError, match="'u' is not declared; call add_topic first"):
            log.write("u", {})
        with pytest.raises(GlissandoError, match=r"'t' cannot be written .* finite numbers"):
            log.write("t", {"x": np.inf})
        with pytest.raises(GlissandoError, match="a set is not JSON"):
            log.write("t", {"x": {1}})
        with pytest.raises(GlissandoError, match="Log time -1 ns cannot be"):
            log.write("t", {}, -1)
    with pytest.raises(GlissandoError, match="is closed; write before"):
        log.write("t", {})
    log.close()
    with pytest.raises(GlissandoError, match="exists; give a new name"):
        SessionWriter(path)
    with pytest.raises(GlissandoError, match="cannot be written"):
        SessionWriter(tmp_path / "no" / "a.mcap")
    (tmp_path / "text").write_text("time,arclength")
    with pytest.raises(RecordingError, match="is not an MCAP file"):
        read_session(tmp_path / "text")
    with pytest.raises(RecordingError, match="cannot be read"):
        read_session(tmp_path / "nowhere")


def test_without_mcap_the_extra_is_named(tmp_path, monkeypatch):
    written(tmp_path / "a.mcap")
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    monkeypatch.setitem(sys.modules, "mcap.records", None)
    for use in (SessionWriter, read_session):
        with pytest.raises(GlissandoError, match=r"pip install 'glissando\[hardware\]'"):
            use(tmp_path / ("b.mcap" if use is SessionWriter else "a.mcap"))
    assert not (tmp_path / "b.mcap").exists()


def test_a_session_that_was_killed_opens_as_the_whole_one_does(tmp_path):
    """Only its log is there, and that is cut off: the same rows up to the cut."""
    coils = (Coil("coil", 0.7), Coil("fixed", 0.3, slides=False))
    bodies = (Body("tip", 0.7, se3.exp(np.full(6, 0.01))),)
    frame = se3.exp(np.array([0.3, 0.2, 0.1, 0.5, 0.4, 0.3]))
    rig = Rig("bench", "sliding700", coils=coils, bodies=bodies, frame=frame)
    pose = {"time": NUMBER, "position": numbers(3), "quaternion": numbers(4)}
    log = tmp_path / "whole" / "session.mcap"
    log.parent.mkdir()
    with SessionWriter(log, {"setup": json.dumps(rig.described())}) as writer:
        writer.add_topic("/slide", schema("Slide", time=NUMBER, travel=NUMBER))
        for topic in ("/tracker/coil", "/tracker/fixed", "/mocap/tip"):
            writer.add_topic(topic, schema("Pose", **pose))
        for k in range(200):
            writer.write("/slide", {"time": 5 + 0.05 * k, "travel": 3e-4 * k})
            seen = {"time": 5 + 0.05 * k, "position": [0.1, 0.2, 1e-3 * k]}
            for topic in ("/tracker/coil", "/tracker/fixed", "/mocap/tip"):
                writer.write(topic, {**seen, "quaternion": [1.0, 0.0, 0.0, 0.0]})
            if k % 20 == 0:
                writer.sync()
    cut = tmp_path / "cut" / "session.mcap"
    cut.parent.mkdir()
    cut.write_bytes(log.read_bytes()[:-3000])
    from_log = load_recording(log.parent)
    write_recording(read_session(log), rig, log.parent)
    whole, killed = load_recording(log.parent), load_recording(cut.parent)
    assert load_recording(cut).streams.keys() == whole.streams.keys() == killed.streams.keys()
    for name, stream in whole.streams.items():
        rows, part, same = stream.rows, killed.streams[name].rows, from_log.streams[name].rows
        assert 20 < part.time.size <= rows.time.size
        np.testing.assert_allclose(same.table(), rows.table(), atol=1e-9)
        np.testing.assert_allclose(part.table(), rows.table()[: part.time.size], atol=1e-9)
        assert killed.streams[name].truth == stream.truth
        np.testing.assert_allclose(killed.streams[name].mount, stream.mount, atol=1e-12)
    assert killed.robot.name == whole.robot.name


def test_a_log_that_says_nothing_of_its_frame_leaves_it_unknown(tmp_path):
    data, _ = rigs.drawn(0, "bent")
    rigs.write(tmp_path / "session.mcap", data.at(np.arange(40)))
    recording = load_recording(tmp_path)
    assert recording.unknown_frames == {"tracker"}
    assert recording.streams["coil"].frame == "tracker"
