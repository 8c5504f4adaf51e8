"""A manager of ROS 2 decides what nodes do, and sets their parameters."""

import time

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.hardware.live import LiveSession, Placement, RecordingSource
from glissando.hardware.ros2.graph import Ros2Address, profile
from glissando.hardware.ros2.ros2_sink import Ros2Sink
from glissando.hardware.ros2.ros2_source import Ros2Source
from glissando.hardware.ros2.ros2_tracker import Ros2Tracker
from live_recordings import ROBOT, swaying
from ros_peers import PLACES, Manager, Peer
from waiting import until

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rclpy's own imports


def _an_update():
    with LiveSession(ROBOT, [RecordingSource(swaying(), ROBOT)], points=3) as session:
        return next(iter(session))


@pytest.mark.slow
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
    file.write_text("/**:\n  ros__parameters:\n    frame_id: aurora\n    marker_rate: 5\n")
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


@pytest.mark.parametrize("given", ["marker_rate: 0.0", "marker_rate: fast", "frame_id: 5"])
def test_parameters_of_a_file_are_judged_as_those_that_are_set(domain, tmp_path, given):
    file = tmp_path / "params.yaml"
    file.write_text(f"/**:\n  ros__parameters:\n    {given}\n")
    name, _, value = given.partition(": ")
    sentence = rf"glissando_sink cannot be configured: {name} is '?{value}'?; give "
    with pytest.raises(DeviceError, match=sentence):
        Ros2Sink(f"{domain}&params={file}").__enter__()


@pytest.mark.parametrize("topic", ["/bad topic", "//x"])
def test_a_topic_that_cannot_be_is_a_sentence(domain, topic):
    sentence = rf"cannot be configured: Invalid topic name: .*'{topic}'$"
    with pytest.raises(DeviceError, match=sentence):
        Ros2Source(domain, ROBOT, [Placement(topic, 0.1, "coil")]).__enter__()
    with pytest.raises(DeviceError, match=sentence):
        Ros2Tracker(domain, [topic]).__enter__()
    source = Ros2Source(f"{domain}&start=managed", ROBOT, [Placement(topic, 0.1, "coil")])
    with source:
        source._graph.node.trigger_configure()
        assert topic in source.problem
