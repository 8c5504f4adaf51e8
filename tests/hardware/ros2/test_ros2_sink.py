"""What ROS 2 subscribers get is the estimate, and none of them holds it up."""

import time
from functools import partial

import numpy as np
import pytest

from glissando.estimation.confidence_tube import SIGMAS_95
from glissando.geometry import se3
from glissando.hardware.live import LiveSession, RecordingSource
from glissando.hardware.ros2.graph import Graph, Ros2Address, profile
from glissando.hardware.ros2.ros2_sink import Ros2Sink, world_covariance
from live_recordings import ROBOT, ROD, swaying
from waiting import until

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rclpy's own imports


@pytest.mark.slow
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


@pytest.mark.slow
def test_forces_are_arrows_with_their_ellipsoids_and_the_tips_is_a_wrench(domain):
    sink = Ros2Sink(domain)
    source, got = RecordingSource(swaying(), ROD), {}
    with LiveSession(ROD, [source], [sink], points=4, duration=0.4) as session:
        update = list(session)[-1]
        with Graph(Ros2Address.parse(domain), "viewer") as viewer:
            from geometry_msgs.msg import WrenchStamped
            from visualization_msgs.msg import MarkerArray

            latched = profile(1, reliable=True, latched=True)
            kinds = {"tip/measured_cf": WrenchStamped, "markers": MarkerArray}
            for topic, kind in kinds.items():
                keep = partial(got.__setitem__, topic)
                viewer.node.create_subscription(kind, f"/glissando/{topic}", keep, latched)
            until(lambda: viewer.spin() or len(got) == 2)
    loads, said = update.loads(), got["tip/measured_cf"].wrench
    wrench = [getattr(part, axis) for part in (said.force, said.torque) for axis in "xyz"]
    np.testing.assert_allclose(wrench, loads.wrench.wrench[-1], rtol=1e-9)
    arrows = [m for m in got["markers"].markers if m.ns == "forces"]
    balls = [m for m in got["markers"].markers if m.ns == "forces95"]
    assert loads.arclength.tolist() == [0.3, ROD.length]
    for k, (arrow, ball) in enumerate(zip(arrows, balls, strict=True)):
        begin, end = ([p.x, p.y, p.z] for p in arrow.points)
        np.testing.assert_allclose(begin, loads.position[k], atol=1e-12)
        np.testing.assert_allclose(np.subtract(end, begin), 0.2 * loads.wrench.force[k], atol=1e-9)
        at, turn, size = ball.pose.position, ball.pose.orientation, ball.scale
        np.testing.assert_allclose([at.x, at.y, at.z], end, atol=1e-12)
        axes = se3.rotation_from_quaternion(np.array([turn.w, turn.x, turn.y, turn.z]))
        half = axes * [size.x, size.y, size.z] / (2.0 * SIGMAS_95 * 0.2)
        cov = loads.wrench.cov[k, :3, :3]
        np.testing.assert_allclose(half @ half.T, cov, atol=1e-6 * np.abs(cov).max())


@pytest.mark.slow
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


def test_the_covariance_is_that_of_the_world_frame():
    rng = np.random.default_rng(1)
    pose, root = se3.exp(rng.normal(size=6)), rng.normal(size=(18, 18))
    cov = root @ root.T
    steps = 1e-4 * rng.multivariate_normal(np.zeros(6), cov[:6, :6], 20_000)
    moved = pose @ se3.exp(steps)
    turned = se3.so3_log(moved[:, :3, :3] @ pose[:3, :3].T)
    world = np.hstack([moved[:, :3, 3] - pose[:3, 3], turned]) / 1e-4
    stated = world_covariance(pose, cov[:6, :6]).reshape(6, 6)
    np.testing.assert_allclose(np.cov(world.T), stated, atol=0.05 * np.abs(stated).max())
