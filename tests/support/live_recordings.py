"""A small recording of a moving robot, and its readings as OpenIGTLink messages."""

import tomllib
from pathlib import Path

import numpy as np

from glissando.errors import RobotFileError
from glissando.geometry import se3
from glissando.hardware.live import IgtlSource, LiveSession
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.live.igtl_sink import readings_message
from glissando.hardware.openigtlink import Endpoint, Message, encode, stamp_of
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.address import WireFrame
from glissando.io.csv_stream import Rows, Stream
from glissando.io.recording import Recording
from glissando.io.robot_file import load_robot, parse_robot
from glissando.model.table import Table
from waiting import until

ROBOT = load_robot("tdcr466")
SPAN = (3.0, 4.5)
MECHANICAL = """
name = "rod"
length = 0.466
rest_strain = [0, 0, 1, 0, 0, 0]
[grid]
arclength_nodes = 6
time_rate = 10.0
[base]
var_pose = [1e-10, 1e-10]
[mechanics]
tubes = [{ outer = 1.2e-3 }]
young = 60e9
poisson = 0.33
[prior]
kind = "mechanical"
time_scale = 1.0
psd_load = [1e-6, 1e-10]
psd_strain_error = [1e-10, 1e-6]
var_tip = [0.04, 1e-6]
points = [0.3]
var_points = [[0.04, 1e-6]]
[sensors.pose]
std = [1e-4, 1e-4]
[sensors.position]
std = [1e-4, 1e-4, 1e-4]
"""
ROD = parse_robot(Table(tomllib.loads(MECHANICAL), "rod.toml", RobotFileError))


def swaying(seed: int = 0, rate: float = 41.3) -> Recording:
    """Base and tip of the robot, swaying by some centimetres, with noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(SPAN[0], SPAN[1] + 1e-9, 1.0 / rate)
    streams = {}
    for name, place in (("base", 0.0), ("tip", ROBOT.length)):
        sway = 0.05 * np.sin(3.0 * (time - SPAN[0])) * place / ROBOT.length
        pose = np.tile(np.eye(4), (time.size, 1, 1))
        pose[:, 2, 3] = place
        twist = np.zeros((time.size, 6))
        twist[:, 0], twist[:, 4] = sway, 1.5 * sway / ROBOT.length
        noise = 1e-4 * rng.normal(size=(time.size, 6))
        values = pose @ se3.exp(twist + noise)
        quaternion = se3.quaternion(values[:, :3, :3])
        values[:, :3, :3] = se3.rotation_from_quaternion(quaternion)
        rows = Rows("pose", time, np.full(time.size, place), values, {})
        streams[name] = Stream(name, rows, keep_repeats=True)
    return Recording("swaying", Path(), streams, ROBOT, SPAN)


def pose_messages(recording: Recording) -> list[tuple[float, bytes]]:
    """Every moment of a recording as one TDATA message in mm, with its time."""
    streams, frame = list(recording.streams.values()), WireFrame()
    out = []
    for k, time in enumerate(streams[0].rows.time):
        tools = tuple(c.Tool(s.name, c.TOOL_6D, frame.poses_out(s.rows.values[k])) for s in streams)
        out.append((time, encode(Message(c.TrackingData(tools), "tracker", stamp_of(time)))))
    return out


class Lockstep(SessionClock):
    """A clock that waits for what a peer has sent and not for time.

    `sleep_until(t)` has the sender send everything up to t, and the source hear it.
    """

    def __init__(self, sender, messages, source) -> None:
        super().__init__()
        self.sender, self.source = sender, source
        self.messages, self._now, self._sent = messages, -np.inf, 0

    def begin_at(self, first: float) -> None:
        super().begin_at(first)
        self._now = first

    def now(self) -> float:
        return self._now

    def sleep_until(self, session: float) -> None:
        some = [wire for time, wire in self.messages[self._sent :] if time <= session]
        self._sent += len(some)
        if some:
            until(lambda: self.sender.receive() or self.sender.peers)
            before = self.source.counts["heard"]
            until(lambda: self.sender.send(some))
            until(lambda: self.source.poll() or self.source.counts["heard"] - before >= len(some))
        self._now = session


def reading_messages(readings) -> list[tuple[float, bytes]]:
    """Each reading as an NDARRAY message, exactly, with its time."""
    return sorted(
        (float(r.time[k]), encode(readings_message(r.select(slice(k, k + 1)), stamp_of(r.time[k]))))
        for r in readings
        for k in range(len(r))
    )


def through_wire(messages, folder, placements=(), updates=30):
    """Newest states of a session whose readings a peer sends, and their times."""
    with Endpoint("igtl-server://:0") as peer:
        address = f"igtl://127.0.0.1:{peer.address.port}?clock=sender"
        source = IgtlSource(address, ROBOT, placements)
        clock = Lockstep(peer, messages, source)
        session = LiveSession(ROBOT, [source], journal=folder, clock=clock, patience=1e9)
        with session:
            clock.sleep_until(SPAN[0])
            done = []
            for update in session:
                done.append(update)
                if len(done) == updates:
                    break
    assert session.skipped == 0
    return done
