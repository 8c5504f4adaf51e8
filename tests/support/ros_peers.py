"""Peers in a ROS 2 graph of this machine: a tracker's driver, and a lifecycle manager."""

import time

from glissando.geometry import se3
from glissando.hardware.live import Placement
from glissando.hardware.ros2.graph import Graph, Ros2Address, profile
from live_recordings import ROBOT
from waiting import until

PLACES = (Placement("/base/pose", 0.0), Placement("/tip/pose", ROBOT.length))


class Peer(Graph):
    """A node that publishes poses, as a tracker's driver does."""

    def __init__(self, domain, names):
        super().__init__(Ros2Address.parse(domain), "peer")
        self.names = names

    def __enter__(self):
        super().__enter__()
        from geometry_msgs.msg import PoseStamped

        self.kind = PoseStamped
        quality = profile(500, reliable=True)
        self.publishers = {
            n: self.node.create_publisher(PoseStamped, n, quality) for n in self.names
        }
        return self

    def send(self, messages):
        for name, message in messages:
            self.publishers[name].publish(message)
        return True

    receive = peers = None

    def pose(self, seconds, pose):
        message = self.kind()
        nanoseconds = round(1e9 * seconds)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 10**9)
        place, turn = message.pose.position, message.pose.orientation
        place.x, place.y, place.z = pose[:3, 3].tolist()
        turn.w, turn.x, turn.y, turn.z = se3.quaternion(pose[:3, :3]).tolist()
        return message


def meet(peer, source):
    """Wait until a peer's messages reach a source."""
    until(lambda: all(p.get_subscription_count() for p in peer.publishers.values()))
    until(lambda: not source.problem)


class Manager(Graph):
    """A node that calls services of another, as a lifecycle manager does."""

    def call(self, kind, service, nodes, over=lambda: False, **request):
        """The answer of a service, or None if what was asked is over.

        An answer is lost when the service has not met its new client yet, so it is asked again.
        """
        client = self.node.create_client(kind, service)
        until(lambda: [node.poll() for node in nodes] and client.service_is_ready())
        for _ in range(10):
            answer, patience = client.call_async(kind.Request(**request)), time.monotonic() + 3.0
            while not (answer.done() or over() or time.monotonic() > patience):
                for node in nodes:
                    node.poll()
                self.spin()
                time.sleep(0.002)
            if answer.done() or over():
                break
        self.node.destroy_client(client)
        return answer.result() if answer.done() else None

    def change(self, who, number, nodes):
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        graph = nodes[who == "sink"]._graph
        before, service = graph.state, f"/glissando_{who}/change_state"
        changed = lambda: graph.state != before  # noqa: E731
        self.call(ChangeState, service, nodes, changed, transition=Transition(id=number))
        assert changed()
