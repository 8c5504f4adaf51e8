"""ROS 2 topics in and out, on a graph of this machine."""

import os
import time

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.evaluation.replay import replay
from glissando.geometry import se3
from glissando.hardware.live import LiveSession, Placement, RecordingSource
from glissando.hardware.ros2.graph import Graph, Ros2Address, profile
from glissando.hardware.ros2.ros2_sink import Ros2Sink, world_covariance
from glissando.hardware.ros2.ros2_source import Ros2Source
from glissando.io.recording import load_recording
from live_recordings import ROBOT, SPAN, Lockstep, swaying
from waiting import until

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rclpy's own imports

PLACES = (Placement("/base/pose", 0.0), Placement("/tip/pose", ROBOT.length))
REASON = "rclpy is not installed; pip install 'glissando[ros2]' has wheels for Python 3.11"


@pytest.fixture
def domain():
    """An address in a domain of this test's own."""
    pytest.importorskip("rclpy", reason=REASON)
    return f"ros2?domain={100 + os.getpid() % 100}"


class Peer(Graph):
    """A node that publishes poses, as a tracker's driver does."""

    def __init__(self, domain, names):
        super().__init__(Ros2Address.parse(domain), "peer")
        self.names = names

    def __enter__(self):
        super().__enter__()
        from geometry_msgs.msg import PoseStamped

        self.kind = PoseStamped
        quality = profile(500, reliable=True)
        self.publishers = {
            n: self.node.create_publisher(PoseStamped, n, quality) for n in self.names
        }
        return self

    def send(self, messages):
        for name, message in messages:
            self.publishers[name].publish(message)
        return True

    receive = peers = None

    def pose(self, seconds, pose):
        message = self.kind()
        nanoseconds = round(1e9 * seconds)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 10**9)
        place, turn = message.pose.position, message.pose.orientation
        place.x, place.y, place.z = pose[:3, 3].tolist()
        turn.w, turn.x, turn.y, turn.z = se3.quaternion(pose[:3, :3]).tolist()
        return message


def _ready(peer, source):
    until(lambda: all(p.get_subscription_count() for p in peer.publishers.values()))
    until(lambda: not source.problem)


def test_poses_through_ros_estimate_what_a_replay_does(domain, tmp_path):
    recording = swaying(2)
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
        session = LiveSession(ROBOT, [source], journal=tmp_path / "log", clock=clock, patience=1e9)
        with session:
            _ready(peer, source)
            clock.sleep_until(SPAN[0])
            live = []
            for update in session:
                live.append(update)
                if len(live) == 25:
                    break
    window = live[0].time, live[-1].time
    again = replay(load_recording(tmp_path / "log"), ROBOT, window=window)
    for update, state in zip(live, again.states, strict=True):
        np.testing.assert_allclose(update.newest.pose, state.pose, rtol=0, atol=1e-12)
        np.testing.assert_allclose(update.newest.cov, state.cov, rtol=1e-9, atol=1e-12)
    logged = load_recording(tmp_path / "log").streams["tip_pose"].rows
    true = streams[1].rows
    np.testing.assert_allclose(logged.time, true.time[: logged.time.size], atol=1e-9)
    np.testing.assert_allclose(logged.values, true.values[: logged.time.size], atol=1e-14)


def test_what_is_no_pose_is_counted(domain):
    with Peer(domain, ["/tip/pose"]) as peer:
        source = Ros2Source(f"{domain}&clock=arrival", ROBOT, PLACES[1:])
        with LiveSession(ROBOT, [source]) as session:
            _ready(peer, source)
            far, skew = peer.pose(1.0, np.eye(4)), peer.pose(1.0, np.eye(4))
            far.pose.position.x, skew.pose.orientation.w = 466.0, 0.2
            good = np.eye(4)
            good[2, 3] = 0.466
            peer.send([("/tip/pose", m) for m in (far, skew, peer.pose(1.0, good))])
            (read,) = next(iter(session)).readings
        assert source.counts == {"heard": 3, "invalid": 2}
        np.testing.assert_allclose(read.values[0], good, atol=1e-12)


def test_a_late_subscriber_of_any_quality_gets_the_newest_update(domain):
    source, sink = RecordingSource(swaying(), ROBOT), Ros2Sink(domain)
    with LiveSession(ROBOT, [source], [sink], points=5, duration=0.3) as session:
        update = list(session)[-1]
        with Graph(Ros2Address.parse(domain), "late") as viewer:
            from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
            from visualization_msgs.msg import MarkerArray

            got = {}
            kinds = {"tip/pose": PoseWithCovarianceStamped, "frames": PoseArray}
            for topic, kind in {**kinds, "markers": MarkerArray}.items():
                quality = profile(1, reliable=True, latched=True)

                def keep(message, topic=topic):
                    got[topic] = message
                    viewer.count += 1

                viewer.node.create_subscription(kind, f"/glissando/{topic}", keep, quality)
            until(lambda: viewer.spin() or len(got) == 3)
    place = got["tip/pose"].pose.pose.position
    np.testing.assert_allclose([place.x, place.y, place.z], update.tip, atol=1e-12)
    cov = np.array(got["tip/pose"].pose.covariance).reshape(6, 6)
    np.testing.assert_allclose(cov[:3, :3], update.state.cov_position_world[-1], rtol=1e-9)
    stamp = got["frames"].header.stamp
    assert abs(stamp.sec + 1e-9 * stamp.nanosec - time.time()) < 60.0
    assert len(got["frames"].poses) == 5
    spaces = [marker.ns for marker in got["markers"].markers]
    assert spaces == ["centreline", "tube95"] + 5 * ["ellipsoids95"]


def test_a_reader_that_stops_reading_holds_nobody_up(domain):
    sink = Ros2Sink(domain)
    with Graph(Ros2Address.parse(domain), "stuck") as stuck:
        from geometry_msgs.msg import PoseArray

        quality = profile(1000, reliable=True)  # and is never spun
        topic = "/glissando/frames"
        stuck.node.create_subscription(PoseArray, topic, lambda m: None, quality)
        source = RecordingSource(swaying(), ROBOT)
        with LiveSession(ROBOT, [source], [sink], points=30) as session:
            until(lambda: sink._publishers[topic].get_subscription_count())
            spent = []
            for update in session:
                began = time.thread_time()
                sink.send(update)
                spent.append(time.thread_time() - began)
    assert np.median(spent) < 0.02


def test_the_covariance_is_that_of_the_world_frame():
    rng = np.random.default_rng(1)
    pose, root = se3.exp(rng.normal(size=6)), rng.normal(size=(18, 18))
    cov = root @ root.T
    steps = 1e-4 * rng.multivariate_normal(np.zeros(6), cov[:6, :6], 20_000)
    moved = pose @ se3.exp(steps)
    turned = se3.so3_log(moved[:, :3, :3] @ pose[:3, :3].T)
    world = np.hstack([moved[:, :3, 3] - pose[:3, 3], turned]) / 1e-4
    stated = world_covariance(pose, cov).reshape(6, 6)
    np.testing.assert_allclose(np.cov(world.T), stated, atol=0.05 * np.abs(stated).max())


@pytest.mark.parametrize(
    "text", ["ros2?domain=x", "ros2?domain=300", "ros2?a=1", "ros2?clock=mine", "ros2x"]
)
def test_what_is_no_address_is_explained(text):
    with pytest.raises(DeviceError, match="give ros2"):
        Ros2Address.parse(text)


def test_a_source_without_topics_is_explained():
    with pytest.raises(DeviceError, match="give --at /TOPIC"):
        Ros2Source("ros2", ROBOT, ())
