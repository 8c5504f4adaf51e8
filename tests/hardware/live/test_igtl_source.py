"""What an OpenIGTLink peer sends becomes readings, or is counted."""

import socket
import time
from dataclasses import replace

import numpy as np
import pytest

from glissando.geometry import se3
from glissando.hardware.live import (
    IgtlSource,
    LiveSession,
    Placement,
)
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.live.igtl_sink import readings_message
from glissando.hardware.openigtlink import Endpoint, Message, encode, stamp_of
from glissando.hardware.openigtlink import contents as c
from glissando.model.sensors.readings import SENSORS
from live_recordings import (
    ROBOT,
    ROD,
    SPAN,
    swaying,
)
from waiting import until

PLACES = (Placement("base", 0.0), Placement("tip", ROBOT.length))


def _pose(translation, stamp=1) -> bytes:
    pose = np.eye(4)
    pose[:3, 3] = translation
    return encode(Message(c.Transform(pose), "tip", stamp))


@pytest.mark.slow
def test_what_cannot_be_a_reading_is_counted_and_the_session_goes_on():
    sheared = encode(Message(c.Transform(np.diag([1.0, 2.0, 1.0, 1.0])), "tip", 1))
    invalid = [
        _pose([np.nan, 0.0, 0.0]),
        _pose([0.0, 0.0, 466_000.0]),
        sheared,
        encode(Message(c.NumberArray(np.zeros((1, 3))), "tip", 1)),
        encode(Message(c.SensorValues(np.zeros(0)), "travel", 1)),
    ]
    unplaced = encode(Message(c.Transform(np.eye(4)), "somebody", 1))
    damaged = encode(Message(c.Text("hello"), "tip", 1))[:-1] + b"!"
    with Endpoint("igtl-server://:0") as peer:
        source = IgtlSource(f"igtl://127.0.0.1:{peer.address.port}", ROBOT, PLACES)
        with LiveSession(ROBOT, [source]) as session:
            until(lambda: peer.receive() or peer.peers)
            peer.send([*invalid, unplaced, damaged, _pose([0.0, 0.0, 466.0], 2 << 32)])
            update = next(iter(session))
            reasons = {"invalid": len(invalid), "unplaced": 1, "malformed": 1}
            assert {reason: source.counts[reason] for reason in reasons} == reasons
            assert "unit=mm or unit=m" in source.problem
            assert [len(r) for r in update.readings] == [1]
            np.testing.assert_allclose(update.readings[0].values[0, :3, 3], [0, 0, 0.466])


def _receiving(source, content, device="tip"):
    """The readings of a source whose peer has sent a message."""
    source._endpoint.receive_all = lambda: [(time.monotonic(), Message(content, device, 1))]
    return source.read(SessionClock())


def _tool(name, place):
    pose = np.eye(4)
    pose[:3, 3] = place
    return c.Tool(name, c.TOOL_6D, pose)


def test_one_bad_tool_of_a_message_costs_no_other_its_reading():
    source = IgtlSource("igtl://127.0.0.1:1?clock=arrival", ROBOT, PLACES)
    bad = c.Tool("tip", c.TOOL_6D, np.zeros((4, 4)))
    tools = bad, _tool("base", 1.0), _tool("tip", 2.0)
    assert [r.name for r in _receiving(source, c.TrackingData(tools))] == ["base", "tip"]
    assert source.counts["invalid"] == 1


def test_readings_of_a_glissando_keep_their_names_and_their_times():
    source, clock = IgtlSource("igtl://127.0.0.1:1?clock=arrival", ROBOT), SessionClock()
    (readings, *_), _ = swaying().readings(["tip"], ROBOT, SPAN)
    readings, first = readings.select(slice(0, 2)), readings.time[0]
    streams = [readings.changed(name="a" * 20 + end) for end in "bc"]
    sent = [readings_message(r, 1 << 40, first + 1.5) for r in streams]
    old = replace(sent[0], metadata={"kind": "pose"})
    begun = -clock.of_monotonic(0.0)
    mad = replace(sent[0], metadata={"kind": "pose", "time": "noon"})
    source._endpoint.receive_all = lambda: [(begun + 5.0, m) for m in (*sent, old, mad)]
    *came, last = source.read(clock)
    assert [r.name for r in (*came, last)] == [streams[0].name, streams[1].name, "a" * 20]
    for r in came:
        np.testing.assert_allclose(r.time, 5.0 + readings.time - first - 1.5, atol=1e-6)
    np.testing.assert_allclose(last.time[-1], 5.0, atol=1e-6)
    assert source.counts["invalid"] == 1


def test_what_a_pause_left_waiting_is_read_at_once_up_to_the_newest():
    source = IgtlSource("igtl://127.0.0.1:1?clock=arrival", ROD, PLACES)
    messages = [Message(c.Position(np.array([k, 0.0, 0.0])), "tip") for k in range(1500)]
    waiting = [(0.01 * k, message) for k, message in enumerate(messages)]

    def receive():
        out, waiting[:] = waiting[:256], waiting[256:]
        return out

    source._endpoint.receive, clock = receive, SessionClock()
    read = source.read(clock)
    assert len(read) == 1500
    assert read[-1].time[-1] == clock.of_monotonic(0.01 * 1499)


