"""Updates as ROS 2 topics, for RViz, Foxglove and controllers.

| topic | type | |
|---|---|---|
| `/glissando/tip/measured_cp` | PoseStamped | pose of the last frame |
| `/glissando/tip/pose` | PoseWithCovarianceStamped | the same with its covariance, in world axes |
| `/glissando/frames` | PoseArray | all frames |
| `/glissando/markers` | MarkerArray | markers of `MarkerBuilder` |
| `/glissando/tip/measured_cf` | WrenchStamped | load at the tip, for a mechanical prior |
| `/diagnostics` | DiagnosticArray | once a second, if that package is installed |

Publishers are reliable and keep the last message for late subscribers. A subscriber that requests
more, such as a deadline, receives nothing and is counted.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, Self

import numpy as np

from glissando.errors import DeviceError, needing
from glissando.geometry.se3 import Array
from glissando.hardware.live.update import Update
from glissando.hardware.ros2.graph import ROS_PACKAGES, Graph, Ros2Address, profile
from glissando.hardware.ros2.markers import MarkerBuilder

_RATES = {"marker_rate": 10.0, "diagnostic_rate": 1.0}  # default rates, Hz
_NUMBERS = {**_RATES, "metres_per_newton": 0.2}


class Ros2Sink:
    """Publishes updates while its node is active.

    Parameters of the node: `frame_id` of headers, `marker_rate` and `diagnostic_rate` in Hz, and
    `metres_per_newton`, the length of a force's arrow per newton.

    Args:
        address: Address as `Ros2Address.parse` takes it.

    Attributes:
        counts: Number of 'incompatible subscribers', by their quality of service.

    Raises:
        DeviceError: The address is invalid, or ROS 2 is not installed.
    """

    def __init__(self, address: str) -> None:
        self.name, self.counts = address, Counter[str]()
        self._address = Ros2Address.parse(address)
        self._graph = Graph(self._address, "sink", self._advertise, self._withdraw)
        self._publishers: dict[str, Any] = {}
        self._marked = self._diagnosed = -np.inf

    def __enter__(self) -> Self:
        with needing(ROS_PACKAGES, "ros2", DeviceError):
            from geometry_msgs import msg as geometry
            from visualization_msgs import msg as visualization
        try:
            from diagnostic_msgs import msg as diagnostic
        except ImportError:
            diagnostic = None
        self._geometry, self._visualization = geometry, visualization
        self._markers = MarkerBuilder(geometry, visualization)
        self._diagnostic: Any = diagnostic
        self._graph.__enter__()
        return self

    def __exit__(self, *raised: object) -> None:
        self._graph.__exit__()

    @property
    def problem(self) -> str:
        """Reason why nothing is published; empty while the node is active."""
        return "" if self._graph.node is None else self._graph.problem

    def _advertise(self) -> None:
        from rclpy.event_handler import PublisherEventCallbacks

        node, name, geometry = self._graph.node, self._address.name, self._geometry
        kinds = {
            f"/{name}/tip/measured_cp": geometry.PoseStamped,
            f"/{name}/tip/pose": geometry.PoseWithCovarianceStamped,
            f"/{name}/tip/measured_cf": geometry.WrenchStamped,
            f"/{name}/frames": geometry.PoseArray,
            f"/{name}/markers": self._visualization.MarkerArray,
        }
        if self._diagnostic is not None:
            kinds["/diagnostics"] = self._diagnostic.DiagnosticArray
        quality = profile(1, reliable=True, latched=True)
        events = PublisherEventCallbacks(incompatible_qos=self._count_incompatible)
        self._publishers = {
            topic: node.create_lifecycle_publisher(kind, topic, quality, event_callbacks=events)
            for topic, kind in kinds.items()
        }
        if not node.has_parameter("frame_id"):
            self._declare_parameters()

    def _declare_parameters(self) -> None:
        """Declare the node's parameters. Raises DeviceError for a value out of range."""
        from rcl_interfaces.msg import ParameterDescriptor

        node, defaults = self._graph.node, {"frame_id": self._address.frame, **_NUMBERS}
        descriptor = ParameterDescriptor(dynamic_typing=True)  # a rate may be 10 or 10.0
        given = [node.declare_parameter(name, defaults[name], descriptor) for name in defaults]
        if not (checked := _checked(given)).successful:
            raise DeviceError(checked.reason)
        node.add_on_set_parameters_callback(_checked)

    def _count_incompatible(self, event: Any) -> None:
        self.counts["incompatible subscribers"] += event.total_count_change

    def _withdraw(self) -> None:
        for publisher in self._publishers.values():
            self._graph.node.destroy_lifecycle_publisher(publisher)
        self._publishers = {}

    def poll(self) -> None:
        """Handle requests to the node, such as transitions and changes of parameters."""
        self._graph.spin()

    def send(self, update: Update) -> None:
        """Publish an update, unless the node is inactive."""
        if self._graph.state != "active":
            return
        name, geometry = self._address.name, self._geometry
        self._markers.note(update)
        poses = [self._markers.pose(pose) for pose in update.state.pose]
        tip = geometry.PoseStamped(pose=poses[-1])
        uncertain = geometry.PoseWithCovarianceStamped()
        uncertain.pose.pose = poses[-1]
        newest = update.state.take(-1)
        cov = newest.cov[:6, :6].copy()
        cov[:3, :3] = newest.position_covariance()
        uncertain.pose.covariance = world_covariance(newest.pose, cov)
        frames = geometry.PoseArray(poses=poses)
        for topic, message in (
            (f"/{name}/tip/measured_cp", tip),
            (f"/{name}/tip/pose", uncertain),
            (f"/{name}/frames", frames),
        ):
            message.header = self._header(update)
            self._publishers[topic].publish(message)
        if update.time - self._marked >= self._period("marker_rate"):
            self._marked = update.time
            self._publish_markers(update)
        since = update.time - self._diagnosed
        if self._diagnostic is not None and since >= self._period("diagnostic_rate"):
            self._diagnosed = update.time
            self._publishers["/diagnostics"].publish(self._diagnosis(update))

    def _publish_markers(self, update: Update) -> None:
        """Publish the markers and the load at the tip."""
        name, loads, header = self._address.name, update.loads(), self._header(update)
        scale = float(self._graph.node.get_parameter("metres_per_newton").value)
        markers = self._markers.array(update, loads, header, scale)
        self._publishers[f"/{name}/markers"].publish(markers)
        if loads is not None:
            tip = self._geometry.WrenchStamped(header=header)
            force, moment = tip.wrench.force, tip.wrench.torque
            force.x, force.y, force.z = loads.wrench.force[-1].tolist()
            moment.x, moment.y, moment.z = loads.wrench.moment[-1].tolist()
            self._publishers[f"/{name}/tip/measured_cf"].publish(tip)

    def _period(self, rate: str) -> float:
        """Seconds between messages at the rate of a parameter, less a rounding tolerance."""
        return 1.0 / float(self._graph.node.get_parameter(rate).value) - 1e-6

    def _header(self, update: Update) -> Any:
        header = self._geometry.PoseStamped().header
        header.frame_id = self._graph.node.get_parameter("frame_id").value
        header.stamp.sec = update.stamp >> 32
        header.stamp.nanosec = ((update.stamp & 0xFFFFFFFF) * 1_000_000_000) >> 32
        return header

    def _diagnosis(self, update: Update) -> Any:
        status = self._diagnostic.DiagnosticStatus(name="glissando: live estimate")
        well = update.smoother.fits and not update.problems
        status.level = status.OK if well else status.WARN
        fits = "" if update.smoother.fits else "innovations are larger than the model allows"
        status.message = "; ".join(filter(None, (*update.problems, fits))) or "well"
        figures = {
            "time": update.time, "tip_sigma_m": update.std_tip, "latency_s": update.latency,
            "nis": update.smoother.nis, "skipped": update.skipped,
        }  # fmt: skip
        pair = self._diagnostic.KeyValue
        status.values = [pair(key=key, value=str(value)) for key, value in figures.items()]
        out = self._diagnostic.DiagnosticArray(status=[status])
        out.header = self._header(update)
        return out


def _checked(parameters: list[Any]) -> Any:
    """Validate new values of parameters; the result contains the reason of a rejection."""
    from rcl_interfaces.msg import SetParametersResult

    for parameter in parameters:
        name, value, reason = parameter.name, parameter.value, ""
        if name in _NUMBERS and not (type(value) in (int, float) and 1e-3 <= value <= 1e3):
            unit = "Hz" if name in _RATES else "m/N"
            reason = f"{name} is {value!r}; give 0.001 to 1000 {unit}."
        elif name == "frame_id" and not (isinstance(value, str) and value):
            reason = f"frame_id is {value!r}; give a name."
        if reason:
            return SetParametersResult(successful=False, reason=reason)
    return SetParametersResult(successful=True)


def world_covariance(pose: Array, cov: Array) -> Array:
    """Covariance (36,) of a pose as ROS states it: [x, y, z, rotation about X, Y, Z] in world axes.

    Args:
        pose: Pose (4, 4), body to world.
        cov: Covariance (6, 6) of the pose, in the body frame.
    """
    turn = np.kron(np.eye(2), pose[:3, :3])
    out: Array = (turn @ cov @ turn.T).ravel()
    return out
