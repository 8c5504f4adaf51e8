"""Readings that come from ROS 2 topics: each once, as they were, whatever else is published."""

import threading
import time
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.evaluation.replay import replay
from glissando.geometry import se3
from glissando.hardware.live import LiveSession, Placement
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.ros2.graph import Ros2Address, profile
from glissando.hardware.ros2.ros2_source import Ros2Source
from glissando.io.recording_folder import load_recording
from live_recordings import ROBOT, SPAN, Lockstep, reading_messages, swaying, through_wire
from ros_peers import PLACES, Peer, meet
from waiting import until

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rclpy's own imports


def _exact(recording):
    """The recording with times of whole nanoseconds and the poses that a quaternion gives."""
    streams = {}
    for name, stream in recording.streams.items():
        rows, values = stream.rows, stream.rows.values.copy()
        values[:, :3, :3] = se3.rotation_from_quaternion(se3.quaternion(values[:, :3, :3]))
        time_ns = [1e-9 * round(1e9 * t) for t in rows.time]
        streams[name] = replace(stream, rows=replace(rows, time=np.array(time_ns), values=values))
    return replace(recording, streams=streams)


def _through_ros(recording, domain, journal):
    """Newest states of a session whose poses come through a graph, and their times."""
    with Peer(domain, [p.name for p in PLACES]) as peer:
        source = Ros2Source(f"{domain}&clock=sender", ROBOT, PLACES)
        streams = list(recording.streams.values())
        messages = [
            (t, (p.name, peer.pose(t, s.rows.values[k])))
            for k, t in enumerate(streams[0].rows.time)
            for p, s in zip(PLACES, streams, strict=True)
        ]
        clock = Lockstep(peer, messages, source)
        peer.receive = lambda: True
        session = LiveSession(ROBOT, [source], journal=journal, clock=clock, patience=1e9)
        with session:
            meet(peer, source)
            clock.sleep_until(SPAN[0])
            return list(islice(session, 25))


@pytest.mark.slow
def test_a_session_through_ros_openigtlink_and_replay_gives_the_same_estimates(domain, tmp_path):
    recording = _exact(swaying(2))
    live = _through_ros(recording, domain, tmp_path / "log")
    readings, _ = recording.readings(["base", "tip"], ROBOT, SPAN)
    wired = through_wire(reading_messages(readings), tmp_path / "igtl", updates=25)
    window = live[0].time, live[-1].time
    for again in (recording, load_recording(tmp_path / "log")):
        replayed = replay(again, ROBOT, window=window).states
        for one, other, state in zip(live, wired, replayed, strict=True):
            for newest in (one.newest, other.newest):
                for name in ("pose", "strain", "velocity", "cov"):
                    ours, theirs = getattr(newest, name), getattr(state, name)
                    np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_what_is_no_pose_is_counted(domain):
    with Peer(domain, ["/tip/pose"]) as peer:
        source = Ros2Source(f"{domain}&clock=arrival", ROBOT, PLACES[1:])
        with LiveSession(ROBOT, [source]) as session:
            meet(peer, source)
            far, skew = peer.pose(1.0, np.eye(4)), peer.pose(1.0, np.eye(4))
            far.pose.position.x, skew.pose.orientation.w = 466.0, 0.2
            good = np.eye(4)
            good[2, 3] = 0.466
            peer.send([("/tip/pose", m) for m in (far, skew, peer.pose(1.0, good))])
            (read,) = next(iter(session)).readings
        assert source.counts == {"heard": 3, "invalid": 2}
        np.testing.assert_allclose(read.values[0], good, atol=1e-12)


@pytest.mark.slow
def test_one_look_takes_all_that_has_come(domain):
    source = Ros2Source(f"{domain}&clock=arrival", ROBOT, PLACES)
    with source, Peer(domain, [p.name for p in PLACES]) as peer:
        meet(peer, source)
        for _ in range(40):
            peer.send([(place.name, peer.pose(1.0, np.eye(4))) for place in PLACES])
        time.sleep(0.5)
        source.poll()
        assert source.counts["heard"] == 80


@pytest.mark.slow
def test_transforms_rates_and_travels_are_read_as_they_are_sent(domain):
    """A TransformStamped of a coil that slides by a JointState, and an Imu."""
    from geometry_msgs.msg import TransformStamped
    from sensor_msgs.msg import Imu, JointState

    rng = np.random.default_rng(5)
    pose, rate = se3.exp(0.3 * rng.normal(size=6)), rng.normal(size=3)
    places = Placement("/tip", ROBOT.length, "coil", slides=True), Placement("/imu", 0.233, "gyro")
    source = Ros2Source(f"{domain}&type=transform&travel=/stage&clock=arrival", ROBOT, places)
    with LiveSession(ROBOT, [source]), Peer(domain, []) as peer:
        kinds = {"/tip": TransformStamped, "/imu": Imu, "/stage": JointState}
        quality = profile(10, reliable=True)
        peer.publishers = {n: peer.node.create_publisher(k, n, quality) for n, k in kinds.items()}
        meet(peer, source)
        transform, imu = TransformStamped(), Imu()
        move, turn = transform.transform.translation, transform.transform.rotation
        move.x, move.y, move.z = pose[:3, 3].tolist()
        turn.w, turn.x, turn.y, turn.z = se3.quaternion(pose[:3, :3]).tolist()
        spin = imu.angular_velocity
        spin.x, spin.y, spin.z = rate.tolist()
        peer.send([("/stage", JointState(name=["slide"], position=[0.05]))])
        until(lambda: source.poll() or source.counts["heard"] == 1)
        peer.send([("/tip", transform), ("/imu", imu)])
        until(lambda: source.poll() or source.counts["heard"] == 3)
        read = {r.kind: r for r in source.read(SessionClock())}
    np.testing.assert_allclose(read["coil"].values[0][:3, 3], pose[:3, 3], atol=1e-12)
    np.testing.assert_allclose(read["coil"].values[0][:3, 2], pose[:3, 2], atol=1e-12)
    assert read["coil"].arclength == pytest.approx(ROBOT.length - 0.05)
    np.testing.assert_allclose(read["gyro"].values[0], rate)
    assert read["gyro"].arclength == 0.233