def _sent(source, messages):
    """The readings of a source to which readings were sent as arrays."""
    source._endpoint.receive_all = lambda: [(time.monotonic(), m) for m in messages]
    return source.read(SessionClock())


@pytest.mark.parametrize("kind", sorted(SENSORS))
def test_readings_of_no_kind_end_a_session_whatever_their_values(kind):
    """Kinds that need settings, positions where no tracker reaches, values that are no number."""
    noisy = replace(ROBOT, sensor_std={name: np.ones(1) for name in SENSORS})
    source = IgtlSource("igtl://127.0.0.1:1?clock=arrival", noisy)
    table = np.zeros((2, 2 + len(SENSORS[kind].columns)))
    table[:, 1] = 0.1
    messages = [
        Message(c.NumberArray(table + value), kind, 1, 2, metadata={"kind": kind})
        for value in (0.0, 1.0, 1e300, -np.inf, np.nan)
    ]
    read = _sent(source, messages)
    assert len(read) + source.counts["invalid"] == len(messages)
    for r in read:
        assert kind not in ("pose", "coil", "position") or np.abs(r.values[..., :3]).max() <= 20.0


def test_streams_are_as_many_as_a_journal_can_keep():
    source, rest = IgtlSource("igtl://127.0.0.1:1?clock=arrival", ROBOT), swaying()
    (readings, *_), _ = rest.readings(["tip"], ROBOT, SPAN)
    named = [readings.changed(name=f"stream {k}") for k in range(100)]
    assert len(_sent(source, [readings_message(r, 1 << 40) for r in named])) == 64
    assert source.counts["invalid"] == 36


def test_a_device_that_changes_its_kind_is_invalid():
    source = IgtlSource("igtl://127.0.0.1:1?clock=arrival", ROD, PLACES)
    assert len(_receiving(source, c.Transform(np.eye(4)))) == 1
    assert _receiving(source, c.Position(np.ones(3))) == []
    assert source.counts["invalid"] == 1


@pytest.mark.slow
def test_a_pose_that_a_server_repeats_between_measurements_is_one_reading():
    with Endpoint("igtl-server://:0") as peer:
        source = IgtlSource(f"igtl://127.0.0.1:{peer.address.port}", ROBOT, PLACES)
        with LiveSession(ROBOT, [source]) as session:
            until(lambda: peer.receive() or peer.peers)
            peer.send([_pose([0.0, 0.0, 466.0], k << 32) for k in (1, 2, 3)])
            until(lambda: source.poll() or source.counts["heard"] == 3)
            assert sum(map(len, next(iter(session)).readings)) == 1
        assert source.counts["repeated"] == 2


@pytest.mark.slow
def test_travel_moves_a_sliding_coil_and_units_and_axes_are_the_peers():
    metre, milli = 0x01 << 54 | 1 << 50, 0xB << 60
    with Endpoint("igtl-server://:0") as peer:
        where = f"igtl://127.0.0.1:{peer.address.port}?unit=m&axes=lps"
        source = IgtlSource(where, ROBOT, [Placement("coil", 0.4, "coil", True)])
        with source:
            until(lambda: peer.receive() or peer.peers)
            pose = np.eye(4)
            pose[:3, 3] = 0.1, 0.2, 0.3
            tool = c.TrackingData((c.Tool("coil", c.TOOL_5D, pose),))
            travel = c.SensorValues(np.array([30.0]), milli | metre)
            peer.send([encode(Message(each, "travel")) for each in (travel, tool)])
            until(lambda: source.poll() or source.counts["heard"] == 2)
            (read,) = source.read(LiveSession(ROBOT, [source]).clock)
            assert not source.problem
    assert read.kind == "coil"
    np.testing.assert_allclose(read.arclength, [0.37])
    np.testing.assert_allclose(read.values[0, :3, 3], [-0.1, -0.2, 0.3], atol=1e-7)


def test_a_peer_that_sends_nothing_but_images_is_named():
    image = encode(Message(c.Text("x" * 300), "scan")).replace(b"STRING", b"IMAGES", 1)
    with (
        Endpoint("igtl-server://:0") as peer,
        IgtlSource(f"igtl://127.0.0.1:{peer.address.port}", ROBOT, PLACES) as source,
    ):
        until(lambda: peer.receive() or peer.peers)
        peer.send(3 * [image])
        until(lambda: source.poll() or source.counts["of unread types"] == 3)
        assert source.problem.endswith("sends nothing that is read here")


