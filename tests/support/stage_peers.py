"""Programs that drive a simulated carriage, as peers of OpenIGTLink and nodes of ROS 2."""

import threading
import time
from contextlib import contextmanager

import numpy as np

from glissando.hardware.openigtlink import Endpoint, Message, encode, stamp_of
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.ros2.graph import Graph, Ros2Address, profile
from glissando.hardware.ros2.ros2_stage import COMMAND, MEASURED

_PERIOD = 0.01  # s between positions


class Carriage:
    """A carriage that goes to its goal at a bounded speed, in its own positions.

    Attributes:
        place: Where it is, m.
        goals: What it was asked for, m.
        says: What it states of a place, m; None while it says nothing.
        deaf: How long its driver states places, s, before it subscribes to goals (ROS 2).
    """

    def __init__(self, place=0.1, speed=0.15, deaf=0.0):
        self.place, self.speed, self.goals, self.deaf = place, speed, [], deaf
        self.says = lambda place: place
        self._now = time.monotonic()

    def advance(self):
        now = time.monotonic()
        most, self._now = self.speed * (now - self._now), now
        if self.goals:
            self.place += float(np.clip(self.goals[-1] - self.place, -most, most))
        return self.says(self.place)


class _IgtlDriver:
    def __init__(self, peer, carriage):
        self.peer, self.carriage = peer, carriage

    def step(self):
        for _, message in self.peer.receive():
            assert message.device == "StageTarget"
            self.carriage.goals.append(1e-3 * message.content.matrix[2, 3])
        place = self.carriage.advance()
        if place is not None and self.peer.peers:
            pose = np.eye(4)
            pose[2, 3] = 1e3 * place
            now = stamp_of(time.time())
            self.peer.send([encode(Message(c.Transform(pose), "Stage", now))])


class _RosDriver:
    def __init__(self, graph, carriage):
        from sensor_msgs.msg import JointState

        self.graph, self.carriage, self.kind = graph, carriage, JointState
        self.reliable = profile(10, reliable=True)
        self.says = graph.node.create_publisher(JointState, MEASURED, self.reliable)
        self.goals, self.begun = None, None

    def heard(self, message):
        self.carriage.goals.append(message.position[0])

    def step(self):
        self.graph.spin()
        place = self.carriage.advance()
        if place is not None:
            state = self.kind(name=["other", "slide"], position=[7.0, place])
            nanoseconds = time.time_ns()
            state.header.stamp.sec, state.header.stamp.nanosec = divmod(nanoseconds, 10**9)
            self.says.publish(state)
        if self.begun is None and self.says.get_subscription_count():
            self.begun = time.monotonic()
        if self.goals is None and self.begun and time.monotonic() > self.begun + self.carriage.deaf:
            self.goals = self.graph.node.create_subscription(
                self.kind, COMMAND, self.heard, self.reliable
            )


@contextmanager
def driving(wire, carriage):
    """A program that drives a carriage, and its address; `wire` is igtl, or a ROS 2 address."""
    over = threading.Event()

    def drive(driver):
        while not over.wait(_PERIOD):
            driver.step()

    is_ros = wire.startswith("ros2")
    host = Graph(Ros2Address.parse(wire), "driver") if is_ros else Endpoint("igtl-server://:0")
    with host as peer:
        address = wire if is_ros else f"igtl://127.0.0.1:{peer.address.port}?clock=shared"
        driver = (_RosDriver if is_ros else _IgtlDriver)(peer, carriage)
        thread = threading.Thread(target=drive, args=(driver,))
        thread.start()
        try:
            yield address
        finally:
            over.set()
            thread.join()
