"""Losses of a live estimate whose peers are killed repeatedly.

    python benchmarks/live_peers.py [--kills 50] [--seed 0] [--json FILE] [--page]

One session estimates from an OpenIGTLink server, an OpenIGTLink client and a ROS 2 publisher, and
sends to an OpenIGTLink client, an OpenIGTLink server and a ROS 2 subscriber; each is a process that
is killed (kill -9) at a random time after its start and restarted. Another session estimates from a
rig whose tracker is killed and restarted, and others from rigs whose stage is killed. Each row has
the number of kills and of reconnections, the end of the session, and the numbers of readings used
and in the journal. Without rclpy the rows of ROS 2 are omitted.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import random
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from faults_bench import Device, free_port
from glissando.errors import DeviceError
from glissando.hardware.capture import Coil, Rig
from glissando.hardware.drivers import GcodeStage
from glissando.hardware.live import IgtlSink, IgtlSource, LiveSession, Placement
from glissando.hardware.live.rig_source import RigSource
from glissando.hardware.ros2.ros2_sink import Ros2Sink
from glissando.hardware.ros2.ros2_source import Ros2Source
from glissando.hardware.simulated_devices.scene import Scene, SceneCoil
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file
from glissando.model.slide_path import SlideLimits, SlidePath
from glissando.simulation import load_bench
from live_peers_programs import (
    LIVES,
    ROBOT,
    Peer,
    ros_publisher,
    ros_subscriber,
    tracker_client,
    tracker_server,
    viewer_client,
    viewer_server,
)
from plan_page import table, write

PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "live.md"
RATE = 10.0
_BACK = 30.0  # s: time limit for all peers to reconnect at the end


def with_peers(options, folder: Path) -> list[dict]:
    """Run a session whose peers are killed and restarted; returns a row per peer."""
    robot, rng = load_robot(ROBOT), random.Random(options.seed)
    places = [Placement("base", 0.0), Placement("tip", robot.length)]
    topics = [Placement("/base", 0.0), Placement("/tip", robot.length)]
    ports, graph = [free_port(), free_port()], f"ros2?domain={options.domain}"
    sources = [
        IgtlSource(f"igtl://127.0.0.1:{ports[0]}?clock=shared", robot, places),
        IgtlSource("igtl-server://127.0.0.1:0?clock=shared", robot, places),
    ]
    sinks = [IgtlSink("igtl-server://127.0.0.1:0"), IgtlSink(f"igtl://127.0.0.1:{ports[1]}")]
    if options.ros:
        sources.append(Ros2Source(graph, robot, topics))
        sinks.append(Ros2Sink(graph))
    session = LiveSession(robot, sources, sinks, rate=RATE, journal=folder / "log", patience=120.0)
    used, updates = Counter(), 0
    with ExitStack() as stack:
        stack.enter_context(session)
        peers = _peers(sources, sinks, ports, options)
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["__main__"])
        for peer in peers:
            peer.start(context, rng)
            stack.callback(lambda p=peer: p.process.kill())
        end = None
        for update in session:
            updates += 1
            for readings in update.readings:
                used[readings.name] += len(readings)
            for peer in peers:
                peer.look()
                if peer.kills < options.kills and time.monotonic() > peer.until:
                    peer.process.kill()
                    peer.process.join()
                    peer.kills += 1
                    _gone(peer)
                    peer.start(context, rng)
            if all(peer.kills == options.kills for peer in peers):
                end = end or time.monotonic() + _BACK
                if not any(p.awaited for p in peers) or time.monotonic() > end:
                    break
    log = load_recording(folder / "log").streams
    held = {name: stream.rows.time.size for name, stream in log.items()}
    ended = f"went on for {updates} updates"
    ended += "".join(f"; {p.name} did not come back" for p in peers if p.awaited)
    common = {"ended": ended, "used": sum(used.values()), "journal": sum(held.values())}
    return [{"peer": p.name, "kills": p.kills, "again": p.returned, **common} for p in peers]


def _peers(sources, sinks, ports, options) -> list[Peer]:
    """Peers of a session, at the addresses of its sources and sinks."""
    heard = [_Growing(lambda s=s: s.counts["heard"]) for s in sources]
    seen = [_Growing(lambda s=s: s.counts["connected"]) for s in sinks[:2]]
    out = [
        Peer("OpenIGTLink server that sends", tracker_server, ports[0], heard[0]),
        Peer("OpenIGTLink client that sends", tracker_client, sources[1].port, heard[1]),
        Peer("OpenIGTLink client that reads", viewer_client, sinks[0].port, seen[0]),
        Peer("OpenIGTLink server that reads", viewer_server, ports[1], seen[1]),
    ]
    if options.ros:
        frames = sinks[2]._publishers["/glissando/frames"]
        out += [
            Peer("ROS 2 node that publishes", ros_publisher, options.domain, heard[2]),
            Peer(
                "ROS 2 node that subscribes", ros_subscriber, options.domain,
                lambda: bool(frames.get_subscription_count()),
            ),
        ]  # fmt: skip
    return out


@dataclass
class _Growing:
    """Callable that tells whether a count has increased since the peer was killed."""

    count: object
    before: int = 0

    def __call__(self) -> bool:
        return self.count() > self.before


def _gone(peer: Peer) -> None:
    if isinstance(peer.used, _Growing):
        peer.used.before = peer.used.count()


class RigBench:
    """Simulated rig whose tracker and stage can be killed."""

    def __init__(self, folder: Path) -> None:
        bench = load_bench(robot_file("sliding700"))
        motion = bench.move(bench.shape("C"), bench.flaws, 0)
        self.tip = bench.rod.length + bench.coil_offset
        self.scene, self.port, self.tracker_frame = folder / "scene.npz", free_port(), bench.tracker
        coil = SceneCoil(self.tip, -1.0, np.eye(4), port=0)
        still = motion.time[:1]
        Scene.of(motion, still, [coil], T_wt=bench.tracker, flaws=bench.flaws).save(self.scene)

    def tracker(self) -> Device:
        """Start a tracker; every tracker has the same address."""
        options = ["--scene", str(self.scene), "--tcp", str(self.port)]
        return Device("-m", "glissando.hardware.simulated_devices.aurora", *options)

    def session(self, stage: Device, journal: Path) -> LiveSession:
        """Session with the rig while its slide oscillates."""
        settings = GcodeStage(stroke=(0.0, 0.06))
        rig = Rig(
            "bench", "sliding700", f"tcp://127.0.0.1:{self.port}", (Coil("coil", self.tip),),
            stage.address, settings, 0.0, frame=self.tracker_frame,
        )  # fmt: skip
        path = SlidePath.oscillate(400, 0.02, SlideLimits(0.06, 0.024, 0.1))
        robot = load_robot("sliding700")
        source = RigSource(rig, robot, path)
        return LiveSession(robot, [source], journal=journal, rate=10.0, patience=60.0)


def _stage() -> Device:
    return Device("-m", "glissando.hardware.simulated_devices.grbl")


def with_tracker_killed(options, folder: Path) -> dict:
    """Run a session whose tracker is killed and restarted within the session's patience."""
    bench, rng = RigBench(folder), random.Random(options.seed + 1)
    row, used, ended = {"peer": "tracker of a rig", "kills": 0, "again": 0}, 0, "went on"
    with ExitStack() as stack:
        tracker, stage = bench.tracker(), _stage()
        stack.callback(stage.kill)
        stack.callback(lambda: tracker.kill())
        try:
            with bench.session(stage, folder / "log") as session:
                heard, until = False, 0.0
                for update in session:
                    fresh = sum(map(len, update.readings))
                    used += fresh
                    if fresh and not heard:
                        heard, row["again"] = True, row["again"] + 1
                        until = time.monotonic() + rng.uniform(0.0, LIVES)
                        if row["kills"] == options.kills:
                            break
                    if heard and time.monotonic() > until:
                        tracker.kill()
                        row["kills"], heard = row["kills"] + 1, False
                        tracker = bench.tracker()
        except DeviceError as problem:
            ended = str(problem)
    return {**row, "ended": ended, "used": used, "journal": _held(folder / "log")}


