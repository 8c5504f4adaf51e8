"""An OpenIGTLink peer as a tracker, such as PLUS with any tracker that it supports."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.drivers.aurora_reply import Frame, PortReading
from glissando.hardware.drivers.aurora_setup import Tool
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.address import Address, WireFrame
from glissando.hardware.openigtlink.endpoint import EndpointUser
from glissando.hardware.openigtlink.message import Message
from glissando.hardware.openigtlink.sender_clock import SenderClock

SKEW = 1e-2  # tolerance of RRᵀ = 1
_PAUSE = 0.002  # s between polls


def poses_in(message: Message, frame: WireFrame) -> Iterator[tuple[str, str, Array]]:
    """Name, kind of sensor and pose (4, 4) in m of each device in a message.

    A tool of five degrees of freedom is a coil, one of three a position; any other device with an
    orientation is a pose.
    """
    content = message.content
    kinds = {c.TOOL_5D: "coil", c.TOOL_3D: "position"}
    if isinstance(content, c.TrackingData):
        for tool in content.tools:
            yield tool.name, kinds.get(tool.kind, "pose"), frame.pose_in(tool.matrix)
    elif isinstance(content, c.Transform):
        yield message.device, "pose", frame.pose_in(content.matrix)
    elif isinstance(content, c.Position):
        pose = np.eye(4)
        pose[:3, 3] = content.position
        if content.quaternion is not None:
            turn = se3.rotation_from_quaternion(np.roll(content.quaternion, 1))
            pose[:3, :3] = turn * np.sum(np.square(content.quaternion))  # for is_rigid
        kind = "position" if content.quaternion is None else "pose"
        yield message.device, kind, frame.pose_in(pose)


def is_rigid(pose: Array) -> bool:
    """Whether a pose (4, 4) received as float32 is a rigid motion, within `SKEW`."""
    turn = pose[:3, :3]
    proper = np.all(np.isfinite(pose)) and np.linalg.det(turn) > 0.0
    return bool(proper and np.abs(turn @ turn.T - np.eye(3)).max() <= SKEW)


def normalized(pose: Array) -> Array:
    """Pose with its rotation replaced by the nearest orthogonal matrix."""
    left, _, right = np.linalg.svd(pose[:3, :3])
    return se3.pose(left @ right, pose[:3, 3])


class IgtlTracker(EndpointUser):
    """Reads TRANSFORM, POSITION and TDATA of named devices as frames; a context manager.

    Args:
        address: Address as `Endpoint` takes it.
        names: Names of the devices; poses of others are counted and dropped.

    Attributes:
        tools: The devices as tools, with their names as serial numbers.
        counts: Poses dropped ('unplaced', 'invalid', 'repeated'), and events of the connection.

    Raises:
        DeviceError: The address is invalid.
    """

    def __init__(self, address: str, names: Sequence[str]) -> None:
        super().__init__(address)
        self._clock = SenderClock(Address.of_rig(address).clock)
        self.tools = [Tool(k, name, "openigtlink", str(k)) for k, name in enumerate(names)]
        self._handles = {tool.serial: tool.handle for tool in self.tools}
        self._number, self._waiting = 0, deque[tuple[float, Message]]()
        self._last: dict[int, bytes] = {}

    def read(self, timeout: float) -> Frame | None:
        """Wait for a message with new poses, and return them as a frame; None after a timeout.

        Args:
            timeout: Seconds to wait.
        """
        deadline = time.monotonic() + timeout
        while True:
            while self._waiting:
                if (frame := self._frame_of(*self._waiting.popleft())) is not None:
                    return frame
            if time.monotonic() > deadline:  # even if the peer keeps sending other messages
                return None
            self._waiting += self._endpoint.receive()
            if not self._waiting:
                time.sleep(_PAUSE)

    def _frame_of(self, arrival: float, message: Message) -> Frame | None:
        measured = self._clock.monotonic(message.stamp, arrival)
        ports = []
        for name, _, pose in poses_in(message, self._frame):
            handle = self._handles.get(name)
            if handle is None:
                self._own_counts["unplaced"] += 1
            elif not is_rigid(pose):
                self._own_counts["invalid"] += 1
            elif self._last.get(handle) == pose.tobytes():
                self._own_counts["repeated"] += 1
            else:
                self._last[handle] = pose.tobytes()
                pose = normalized(pose)
                ports.append(PortReading(handle, "valid", self._number, 0, pose, 0.0))
        if not ports:
            return None
        self._number += 1
        std = self._clock.std_time()
        return Frame(self._number, measured, std, arrival, tuple(ports))
