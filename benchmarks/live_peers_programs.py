"""Trackers and viewers that `live_peers.py` kills and restarts, each as a process."""

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
LIVES = 0.6  # s: longest lifetime of a peer
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
    """Run `speak` with one client after another."""
    with socket.create_server(("127.0.0.1", port)) as server:
        while True:
            with contextlib.suppress(OSError), server.accept()[0] as link:
                speak(link)


def _call(port: int, speak) -> None:
    """Run `speak` with the server, and reconnect when it closes."""
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
    """Run a tracker as a server."""
    _serve(port, _send)


def tracker_client(port: int) -> None:
    """Run a tracker as a client."""
    _call(port, _send)


def viewer_client(port: int) -> None:
    """Run a viewer as a client."""
    _call(port, _read)


def viewer_server(port: int) -> None:
    """Run a viewer as a server."""
    _serve(port, _read)


def ros_publisher(domain: int) -> None:
    """Run a tracker in a ROS 2 graph."""
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
    """Run a viewer in a ROS 2 graph."""
    with Graph(Ros2Address(domain=domain), "viewer") as graph:
        from geometry_msgs.msg import PoseArray

        quality = profile(5, reliable=True)
        graph.node.create_subscription(PoseArray, "/glissando/frames", lambda m: None, quality)
        while True:
            graph.spin()
            time.sleep(0.005)


@dataclass
class Peer:
    """A process that is killed and restarted.

    Attributes:
        name: Name in the table.
        program: Function that the process runs.
        argument: Port or ROS 2 domain, passed to `program`.
        used: Function that returns whether the session has used the peer since its last start.
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
        """Start the process, with a random lifetime."""
        self.process = context.Process(target=self.program, args=(self.argument,), daemon=True)
        self.process.start()
        self.awaited, self.until = True, time.monotonic() + rng.uniform(0.0, LIVES)

    def look(self) -> None:
        """Count a reconnection if the session uses the peer again."""
        if self.awaited and self.used():
            self.awaited, self.returned = False, self.returned + 1