def with_stage_killed(options, folder: Path) -> dict:
    """Run sessions whose stage is killed at a random time."""
    bench, rng = RigBench(folder), random.Random(options.seed + 2)
    ends, used, held, last = Counter(), 0, 0, ""
    with contextlib.closing(_Killed(bench.tracker())):
        for k in range(options.rig_kills):
            stage, log = _stage(), folder / f"log{k}"
            moment = None
            try:
                with bench.session(stage, log) as session:
                    for update in session:
                        used += sum(map(len, update.readings))
                        moment = moment or time.monotonic() + rng.uniform(0.0, 1.0)
                        if time.monotonic() > moment:
                            stage.kill()
            except DeviceError as problem:
                ends["one sentence" if str(problem).count("\n") == 0 else "more"] += 1
                last = str(problem)
            stage.kill()
            held += _held(log)
    ended = ", ".join(f"{n} × {text}" for text, n in ends.items()) + f": {last}"
    return {
        "peer": "stage of a rig", "kills": options.rig_kills, "again": 0, "ended": ended,
        "used": used, "journal": held,
    }  # fmt: skip


@dataclass
class _Killed:
    device: Device

    def close(self) -> None:
        """Kill the device."""
        self.device.kill()


def _held(journal: Path) -> int:
    return sum(s.rows.time.size for s in load_recording(journal).streams.values())


def main() -> None:
    """Run all sessions and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--kills", type=int, default=50, help="of each peer that comes back")
    add("--rig-kills", type=int, help="of the stage, each a session (default: as many)")
    add("--seed", type=int, default=0)
    add("--domain", type=int, default=78, help="of ROS 2")
    add("--json", type=Path)
    add("--page", action="store_true", help="write the table into docs/how-to/live.md")
    options = parser.parse_args()
    options.rig_kills = options.kills if options.rig_kills is None else options.rig_kills
    try:
        import rclpy  # noqa: F401

        options.ros = True
    except ImportError:
        options.ros = False
    rows = []
    for trial in (with_peers, with_tracker_killed, with_stage_killed):
        with tempfile.TemporaryDirectory() as folder:
            found = trial(options, Path(folder))
        rows += found if isinstance(found, list) else [found]
        print(json.dumps(found, indent=1), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    if options.page:
        page(rows, options.seed)


def page(rows: list[dict], seed: int) -> None:
    """Write the table into the how-to."""
    heads = ["peer", "kills", "in use again", "the session", "readings used", "in the journal"]
    made = f"`benchmarks/live_peers.py --seed {seed}`, {time.strftime('%Y-%m-%d')}:"
    write("peers", [made, "", *table(heads, [list(row.values()) for row in rows])], PAGE)


if __name__ == "__main__":
    main()
