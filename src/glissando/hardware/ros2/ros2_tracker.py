"""Topics of a ROS 2 graph as a tracker, for any driver that publishes poses."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Sequence
from functools import partial
from typing import Any, Self

from glissando.errors import DeviceError
from glissando.hardware.drivers.aurora_reply import Frame, PortReading
from glissando.hardware.drivers.aurora_setup import Tool
from glissando.hardware.ros2.graph import Graph, Ros2Address, measured_at, profile
from glissando.hardware.ros2.ros2_source import pose_of

_DEPTH = 64  # messages in the queue of a topic
_WAITING = 1024  # messages queued in all
_PAUSE = 0.002  # s between polls


class Ros2Tracker:
    """Reads PoseStamped or TransformStamped topics as frames of one tool each; a context manager.

    Args:
        address: Address as `Ros2Address.parse` takes it, with clock=shared for stamps of this
            computer's wall clock, or clock=arrival to ignore stamps.
        topics: Names of the topics.

    Attributes:
        tools: The topics as tools, with their names as serial numbers.
        counts: Messages that were 'invalid', or 'dropped' because the queue was full.

    Raises:
        DeviceError: The address is invalid, or ROS 2 is not installed.
    """

    def __init__(self, address: str, topics: Sequence[str]) -> None:
        self._address = Ros2Address.of_rig(address)
        self.tools = [Tool(k, topic, "ros2", str(k)) for k, topic in enumerate(topics)]
        self.counts = Counter[str]()
        self._graph = Graph(self._address, "tracker", self._subscribe)
        self._waiting, self._number = deque[tuple[Tool, Any, float]](), 0

    def __enter__(self) -> Self:
        self._graph.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._graph.__exit__()

    def _subscribe(self) -> None:
        from geometry_msgs.msg import PoseStamped, TransformStamped

        kind = PoseStamped if self._address.type == "pose" else TransformStamped
        quality = profile(_DEPTH, reliable=False)
        for tool in self.tools:
            on_message = partial(self._on_message, tool)
            self._graph.node.create_subscription(kind, tool.serial, on_message, quality)

    def _on_message(self, tool: Tool, message: Any) -> None:
        self._waiting.append((tool, message, time.monotonic()))
        if len(self._waiting) > _WAITING:
            self._waiting.popleft()
            self.counts["dropped"] += 1

    def read(self, timeout: float) -> Frame | None:
        """Wait for the next message, and return its pose as a frame; None after a timeout.

        Args:
            timeout: Seconds to wait.
        """
        deadline = time.monotonic() + timeout
        while True:
            self._graph.spin()
            while self._waiting:
                try:
                    return self._frame(*self._waiting.popleft())
                except DeviceError:
                    self.counts["invalid"] += 1
            if time.monotonic() > deadline:
                return None
            time.sleep(_PAUSE)

    def _frame(self, tool: Tool, message: Any, arrival: float) -> Frame:
        pose = pose_of(message, tool.serial)
        measured = measured_at(message.header.stamp, arrival, self._address.clock)
        self._number += 1
        port = PortReading(tool.handle, "valid", self._number, 0, pose, 0.0)
        return Frame(self._number, measured, 0.0, arrival, (port,))
