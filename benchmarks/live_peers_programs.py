"""Trackers and viewers that `live_peers.py` kills: each is a process that is started again."""

from __future__ import annotations

import contextlib
import socket
import time
from dataclasses import dataclass

import numpy as np

from glissando.geometry import se3
from glissando.hardware.openigtlink import Message, encode, stamp_of
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.ros2.graph import Graph, Ros2Address, profile
from glissando.io.robot_file import load_robot

ROBOT = "tdcr466"
LENGTH = load_robot(ROBOT).length
LIVES = 0.6  # s that a peer lives at most before it is killed
_PERIOD = 1.0 / 40.0  # s between a tracker's frames


def _pose(place: float) -> np.ndarray:
    bent = np.array([0.0, 0.0, place, 0.0, 0.3 * np.sin(time.time()) * place, 0.0])
    return se3.exp(bent)


def _frame() -> bytes:
    """Base and tip of a swaying robot as one TDATA message, mm."""
    tools = []
    for name, place in (("base", 0.0), ("tip", LENGTH)):
        pose = _pose(place)
        pose[:3, 3] *= 1e3
        tools.append(c.Tool(name, c.TOOL_6D, pose))
    return encode(Message(c.TrackingData(tuple(tools)), "tracker", stamp_of(time.time())))


def _serve(port: int, speak) -> None:
    """Speak with one client after another."""
    with socket.create_server(("127.0.0.1", port)) as server:
        while True:
            with contextlib.suppress(OSError), server.accept()[0] as link:
                speak(link)


def _call(port: int, speak) -> None:
    """Speak with the server, and call again when it is gone."""
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port)) as link:
            speak(link)
        time.sleep(0.02)


def _send(link: socket.socket) -> None:
    while True:
        link.sendall(_frame())
        time.sleep(_PERIOD)


def _read(link: socket.socket) -> None:
    while link.recv(1 << 16):
        pass


def tracker_server(port: int) -> None:
    """A tracker that is called."""
    _serve(port, _send)


def tracker_client(port: int) -> None:
    """A tracker that calls."""
    _call(port, _send)


def viewer_client(port: int) -> None:
    """A viewer that calls."""
    _call(port, _read)


def viewer_server(port: int) -> None:
    """A viewer that is called."""
    _serve(port, _read)


def ros_publisher(domain: int) -> None:
    """A tracker in a ROS 2 graph."""
    with Graph(Ros2Address(domain=domain), "tracker") as graph:
        from geometry_msgs.msg import PoseStamped

        places = {"/base": 0.0, "/tip": LENGTH}
        topics = {
            n: graph.node.create_publisher(PoseStamped, n, profile(5, reliable=True))
            for n in places
        }
        while True:
            for name, place in places.items():
                message, pose = PoseStamped(), _pose(place)
                now, at, turn = time.time(), message.pose.position, message.pose.orientation
                message.header.stamp.sec, message.header.stamp.nanosec = (
                    int(now),
                    int(now % 1 * 1e9),
                )
                at.x, at.y, at.z = pose[:3, 3].tolist()
                turn.w, turn.x, turn.y, turn.z = se3.quaternion(pose[:3, :3]).tolist()
                topics[name].publish(message)
            time.sleep(_PERIOD)


def ros_subscriber(domain: int) -> None:
    """A viewer in a ROS 2 graph."""
    with Graph(Ros2Address(domain=domain), "viewer") as graph:
        from geometry_msgs.msg import PoseArray

        quality = profile(5, reliable=True)
        graph.node.create_subscription(PoseArray, "/glissando/frames", lambda m: None, quality)
        while True:
            graph.spin()
            time.sleep(0.005)


@dataclass
class Peer:
    """A process that is killed and started again.

    Attributes:
        name: What it is called in the table.
        program: What it runs.
        argument: A port or a domain.
        used: Whether the session has it now, by counting what it did.
    """

    name: str
    program: object
    argument: int
    used: object
    kills: int = 0
    returned: int = 0
    awaited: bool = True
    until: float = 0.0
    process: object = None

    def start(self, context, rng) -> None:
        """Start it, for a time that is drawn."""
        self.process = context.Process(target=self.program, args=(self.argument,), daemon=True)
        self.process.start()
        self.awaited, self.until = True, time.monotonic() + rng.uniform(0.0, LIVES)

    def look(self) -> None:
        """Count that it is in use again."""
        if self.awaited and self.used():
            self.awaited, self.returned = False, self.returned + 1
