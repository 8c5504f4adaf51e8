"""A managed node in a ROS 2 graph with its own context, and the options of an address.

The node has the life cycle of https://design.ros2.org/articles/node_lifecycle.html: unconfigured,
inactive, active, finalized. It activates itself unless the address has start=managed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from urllib.parse import parse_qsl, urlsplit

from glissando.errors import DeviceError, needing

_TYPES = ("pose", "transform")
_CLOCKS = ("shared", "arrival", "sender", "sim")
_STARTS = ("self", "managed")
ROS_PACKAGES = "ROS 2 needs its packages, of Python 3.11 or of a sourced installation"
"""Start of the error message for a missing package."""
_HINT = (
    "give ros2, and after a ? domain=0, name=glissando, frame=world, type=pose|transform, "
    "travel=/TOPIC, clock=shared|arrival|sender|sim, start=self|managed, params=FILE."
)


@dataclass(frozen=True)
class Ros2Address:
    """Address of a ROS 2 graph, with the options of a node in it.

    Attributes:
        domain: ROS domain.
        name: Name of the node, and namespace of its topics.
        frame: Name of the world frame in headers.
        type: Type of messages of poses: PoseStamped ("pose") or TransformStamped ("transform").
        travel: Topic of a JointState whose first position is the slide's travel; empty for none.
        clock: Conversion of stamps to times, as for OpenIGTLink: "shared", "arrival" or "sender";
            "sim" sets the parameter use_sim_time, so that the session follows the topic /clock.
        start: Whether the node configures and activates itself ("self") or waits for a manager to
            do so ("managed").
        params: File of parameters, as for `ros2 run … --params-file`; empty for none.
    """

    domain: int = 0
    name: str = "glissando"
    frame: str = "world"
    type: str = "pose"
    travel: str = ""
    clock: str = "shared"
    start: str = "self"
    params: str = ""

    @classmethod
    def parse(cls, text: str) -> Ros2Address:
        """Parse an address such as ros2?domain=5&type=transform.

        Raises:
            DeviceError: The text is not such an address, or the file of parameters does not exist.
        """
        try:
            parts = urlsplit(text)
            options = dict(parse_qsl(parts.query, strict_parsing=bool(parts.query)))
            domain = int(options.pop("domain", "0"))
        except ValueError as problem:
            raise DeviceError(f"{text!r} is no ROS 2 address ({problem}); {_HINT}") from None
        known = {*options} <= {"name", "frame", "type", "travel", "clock", "start", "params"}
        if parts.path != "ros2" or not known or not 0 <= domain <= 232:
            raise DeviceError(f"{text!r} is no ROS 2 address; {_HINT}")
        out = cls(domain=domain, **options)
        if out.type not in _TYPES or out.clock not in _CLOCKS or out.start not in _STARTS:
            raise DeviceError(f"{text!r} is no ROS 2 address; {_HINT}")
        if out.params and not Path(out.params).is_file():
            raise DeviceError(f"There is no file {out.params!r} of parameters; correct params=.")
        return out

    @classmethod
    def of_rig(cls, text: str) -> Ros2Address:
        """Parse the address of a device of a rig, whose times are on this computer's clock.

        Raises:
            DeviceError: The text is not an address, or has another clock.
        """
        out = cls.parse(text)
        if out.clock not in ("shared", "arrival"):
            raise DeviceError(
                f"{text}: a recording keeps this computer's time; give clock=shared or arrival."
            )
        return out


class Graph:
    """A managed node that exists while the context lasts.

    Args:
        address: Address with the node's options.
        suffix: End of the node's name.
        configure: Called when the node is configured, to create publishers and subscriptions.
        cleanup: Called when the node is cleaned up or shut down, to destroy them.

    Attributes:
        node: The rclpy node.
        state: "unconfigured", "inactive", "active" or "finalized".

    Raises:
        DeviceError: rclpy or a message package is not installed, or the node does not start.
    """

    def __init__(
        self,
        address: Ros2Address,
        suffix: str,
        configure: Callable[[], None] = lambda: None,
        cleanup: Callable[[], None] = lambda: None,
    ) -> None:
        self.address, self.name = address, f"{address.name}_{suffix}"
        self.configure, self.cleanup = configure, cleanup
        self.node: Any = None
        self.state = "unconfigured"
        self._failure = ""  # of the last transition, which rclpy does not report
        self._context: Any = None
        self._executor: Any = None

    def __enter__(self) -> Self:
        with needing(ROS_PACKAGES, "ros2", DeviceError):
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor, TimeoutException
        self._context, self._idle = Context(), TimeoutException
        args = ["--ros-args", "--params-file", self.address.params] if self.address.params else []
        try:
            rclpy.init(args=args, context=self._context, domain_id=self.address.domain)
            self.node = _managed_node(self, self._context)
        except Exception as problem:  # rclpy's own errors share no other base
            self._context.try_shutdown()
            raise DeviceError(
                f"The ROS 2 node {self.name} did not start ({_one_line(problem)}); correct "
                f"params= and name=."
            ) from None
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        if self.address.start == "self":
            self.node.trigger_configure()
            if self._failure:
                failure = self._failure
                self.__exit__()
                raise DeviceError(f"The ROS 2 node {self.name} cannot be configured: {failure}")
            self.node.trigger_activate()
        return self

    def __exit__(self, *raised: object) -> None:
        if self.node is not None:
            self._executor.shutdown()
            self.node.destroy_node()
            self._context.try_shutdown()
        self.node = None

    @property
    def problem(self) -> str:
        """Reason why the node is not active; empty while it is."""
        if self.state == "active":
            return ""
        why = f" ({self._failure})" if self._failure else ""
        return f"the ROS 2 node {self.name} is {self.state}{why}"

    def move(self, state: str, action: Callable[[], None]) -> None:
        """Perform the action of a transition, and set the new state if it succeeds."""
        self._failure = ""
        try:
            action()
        except Exception as problem:
            self._failure = _one_line(problem)
            raise
        self.state = state

    def spin(self, most: int = 256) -> None:
        """Run waiting callbacks, about `most` at a time; does not wait.

        One wait of the executor yields at most one message of each topic, hence the repetition.
        """
        worked = True
        for _ in range(most):
            try:
                ready, _, _ = self._executor.wait_for_ready_callbacks(timeout_sec=0.0)
            except self._idle:
                if not worked:
                    return
                worked = False
                continue
            worked = True
            ready()
            ready.result()  # raises the exception of the callback, if any


def _one_line(problem: Exception) -> str:
    """Message of an rcl error on one line, without the line that marks its position."""
    lines = [line.strip() for line in str(problem).splitlines()]
    return " ".join(line for line in lines if line != "^")


def _managed_node(graph: Graph, context: Any) -> Any:
    """Construct a lifecycle node whose transitions are those of a graph."""
    from rclpy.lifecycle import LifecycleNode
    from rclpy.parameter import Parameter

    def moves_to(state: str, transition: Any, action: Callable[[], None] = lambda: None) -> Any:
        def on_transition(self: Any, previous: Any) -> Any:
            graph.move(state, action)
            return transition(self, previous)

        return on_transition

    managed = type(
        "ManagedNode",
        (LifecycleNode,),
        {
            "on_configure": moves_to("inactive", LifecycleNode.on_configure, graph.configure),
            "on_activate": moves_to("active", LifecycleNode.on_activate),
            "on_deactivate": moves_to("inactive", LifecycleNode.on_deactivate),
            "on_cleanup": moves_to("unconfigured", LifecycleNode.on_cleanup, graph.cleanup),
            "on_shutdown": moves_to("finalized", LifecycleNode.on_shutdown, graph.cleanup),
        },
    )
    simulated = [Parameter("use_sim_time", value=True)] if graph.address.clock == "sim" else []
    return managed(graph.name, context=context, parameter_overrides=simulated)


def measured_at(stamp: Any, arrival: float, clock: str) -> float:
    """Time at which a message was measured, s of time.monotonic().

    Args:
        stamp: Stamp of its header; zero for none.
        arrival: Time at which it arrived, s of time.monotonic().
        clock: "shared", or "arrival" to ignore stamps.
    """
    if clock == "arrival" or not (stamp.sec or stamp.nanosec):
        return arrival
    return float(stamp.sec + 1e-9 * stamp.nanosec - (time.time() - time.monotonic()))


def profile(depth: int, *, reliable: bool, latched: bool = False) -> Any:
    """Quality of service that keeps the last `depth` messages.

    Args:
        depth: Size of the queue; the oldest message is dropped.
        reliable: Whether lost messages are sent again.
        latched: Whether a late subscriber receives the last messages.
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