@pytest.mark.parametrize(
    ("device", "pose", "problem"),
    [
        ("Tip", np.eye(4), "sends Tip; placed are tip"),
        ("tip", np.diag([1.0, 2.0, 1.0, 1.0]), "tip sent no rigid motion nearby"),
    ],
)
def test_why_nothing_is_a_reading_is_named(device, pose, problem):
    source = IgtlSource("igtl://127.0.0.1:1", ROBOT, [Placement("tip", 0.4)])
    source._waiting = [(time.monotonic(), Message(c.Transform(pose), device))]
    with source:
        assert source.read(SessionClock()) == []
        source._endpoint.peers = {"127.0.0.1:1": ""}
        assert source.problem.endswith(problem)
        source._waiting = [(time.monotonic(), Message(c.Transform(np.eye(4)), "tip"))]
        assert len(source.read(SessionClock())) == 1
        assert not source.problem


def test_a_device_that_slides_is_not_placed_before_a_travel_is_known():
    source = IgtlSource("igtl://127.0.0.1:1", ROBOT, [Placement("coil", 0.4, "coil", True)])
    message = Message(c.TrackingData((c.Tool("coil", c.TOOL_5D, np.eye(4)),)), "tracker")
    source._waiting = [(time.monotonic(), message)]
    with source:
        source._endpoint.peers = {"127.0.0.1:1": ""}
        assert source.read(SessionClock()) == []
        assert source.counts["no travel"] == 1
        source._endpoint.peers = {"127.0.0.1:1": ""}
        assert source.problem == "igtl://127.0.0.1:1 has sent no travel of the slide"


def test_a_travel_that_ends_leaves_the_device_nowhere_and_is_named():
    place = Placement("coil", 0.4, "coil", True)
    source = IgtlSource("igtl://127.0.0.1:1?clock=arrival", ROBOT, [place])
    source._endpoint.peers, clock = 1, SessionClock()

    def came(at):
        pose = np.eye(4)
        pose[0, 3] = at  # mm: another one each time
        tool = c.TrackingData((c.Tool("coil", c.TOOL_5D, pose),))
        source._endpoint.receive_all = lambda: [(at, Message(tool, "tracker"))]
        return source.read(clock)

    source._waiting = [(0.0, Message(c.SensorValues(np.array([10.0])), "travel"))]
    assert len(came(0.9)) == 1
    assert not source.problem
    assert came(1.1) == came(1000.0) == []
    assert source.counts["no travel"] == 2
    assert source.problem == "igtl://127.0.0.1:1 sends no more travel of the slide"
    source._waiting = [(1000.0, Message(c.SensorValues(np.array([10.0])), "travel"))]
    assert len(came(1000.1)) == 1
    assert not source.problem


@pytest.mark.slow
def test_positions_with_and_without_an_orientation_are_read_and_a_status_is_passed_on():
    turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.4, -0.2, 0.7]))
    wxyz = se3.quaternion(turn[:3, :3])
    place = np.array([10.0, -20.0, 460.0])
    bare, turned = c.Position(place), c.Position(place, np.roll(wxyz, -1))
    with Endpoint("igtl-server://:0") as peer:
        source = IgtlSource(f"igtl://127.0.0.1:{peer.address.port}", ROD, PLACES)
        clock = LiveSession(ROD, [source]).clock
        with source:
            until(lambda: peer.receive() or peer.peers)
            peer.send([encode(Message(bare, "tip")), encode(Message(turned, "base"))])
            until(lambda: source.poll() or source.counts["heard"] == 2)
            position, pose = source.read(clock)
            for code, problem in ((13, "reports 'no coil'"), (1, "")):
                before = source.counts["heard"]
                peer.send([encode(Message(c.Status(code, "no coil"), "tracker"))])
                until(lambda before=before: source.poll() or source.counts["heard"] > before)
                assert source.read(clock) == []
                assert source.problem.endswith(problem)
                assert bool(source.problem) == bool(problem)
    assert (position.kind, pose.kind) == ("position", "pose")
    np.testing.assert_allclose(position.values[0], 1e-3 * place, atol=1e-7)
    np.testing.assert_allclose(pose.values[0][:3, :3], turn[:3, :3], atol=1e-6)


def test_stamps_of_a_senders_clock_become_times_better_than_their_arrivals():
    rng = np.random.default_rng(5)
    with Endpoint("igtl-server://:0") as peer:
        source = IgtlSource(f"igtl://127.0.0.1:{peer.address.port}", ROBOT, PLACES)
        clock = LiveSession(ROBOT, [source]).clock
        ahead, misses = 1.6e9, []
        for k in range(300):
            measured = 100.0 + 0.02 * k
            delay = 0.001 + 0.02 * rng.random() ** 3
            time = source._time(stamp_of(measured + ahead), measured + delay, clock)
            misses.append(time - clock.of_monotonic(measured))
    assert np.abs(misses[100:]).max() < 3e-3


@pytest.mark.slow
def test_a_peer_that_speaks_another_language_is_named_as_one():
    with socket.create_server(("127.0.0.1", 0)) as server:
        name = f"igtl://127.0.0.1:{server.getsockname()[1]}"
        with IgtlSource(name, ROBOT, PLACES) as source:
            other, _ = server.accept()
            with other:
                other.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n" + bytes(200))
                until(lambda: source.poll() is None and "is not OpenIGTLink" in source.problem)