@pytest.mark.slow
@pytest.mark.parametrize(("reliable", "latched"), [(True, True), (True, False), (False, False)])
def test_a_publisher_of_any_quality_is_heard(domain, reliable, latched):
    source = Ros2Source(f"{domain}&clock=arrival", ROBOT, PLACES[1:])
    with source, Peer(domain, []) as peer:
        quality = profile(1, reliable=reliable, latched=latched)
        peer.publishers = {"/tip/pose": peer.node.create_publisher(peer.kind, "/tip/pose", quality)}
        meet(peer, source)
        send = peer.publishers["/tip/pose"].publish
        until(lambda: send(peer.pose(1.0, np.eye(4))) or source.poll() or source.counts["heard"])


@pytest.mark.slow
def test_a_device_that_slides_is_not_placed_before_a_travel_is_known(domain):
    place = Placement("/tip/pose", ROBOT.length, "coil", slides=True)
    source = Ros2Source(f"{domain}&travel=/misspelt&clock=arrival", ROBOT, [place])
    with source, Peer(domain, ["/tip/pose"]) as peer:
        send, clock = peer.publishers["/tip/pose"].publish, SessionClock()
        until(lambda: send(peer.pose(1.0, np.eye(4))) or source.read(clock) or source.counts)
        until(lambda: source.problem == "nobody publishes /misspelt")
        assert source.read(clock) == []
        assert source.counts["no travel"] == source.counts["heard"]


@pytest.mark.slow
def test_a_topic_of_another_type_is_named(domain):
    source = Ros2Source(f"{domain}&type=transform", ROBOT, PLACES[1:])
    with source, Peer(domain, ["/tip/pose"]):
        why = "/tip/pose is of geometry_msgs/msg/PoseStamped, not geometry_msgs/msg/Transform"
        until(lambda: source.poll() or source.problem.startswith(why))


@pytest.mark.slow
def test_a_session_follows_simulated_time(domain):
    from rosgraph_msgs.msg import Clock

    source = Ros2Source(f"{domain}&clock=sim", ROBOT, PLACES[1:])
    session = LiveSession(ROBOT, [source], rate=20.0)
    with Peer(domain, ["/tip/pose"]) as peer, session:
        meet(peer, source)
        ticks = peer.node.create_publisher(Clock, "/clock", profile(1, reliable=True))
        until(ticks.get_subscription_count)
        began, lasts, updates, straight = 1.7e9, 0.5, [], np.eye(4)
        straight[2, 3] = ROBOT.length

        def simulate():
            """Ten seconds of simulation pass in a second, from a date on."""
            begin = time.monotonic()
            while (into := 10.0 * (time.monotonic() - begin)) < 20.0 and not over.is_set():
                tick = Clock()
                tick.clock.sec, tick.clock.nanosec = int(began + into), int(1e9 * (into % 1.0))
                ticks.publish(tick)
                peer.send([("/tip/pose", peer.pose(began + into, straight))])
                time.sleep(0.002)
            tick.clock.sec -= 15
            ticks.publish(tick)

        over, thread = threading.Event(), threading.Thread(target=simulate)
        thread.start()
        begin = time.monotonic()
        for update in session:
            updates.append(update)
            if update.time - updates[0].time > 5.0:
                break
        lasts = time.monotonic() - begin
        over.set()
        thread.join()
        assert lasts < 3.0
        assert 0.0 <= updates[0].time < 5.0
        assert abs((updates[-1].stamp >> 32) - began - updates[-1].time) < 1.0
        with pytest.raises(DeviceError, match="went back"):
            session.clock.sleep_until(1e9)


@pytest.mark.parametrize(
    "text", ["ros2?domain=x", "ros2?domain=300", "ros2?a=1", "ros2?clock=mine", "ros2x"]
)
def test_what_is_no_address_is_explained(text):
    with pytest.raises(DeviceError, match="give ros2"):
        Ros2Address.parse(text)


def test_a_source_without_topics_is_explained():
    with pytest.raises(DeviceError, match="give --at /TOPIC"):
        Ros2Source("ros2", ROBOT, ())
