"""A managed node in a ROS 2 graph of its own context, and the settings of an address.

The node has the life cycle of https://design.ros2.org/articles/node_lifecycle.html: unconfigured,
inactive, active, finalized. It activates itself unless a manager is to do that.
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
"""What a missing package means."""
_HINT = (
    "give ros2, and after a ? domain=0, name=glissando, frame=world, type=pose|transform, "
    "travel=/TOPIC, clock=shared|arrival|sender|sim, start=self|managed, params=FILE."
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
        clock: How stamps become times, as for OpenIGTLink: "shared", "arrival" or "sender"; "sim"
            sets the parameter use_sim_time, with which the session follows the topic /clock.
        start: Who configures and activates the node: it does so by itself ("self"), or waits for
            a manager ("managed").
        params: File of parameters, as `ros2 run … --params-file` takes it; empty for none.
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
        """The address of a device of a rig, whose times are this computer's.

        Raises:
            DeviceError: The text is none, or keeps another time.
        """
        out = cls.parse(text)
        if out.clock not in ("shared", "arrival"):
            raise DeviceError(
                f"{text}: a recording keeps this computer's time; give clock=shared or arrival."
            )
        return out


class Graph:
    """A managed node while the context lasts.

    Args:
        address: How it takes part.
        suffix: Ends the node's name.
        configure: Called when the node becomes inactive at first, to declare what it has.
        cleanup: Called when it becomes unconfigured again, to give that back.

    Attributes:
        node: The rclpy node.
        state: "unconfigured", "inactive", "active" or "finalized".

    Raises:
        DeviceError: rclpy or a package of messages is not installed, or the node does not start.
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
        self._failure = ""  # of the last transition, which rclpy does not pass on
        self._context: Any = None
        self._executor: Any = None

    def __enter__(self) -> Self:
        with needing(ROS_PACKAGES, "ros2", DeviceError):
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor, TimeoutException
        self._context, self._idle = Context(), TimeoutException
        given = ["--ros-args", "--params-file", self.address.params] if self.address.params else []
        try:
            rclpy.init(args=given, context=self._context, domain_id=self.address.domain)
            self.node = _managed_node(self, self._context)
        except Exception as problem:  # rclpy's own errors share no other base
            self._context.try_shutdown()
            raise DeviceError(
                f"The ROS 2 node {self.name} did not start ({_in_a_line(problem)}); correct "
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
        """Why the node does nothing; empty while it is active."""
        if self.state == "active":
            return ""
        why = f" ({self._failure})" if self._failure else ""
        return f"the ROS 2 node {self.name} is {self.state}{why}"

    def move(self, state: str, action: Callable[[], None]) -> None:
        """Do what leads to a state, and take it."""
        self._failure = ""
        try:
            action()
        except Exception as problem:
            self._failure = _in_a_line(problem)
            raise
        self.state = state

    def spin(self, most: int = 256) -> None:
        """Run what is ready, about `most` callbacks at a time; never waits.

        A look of the executor ends after one message of each topic: it is empty if there was none.
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
            ready.result()  # raises what the callback raised


def _in_a_line(problem: Exception) -> str:
    """What rcl says in a line, with a mark below."""
    lines = [line.strip() for line in str(problem).splitlines()]
    return " ".join(line for line in lines if line != "^")


def _managed_node(graph: Graph, context: Any) -> Any:
    """A node whose life cycle is that of a graph."""
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
    """When a message was measured, s of time.monotonic().

    Args:
        stamp: Of its header; zero if it states none.
        arrival: When it came, s of time.monotonic().
        clock: "shared", or "arrival" where stamps mean nothing.
    """
    if clock == "arrival" or not (stamp.sec or stamp.nanosec):
        return arrival
    return float(stamp.sec + 1e-9 * stamp.nanosec - (time.time() - time.monotonic()))


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
