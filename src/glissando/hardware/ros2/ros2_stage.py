"""A stage driven by a ROS 2 node: goals on one topic, the state of its joint on another."""

from __future__ import annotations

import time
from collections import Counter
from typing import Any, Self

from glissando.hardware.drivers.remote_stage import RemoteStage
from glissando.hardware.ros2.graph import Graph, Ros2Address, measured_at, profile

COMMAND, MEASURED = "/stage/servo_jp", "/stage/measured_js"  # CRTK's names
_DEPTH = 64  # messages in the queue


class Ros2StagePeer:
    """Sends goals as JointState or Float64MultiArray, receives JointState; a context manager.

    Args:
        address: Address as `Ros2Address.parse` takes it, with clock=shared for stamps of this
            computer's wall clock, or clock=arrival to ignore stamps.
        stage: Settings with the names of its topics and its joint.

    Attributes:
        counts: Messages that were 'invalid'.

    Raises:
        DeviceError: The address is invalid, or ROS 2 is not installed.
    """

    def __init__(self, address: str, stage: RemoteStage) -> None:
        self._address = Ros2Address.of_rig(address)
        self._stage, self.counts = stage, Counter[str]()
        self._command, self._measured = stage.command or COMMAND, stage.measured or MEASURED
        self._graph = Graph(self._address, "stage", self._configure)
        self._arrived: list[tuple[float, float]] = []

    def __enter__(self) -> Self:
        self._graph.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._graph.__exit__()

    def _configure(self) -> None:
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        self._joints, self._numbers = JointState, Float64MultiArray
        node, plain = self._graph.node, self._stage.message == "float64_array"
        kind = Float64MultiArray if plain else JointState
        self._goals = node.create_publisher(kind, self._command, profile(1, reliable=True))
        quality = profile(_DEPTH, reliable=False)
        node.create_subscription(JointState, self._measured, self._on_message, quality)

    def _on_message(self, message: Any) -> None:
        joint = self._stage.joint
        try:
            place = message.position[list(message.name).index(joint) if joint else 0]
        except (ValueError, IndexError):
            self.counts["invalid"] += 1
            return
        measured = measured_at(message.header.stamp, time.monotonic(), self._address.clock)
        self._arrived.append((measured, float(place)))

    def positions(self) -> list[tuple[float, float]]:
        """Times and positions that have arrived."""
        self._graph.spin()
        out, self._arrived = self._arrived, []
        return out

    def send(self, place: float, speed: float) -> None:
        """Publish a goal."""
        if self._stage.message == "float64_array":
            self._goals.publish(self._numbers(data=[place]))
            return
        goal = self._joints(name=[self._stage.joint or "slide"], position=[place], velocity=[speed])
        goal.header.stamp = self._graph.node.get_clock().now().to_msg()
        self._goals.publish(goal)

    @property
    def problem(self) -> str:
        """Publisher or subscriber missing in the graph, as a phrase; empty if there is none."""
        if self._graph.problem:
            return self._graph.problem
        if not self._graph.node.count_publishers(self._measured):
            return f"nobody publishes {self._measured}"
        if not self._goals.get_subscription_count():
            return f"nobody hears {self._command}"
        return ""
