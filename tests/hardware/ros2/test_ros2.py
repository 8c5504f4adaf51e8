"""ROS 2 topics in and out, on a graph of this machine."""

import os
import threading
import time
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.evaluation.replay import replay
from glissando.geometry import se3
from glissando.hardware.capture import Coil, Rig, capture
from glissando.hardware.live import LiveSession, Placement, RecordingSource
from glissando.hardware.ros2.graph import Graph, Ros2Address, profile
from glissando.hardware.ros2.ros2_sink import Ros2Sink, world_covariance
from glissando.hardware.ros2.ros2_source import Ros2Source
from glissando.io.recording import load_recording
from glissando.io.session_log import read_session
from glissando.model.slide_path import SlideLimits, SlidePath
from live_recordings import ROBOT, SPAN, Lockstep, reading_messages, swaying, through_wire
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
            _ready(peer, source)
            clock.sleep_until(SPAN[0])
            return list(islice(session, 25))


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
                    np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-12)


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
    assert spaces == ["centreline", "tube95"] + 5 * ["ellipsoids95"] + 2 * ["measured"]
    arrow, tip = got["markers"].markers[-1].points, update.state.pose[-1]
    assert abs(arrow[0].z - ROBOT.length) < 0.02
    assert (
        tip[:3, 2] @ [arrow[1].x - arrow[0].x, arrow[1].y - arrow[0].y, arrow[1].z - arrow[0].z] > 0
    )


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


def test_a_rig_records_a_tracker_that_is_topics(domain, tmp_path):
    rig = Rig("bench", "sliding700", domain, (Coil("tip", 0.7, slides=False, serial="/tip/pose"),))
    seen, over = np.eye(4), threading.Event()
    seen[:3, 3] = 0.1, 0.2, 0.3
    with Peer(domain, ["/tip/pose"]) as peer:

        def track():
            while not over.wait(0.02):
                far = peer.pose(time.time(), np.eye(4))
                far.pose.position.x = 700.0
                peer.send([("/tip/pose", peer.pose(time.time(), seen)), ("/tip/pose", far)])

        thread = threading.Thread(target=track)
        thread.start()
        try:
            path = SlidePath.hold(0.0, 1.5, SlideLimits(1.0, 1.0, 1.0))
            progress = capture(rig, path, tmp_path / "session")
        finally:
            over.set()
            thread.join()
    assert int(progress.problems["tracker invalid"]) > 0
    topic = read_session(tmp_path / "session" / "session.mcap").topics["/tracker/tip"]
    delay = 1e-9 * np.array(topic.time_ns) - topic.column("time")
    assert np.all((delay > -1e-3) & (delay < 0.5))
    np.testing.assert_allclose(topic.column("position"), np.tile(seen[:3, 3], (delay.size, 1)))


@pytest.mark.parametrize(("reliable", "latched"), [(True, True), (True, False), (False, False)])
def test_a_publisher_of_any_quality_is_heard(domain, reliable, latched):
    source = Ros2Source(f"{domain}&clock=arrival", ROBOT, PLACES[1:])
    with source, Peer(domain, []) as peer:
        quality = profile(1, reliable=reliable, latched=latched)
        peer.publishers = {"/tip/pose": peer.node.create_publisher(peer.kind, "/tip/pose", quality)}
        _ready(peer, source)
        send = peer.publishers["/tip/pose"].publish
        until(lambda: send(peer.pose(1.0, np.eye(4))) or source.poll() or source.counts["heard"])


def test_a_topic_of_another_type_is_named(domain):
    source = Ros2Source(f"{domain}&type=transform", ROBOT, PLACES[1:])
    with source, Peer(domain, ["/tip/pose"]):
        why = "/tip/pose is of geometry_msgs/msg/PoseStamped, not geometry_msgs/msg/Transform"
        until(lambda: source.poll() or source.problem.startswith(why))


def test_a_subscriber_that_asks_for_more_than_is_offered_is_counted(domain):
    sink = Ros2Sink(domain)
    with sink, Graph(Ros2Address.parse(domain), "strict") as strict:
        from geometry_msgs.msg import PoseArray
        from rclpy.duration import Duration

        quality = profile(1, reliable=True)
        quality.deadline = Duration(seconds=0.01)
        topic = "/glissando/frames"
        strict.node.create_subscription(PoseArray, topic, lambda m: None, quality)
        until(lambda: sink.poll() or sink.counts["incompatible subscribers"])
        assert not sink.problem


def _an_update():
    with LiveSession(ROBOT, [RecordingSource(swaying(), ROBOT)], points=3) as session:
        return next(iter(session))


