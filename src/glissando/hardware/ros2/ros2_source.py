"""Readings from ROS 2 topics: PoseStamped, TransformStamped, Imu, and travel from JointState."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Sequence
from functools import partial
from typing import Any, Self

import numpy as np

from glissando.errors import DeviceError, GlissandoError, RobotFileError, needing
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.live.placement import NoTravelError, Placement, reading, require_on_robot
from glissando.hardware.ros2.graph import ROS_PACKAGES, Graph, Ros2Address, profile
from glissando.hardware.ros2.simulated_clock import SimulatedClock
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.slide_track import SlideTrack

_DEPTH = 1024  # messages in the queue of a topic
_WAITING = 4096  # messages queued in all
_FAR = 20.0  # m from the origin: no tracker reaches there
_FASTEST = 100.0  # rad/s
_PATIENCE = 0.5  # s between checks of the publishers


class Ros2Source:
    """Readings of devices, one topic each; subscriptions accept any publisher's quality of service.

    Args:
        address: Address as `Ros2Address.parse` takes it.
        robot: The robot, which defines the noise of each kind of sensor.
        placements: Positions of devices named by their topics; a "gyro" is an Imu, others poses.

    Attributes:
        counts: Messages 'heard', 'invalid', 'dropped' because the queue was full, 'ignored' while
            the node was inactive, and of sliding devices while the travel is unknown ('no travel').
        clock: Clock of the simulated time, if the node's parameter use_sim_time is set; else None.

    Raises:
        DeviceError: The address or a placement is invalid, or ROS 2 is not installed.
    """

    first: float | None = None
    clock: SimulatedClock | None = None

    def __init__(self, address: str, robot: Robot, placements: Sequence[Placement]) -> None:
        require_on_robot(placements, robot)
        if not placements:
            raise DeviceError("A ROS 2 source needs topics; give --at /TOPIC=METRES.")
        self.name, self._robot = address, robot
        self.counts: Counter[str] = Counter()
        self._address = Ros2Address.parse(address)
        self._graph = Graph(self._address, "source", self._subscribe, self._unsubscribe)
        self._placements, self._slide = placements, SlideTrack()
        self._subscriptions: list[Any] = []
        self._silence, self._looked = "", -np.inf
        self._waiting: deque[tuple[Placement | None, Any, float]] = deque()  # None for the travel
        self._clock_begun = False

    def __enter__(self) -> Self:
        with needing(ROS_PACKAGES, "ros2", DeviceError):
            from geometry_msgs.msg import PoseStamped, TransformStamped
            from sensor_msgs.msg import Imu, JointState
        poses = PoseStamped if self._address.type == "pose" else TransformStamped
        self._kinds = {p: Imu if p.kind == "gyro" else poses for p in self._placements}
        self._topics = {place.name: kind for place, kind in self._kinds.items()}
        if self._address.travel:
            self._topics[self._address.travel] = JointState
        self._graph.__enter__()
        if self._graph.node.get_parameter("use_sim_time").value:
            self.clock = SimulatedClock(self._graph)
        return self

    def __exit__(self, *raised: object) -> None:
        self._graph.__exit__()

    def _subscribe(self) -> None:
        quality = profile(_DEPTH, reliable=False)
        subscribe = self._graph.node.create_subscription
        for place, kind in self._kinds.items():
            on_message = partial(self._on_message, place)
            self._subscriptions.append(subscribe(kind, place.name, on_message, quality))
        if topic := self._address.travel:
            on_travel = partial(self._on_message, None)
            self._subscriptions.append(subscribe(self._topics[topic], topic, on_travel, quality))

    def _unsubscribe(self) -> None:
        while self._subscriptions:
            self._graph.node.destroy_subscription(self._subscriptions.pop())

    @property
    def finished(self) -> bool:
        """Whether a manager has shut the node down."""
        return self._graph.state == "finalized"

    @property
    def problem(self) -> str:
        """Topics without a publisher or of another type, as a phrase; empty if there are none."""
        if self._graph.node is None or self._graph.problem:
            return "" if self._graph.node is None else self._graph.problem
        if time.monotonic() - self._looked > _PATIENCE:
            self._looked = time.monotonic()
            silences = [self._silence_of(topic, kind) for topic, kind in self._topics.items()]
            self._silence = "; ".join(filter(None, silences))
        return self._silence

    def _silence_of(self, topic: str, kind: Any) -> str:
        """Reason why no messages of a topic arrive; empty if it has a publisher of its type."""
        wanted = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
        published = self._graph.node.get_publishers_info_by_topic(topic)
        types = {publisher.topic_type for publisher in published}
        if not types:
            return f"nobody publishes {topic}"
        return "" if wanted in types else f"{topic} is of {', '.join(types)}, not {wanted}"

    def _on_message(self, place: Placement | None, message: Any) -> None:
        if self._graph.state != "active":
            self.counts["ignored"] += 1
            return
        self.counts["heard"] += 1
        self._waiting.append((place, message, time.monotonic()))
        if len(self._waiting) > _WAITING:
            self._waiting.popleft()
            self.counts["dropped"] += 1

    def _add_travel(self, message: Any, time: float) -> None:
        if not len(message.position) or not abs(message.position[0]) < _FAR:
            raise DeviceError(f"{self._address.travel} stated no travel; send m.")
        self._slide.add(time, float(message.position[0]))

    def poll(self) -> None:
        """Receive the messages that have arrived; `read` converts them later."""
        self._graph.spin()

    def read(self, clock: SessionClock) -> list[Readings]:
        """Readings that have arrived since the last call."""
        self.poll()
        out: list[Readings] = []
        while self._waiting:
            place, message, arrival = self._waiting.popleft()
            try:
                time = self._time(message, arrival, clock)
                if place is None:
                    self._add_travel(message, time)
                else:
                    out.append(self._reading(place, message, time))
            except RobotFileError:
                raise
            except NoTravelError:
                self.counts["no travel"] += 1
            except GlissandoError:
                self.counts["invalid"] += 1
        return out

    def _reading(self, place: Placement, message: Any, time: float) -> Readings:
        kind = place.kind or "pose"
        if kind == "gyro":
            rate = message.angular_velocity
            value = np.array([rate.x, rate.y, rate.z])
            if not np.all(np.abs(value) < _FASTEST):
                raise DeviceError(f"{place.name} turns by {value} rad/s; check its unit.")
        else:
            value = pose_of(message, place.name)
            value = value[:3, 3] if kind == "position" else value
        stream = place.name.strip("/").replace("/", "_")  # a valid file name
        return reading(self._robot, place, kind, stream, time, value, self._slide)

    def _time(self, message: Any, arrival: float, clock: SessionClock) -> float:
        stamp = message.header.stamp
        if self._address.clock == "arrival" or not (stamp.sec or stamp.nanosec):
            return clock.of_monotonic(arrival)
        if isinstance(clock, SimulatedClock):
            return clock.of_nanoseconds(stamp.sec * 1_000_000_000 + stamp.nanosec)
        if self._address.clock == "sender":
            seconds = stamp.sec + 1e-9 * stamp.nanosec
            if not self._clock_begun:
                clock.begin_at(seconds)
                self._clock_begun = True
            return seconds
        ticks = (stamp.nanosec << 32) // 1_000_000_000
        return clock.of_stamp((stamp.sec << 32) + ticks)


def pose_of(message: Any, name: str) -> Array:
    """Pose (4, 4) of a PoseStamped or a TransformStamped, m.

    Args:
        message: The message.
        name: Topic of the message.

    Raises:
        DeviceError: The pose is not a rigid motion within 20 m.
    """
    inner = message.pose if hasattr(message, "pose") else message.transform
    place = inner.position if hasattr(inner, "position") else inner.translation
    turn = inner.orientation if hasattr(inner, "orientation") else inner.rotation
    quaternion = np.array([turn.w, turn.x, turn.y, turn.z])
    position = np.array([place.x, place.y, place.z])
    if not abs(np.linalg.norm(quaternion) - 1.0) < 1e-2 or not np.all(np.abs(position) < _FAR):
        raise DeviceError(f"{name} sent no rigid motion within {_FAR:g} m; check its units.")
    return se3.pose(se3.rotation_from_quaternion(quaternion), position)
