"""A node in a ROS 2 graph of its own context, and the settings of an address."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self
from urllib.parse import parse_qsl, urlsplit

from glissando.errors import DeviceError

_TYPES = ("pose", "transform")
_CLOCKS = ("shared", "arrival", "sender")
_HINT = (
    "give ros2, and after a ? domain=0, name=glissando, frame=world, type=pose|transform, "
    "travel=/TOPIC, clock=shared|arrival|sender."
)


@dataclass(frozen=True)
class Ros2Address:
    """How a node takes part in a graph.

    Attributes:
        domain: ROS domain.
        name: Name of the node, and the namespace of what it publishes.
        frame: The world frame's name in headers.
        type: What poses come as: PoseStamped ("pose") or TransformStamped ("transform").
        travel: Topic of a JointState whose first position is the slide's travel; empty for none.
        clock: How stamps become times, as for OpenIGTLink: "shared", "arrival" or "sender".
    """

    domain: int = 0
    name: str = "glissando"
    frame: str = "world"
    type: str = "pose"
    travel: str = ""
    clock: str = "shared"

    @classmethod
    def parse(cls, text: str) -> Ros2Address:
        """The address of a text such as ros2?domain=5&type=transform.

        Raises:
            DeviceError: The text is none.
        """
        try:
            parts = urlsplit(text)
            options = dict(parse_qsl(parts.query, strict_parsing=bool(parts.query)))
            domain = int(options.pop("domain", "0"))
        except ValueError as problem:
            raise DeviceError(f"{text!r} is no ROS 2 address ({problem}); {_HINT}") from None
        known = {*options} <= {"name", "frame", "type", "travel", "clock"}
        if parts.path != "ros2" or not known or not 0 <= domain <= 232:
            raise DeviceError(f"{text!r} is no ROS 2 address; {_HINT}")
        out = cls(domain=domain, **options)
        if out.type not in _TYPES or out.clock not in _CLOCKS:
            raise DeviceError(f"{text!r} is no ROS 2 address; {_HINT}")
        return out


class Graph:
    """A node while the context lasts.

    Args:
        address: How it takes part.
        suffix: Ends the node's name.

    Attributes:
        node: The rclpy node.

    Raises:
        DeviceError: rclpy or a package of messages is not installed, or the node does not start.
    """

    def __init__(self, address: Ros2Address, suffix: str) -> None:
        self.address, self._suffix = address, suffix
        self.node: Any = None
        self._context: Any = None
        self._executor: Any = None

    def __enter__(self) -> Self:
        try:
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor
        except ImportError as missing:
            raise DeviceError(
                f"ROS 2 needs {missing.name}, which is not installed: run pip install "
                f"'glissando[ros2]' (Python 3.11), or source a ROS 2 installation."
            ) from None
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=self.address.domain)
        self.node = rclpy.create_node(f"{self.address.name}_{self._suffix}", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        return self

    def __exit__(self, *raised: object) -> None:
        if self.node is not None:
            self._executor.shutdown()
            self.node.destroy_node()
            self._context.try_shutdown()
        self.node = None

    def spin(self, most: int = 256) -> None:
        """Run what is ready, `most` callbacks at a time; never waits."""
        for _ in range(most):
            before = self.count
            self._executor.spin_once(timeout_sec=0.0)
            if self.count == before:
                return

    count = 0


def profile(depth: int, *, reliable: bool, latched: bool = False) -> Any:
    """A quality of service that keeps the last `depth` messages.

    Args:
        depth: Messages that wait; the oldest is dropped.
        reliable: Whether lost messages are sent again.
        latched: Whether a late subscriber gets the last ones.
    """
    from rclpy import qos

    return qos.QoSProfile(
        depth=depth,
        history=qos.HistoryPolicy.KEEP_LAST,
        reliability=(
            qos.ReliabilityPolicy.RELIABLE if reliable else qos.ReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            qos.DurabilityPolicy.TRANSIENT_LOCAL if latched else qos.DurabilityPolicy.VOLATILE
        ),
    )
