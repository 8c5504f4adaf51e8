"""Growth of memory, files and threads of a live estimate in a ROS 2 graph over a long run.

    python benchmarks/ros_growth.py MINUTES [--rate 30] [--readings 40] [--domain 77] [--json FILE]

`glissando live` reads two topics of a publisher, and publishes to a subscriber that leaves and
rejoins every ten seconds. Every minute a row has the resident memory of the command, its open files
and threads, and the number of messages received. At the end, the growth per hour is computed
between the first and the last third of the time after a warm-up of a fifth.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from glissando.geometry import se3
from glissando.hardware.ros2.graph import Graph, Ros2Address, profile
from glissando.io.robot_file import load_robot

ROBOT = "tdcr466"
JOINED = 10.0  # s: time for which a subscriber stays
_LOOK = 10.0  # s: sampling interval


def publish(domain: int, rate: float) -> None:
    """Publish a swaying robot's base and tip until killed."""
    length = load_robot(ROBOT).length
    with Graph(Ros2Address(domain=domain), "swaying") as graph:
        from geometry_msgs.msg import PoseStamped

        places = {"/base/pose": 0.0, "/tip/pose": length}
        quality = profile(10, reliable=True)
        topics = {n: graph.node.create_publisher(PoseStamped, n, quality) for n in places}
        while True:
            now = time.time()
            for name, place in places.items():
                bent = np.array([0.0, 0.0, place, 0.0, 0.3 * np.sin(now) * place, 0.0])
                topics[name].publish(stamped(PoseStamped(), now, se3.exp(bent)))
            graph.spin()
            time.sleep(1.0 / rate)


def stamped(message, seconds: float, pose):
    """Fill a PoseStamped with a time and a pose."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(1e9 * seconds), 10**9)
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z = pose[:3, 3].tolist()
    turn.w, turn.x, turn.y, turn.z = se3.quaternion(pose[:3, :3]).tolist()
    return message


def listen(domain: int, rate: float) -> None:
    """Subscribe to all published topics, leave and rejoin; print the number of messages."""
    count = 0

    def take(_message) -> None:
        nonlocal count
        count += 1

    while True:
        with Graph(Ros2Address(domain=domain), "listener") as graph:
            from diagnostic_msgs.msg import DiagnosticArray
            from geometry_msgs.msg import PoseArray
            from visualization_msgs.msg import MarkerArray

            kinds = {
                "/glissando/frames": PoseArray,
                "/glissando/markers": MarkerArray,
                "/diagnostics": DiagnosticArray,
            }
            for topic, kind in kinds.items():
                graph.node.create_subscription(kind, topic, take, profile(5, reliable=True))
            end = time.monotonic() + JOINED
            while time.monotonic() < end:
                graph.spin()
                time.sleep(0.01)
        print(count, flush=True)


PEERS = {"publish": publish, "listen": listen}


def state_of(pid: int) -> dict[str, float]:
    """Resident memory in MB, open files and threads of a process."""
    status = dict(
        line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines()
    )
    return {
        "rss_mb": int(status["VmRSS"].split()[0]) / 1024.0,
        "files": len(os.listdir(f"/proc/{pid}/fd")),
        "threads": int(status["Threads"]),
    }


def measure(options, folder: Path) -> list[dict[str, float]]:
    """Resources of the command, sampled every ten seconds until its end."""
    with ExitStack() as stack:
        got = stack.enter_context((folder / "got").open("w+"))
        for peer, out in (("publish", None), ("listen", got)):
            command = [sys.executable, __file__, "--peer", peer, str(options.domain)]
            process = subprocess.Popen([*command, str(options.readings)], stdout=out)
            stack.callback(process.kill)
        live = subprocess.Popen(command_of(options, folder))
        stack.callback(live.kill)
        began, rows = time.monotonic(), []
        while (into := time.monotonic() - began) < 60.0 * options.minutes:
            time.sleep(min(_LOOK, 60.0 * options.minutes - into))
            if live.poll() is not None:
                raise SystemExit(f"glissando live ended after {into:.0f} s.")
            last = (folder / "got").read_text().split()
            rows.append({"s": time.monotonic() - began, **state_of(live.pid)})
            rows[-1]["messages"] = int(last[-1]) if last else 0
            if len(rows) % 6 == 0:
                print(", ".join(f"{k} {v:.6g}" for k, v in rows[-1].items()), flush=True)
        live.send_signal(signal.SIGTERM)  # a background job of a shell ignores SIGINT
        if live.wait(60.0) not in (0, 128 + signal.SIGTERM, -signal.SIGTERM):
            raise SystemExit(f"glissando live ended with status {live.returncode}.")
    return rows


def command_of(options, folder: Path) -> list[str]:
    """Command that is measured."""
    graph = f"ros2?domain={options.domain}"
    return [
        sys.executable, "-m", "glissando", "live", "--robot", ROBOT, "--source", graph,
        "--at", "/base/pose=0", "--at", f"/tip/pose={load_robot(ROBOT).length}",
        "--sink", graph, "--rate", str(options.rate), "--journal", str(folder / "log"),
    ]  # fmt: skip


def growth(rows: list[dict[str, float]]) -> float:
    """Growth of resident memory, MB/h, between first and last third after a warm-up of a fifth."""
    warm = [row for row in rows if row["s"] > 0.2 * rows[-1]["s"]]
    third = max(len(warm) // 3, 1)
    early, late = warm[:third], warm[-third:]
    mean = [
        np.mean([row[key] for row in some]) for key in ("rss_mb", "s") for some in (early, late)
    ]
    return float(3600.0 * (mean[1] - mean[0]) / max(mean[3] - mean[2], 1e-9))


def main() -> None:
    """Measure, or run as a peer of the measured command."""
    if sys.argv[1:2] == ["--peer"]:
        PEERS[sys.argv[2]](int(sys.argv[3]), float(sys.argv[4]))
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("minutes", type=float)
    parser.add_argument("--rate", type=float, default=30.0, help="updates a second")
    parser.add_argument("--readings", type=float, default=40.0, help="a second, of each topic")
    parser.add_argument("--domain", type=int, default=77)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(options, Path(folder))
    first, last = rows[min(len(rows) - 1, 6)], rows[-1]
    print(
        f"After {first['s']:.0f} s {first['rss_mb']:.1f} MB, {first['files']} files, "
        f"{first['threads']} threads; after {last['s']:.0f} s {last['rss_mb']:.1f} MB, "
        f"{last['files']} files, {last['threads']} threads; {growth(rows):+.2f} MB an hour after "
        f"the warm-up; the subscriber got {last['messages']} messages."
    )
    if options.json:
        options.json.write_text(json.dumps(rows) + "\n")


if __name__ == "__main__":
    main()