class Manager(Graph):
    """A node that calls services of another, as a lifecycle manager does."""

    def call(self, kind, service, nodes, over=lambda: False, **request):
        """The answer of a service, or None if what was asked is over.

        An answer is lost when the service has not met its new client yet, so it is asked again.
        """
        client = self.node.create_client(kind, service)
        until(lambda: [node.poll() for node in nodes] and client.service_is_ready())
        for _ in range(10):
            answer, patience = client.call_async(kind.Request(**request)), time.monotonic() + 3.0
            while not (answer.done() or over() or time.monotonic() > patience):
                for node in nodes:
                    node.poll()
                self.spin()
                time.sleep(0.002)
            if answer.done() or over():
                break
        self.node.destroy_client(client)
        return answer.result() if answer.done() else None

    def change(self, who, number, nodes):
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        graph = nodes[who == "sink"]._graph
        before, service = graph.state, f"/glissando_{who}/change_state"
        changed = lambda: graph.state != before  # noqa: E731
        self.call(ChangeState, service, nodes, changed, transition=Transition(id=number))
        assert changed()


def test_a_manager_configures_activates_deactivates_and_cleans_up(domain):
    from lifecycle_msgs.msg import Transition

    source = Ros2Source(f"{domain}&start=managed&clock=arrival", ROBOT, PLACES[1:])
    sink = Ros2Sink(f"{domain}&start=managed")
    address, seen = Ros2Address.parse(domain), []
    with source, sink, Manager(address, "manager") as manager, Peer(domain, ["/tip/pose"]) as peer:
        from geometry_msgs.msg import PoseStamped

        quality = profile(1, reliable=True)
        tip = "/glissando/tip/measured_cp"
        manager.node.create_subscription(PoseStamped, tip, seen.append, quality)
        update = _an_update()
        send = peer.publishers["/tip/pose"].publish

        def exchanged(key):
            """Messages pass until one is counted under the key."""
            before = source.counts[key]
            happened = lambda: source.poll() or source.counts[key] > before  # noqa: E731
            until(lambda: send(peer.pose(1.0, np.eye(4))) or happened())
            sink.send(update)
            if key == "heard":
                until(lambda: manager.spin() or seen)
            else:
                time.sleep(0.3)
                manager.spin()
            return len(seen)

        nodes = (source, sink)
        assert "unconfigured" in source.problem
        assert "unconfigured" in sink.problem
        assert peer.publishers["/tip/pose"].get_subscription_count() == 0
        for _ in range(2):
            for who in ("source", "sink"):
                manager.change(who, Transition.TRANSITION_CONFIGURE, nodes)
            assert "is inactive" in source.problem
            assert exchanged("ignored") == 0
            for who in ("source", "sink"):
                manager.change(who, Transition.TRANSITION_ACTIVATE, nodes)
            assert not sink.problem
            until(sink._publishers[tip].get_subscription_count)
            assert exchanged("heard") == 1
            seen.clear()
            for who in ("source", "sink"):
                manager.change(who, Transition.TRANSITION_DEACTIVATE, nodes)
            assert exchanged("ignored") == 0
            for who in ("source", "sink"):
                manager.change(who, Transition.TRANSITION_CLEANUP, nodes)
            until(lambda: not peer.publishers["/tip/pose"].get_subscription_count())
        manager.change("source", Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, nodes)
        assert source.finished


def test_parameters_are_set_and_wrong_ones_refused(domain, tmp_path):
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters

    file = tmp_path / "params.yaml"
    file.write_text("/**:\n  ros__parameters:\n    frame_id: aurora\n    marker_rate: 5.0\n")
    sink = Ros2Sink(f"{domain}&params={file}")
    with sink, Manager(Ros2Address.parse(domain), "manager") as manager:

        def set_to(name, **value):
            wanted = Parameter(name=name, value=ParameterValue(**value))
            service = "/glissando_sink/set_parameters"
            return manager.call(SetParameters, service, [sink], parameters=[wanted]).results[0]

        get = sink._graph.node.get_parameter
        assert (get("frame_id").value, get("marker_rate").value) == ("aurora", 5.0)
        text = ParameterType.PARAMETER_STRING
        assert set_to("frame_id", type=text, string_value="map").successful
        assert get("frame_id").value == "map"
        refused = set_to("marker_rate", type=ParameterType.PARAMETER_DOUBLE, double_value=0.0)
        assert "give 0.001 to 1000" in refused.reason
    with pytest.raises(DeviceError, match="no file"):
        Ros2Sink(f"{domain}&params={tmp_path / 'none.yaml'}")


def test_a_session_follows_simulated_time(domain):
    from rosgraph_msgs.msg import Clock

    source = Ros2Source(f"{domain}&clock=sim", ROBOT, PLACES[1:])
    session = LiveSession(ROBOT, [source], rate=20.0)
    with Peer(domain, ["/tip/pose"]) as peer, session:
        _ready(peer, source)
        ticks = peer.node.create_publisher(Clock, "/clock", profile(1, reliable=True))
        until(ticks.get_subscription_count)
        began, lasts, updates = 1.7e9, 0.5, []

        def simulate():
            """Ten seconds of simulation pass in a second, from a date on."""
            begin = time.monotonic()
            while (into := 10.0 * (time.monotonic() - begin)) < 20.0 and not over.is_set():
                tick = Clock()
                tick.clock.sec, tick.clock.nanosec = int(began + into), int(1e9 * (into % 1.0))
                ticks.publish(tick)
                peer.send([("/tip/pose", peer.pose(began + into, np.eye(4)))])
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
