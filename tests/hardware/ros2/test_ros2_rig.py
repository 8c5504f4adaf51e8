"""Topics as the devices of a rig, and the command that a launch file starts."""

import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from glissando.cli.main import main
from glissando.hardware.capture import Coil, Rig, capture
from glissando.io.session_log import read_session
from glissando.model.slide_path import SlideLimits, SlidePath
from ros_peers import Peer

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rclpy's own imports


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_launch_example_starts_a_command_that_joins_the_graph(domain, capsys):
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "ros2.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```\n(from launch import.*?)```", page, re.S)
    compile(code, "launch", "exec")
    (live,) = re.findall(r'live = "glissando (.*?)"', code)
    words = live.replace("my_robot.toml", "tdcr466").replace("ros2", domain).split()
    assert main([*words, "--patience", "1.5"]) == 2
    assert "nobody publishes /aurora/tip" in capsys.readouterr().err
