"""Topics as the devices of a rig."""

import threading
import time

import numpy as np
import pytest

from glissando.hardware.capture import Coil, Rig, capture
from glissando.io.session_log import read_session
from glissando.model.slide_path import SlideLimits, SlidePath
from ros_peers import Peer

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rclpy's own imports


def test_a_rig_records_a_tracker_that_is_topics(domain, tmp_path):
    rig = Rig("bench", "sliding700", domain, (Coil("tip", 0.7, slides=False, serial="/tip/pose"),))
    seen, over = np.eye(4), threading.Event()
    seen[:3, 3] = 0.1, 0.2, 0.3
    with Peer(domain, ["/tip/pose"]) as peer:

        def track():
            while not over.wait(0.02):
                far = peer.pose(time.time(), np.eye(4))
                far.pose.position.x = 700.0
                peer.send([("/tip/pose", peer.pose(time.time(), seen)), ("/tip/pose", far)])

        thread = threading.Thread(target=track)
        thread.start()
        try:
            path = SlidePath.hold(0.0, 1.5, SlideLimits(1.0, 1.0, 1.0))
            progress = capture(rig, path, tmp_path / "session")
        finally:
            over.set()
            thread.join()
    assert int(progress.problems["tracker invalid"]) > 0
    topic = read_session(tmp_path / "session" / "session.mcap").topics["/tracker/tip"]
    delay = 1e-9 * np.array(topic.time_ns) - topic.column("time")
    assert np.all((delay > -1e-3) & (delay < 0.5))
    np.testing.assert_allclose(topic.column("position"), np.tile(seen[:3, 3], (delay.size, 1)))
