"""Latency of live updates to OpenIGTLink viewers, and the effect of slow or hostile peers.

    python benchmarks/live.py RECORDING... [--rate 60] [--points 30] [--seconds 8]

Each recording is replayed in real time: updates of all kinds (frames, tip, line, 95 % tube,
ellipsoids) go to three viewers on loopback, each a process. Latency is the time from the end of
`advance` to an update's last byte at a viewer. On a shared machine, `chrt -f 1 python …` excludes
other load. The runs are repeated with a fourth peer that never reads, is stopped, or floods.
For peers that are killed see benchmarks/live_peers.py.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from glissando.evaluation.run import checked_window
from glissando.hardware.live import IgtlSink, LiveSession, RecordingSource
from glissando.hardware.live.igtl_sink import readings_message
from glissando.hardware.openigtlink import encode
from glissando.hardware.openigtlink.crc import crc64
from glissando.hardware.openigtlink.message import HEADER, Framer, read_header
from glissando.io.recording_folder import load_recording
from glissando.model.sensors.sensors import PoseReadings

LAST = "Ellipsoids95"  # the last message of every update


def view(port: int, out: str) -> None:
    """Write arrival times of each update's last message, by stamp, until the server closes."""
    framer, came, count = Framer(1 << 24), {}, 0
    with socket.create_connection(("127.0.0.1", port)) as link:
        while data := link.recv(1 << 16):
            now = time.monotonic()
            for raw in framer.feed(data):
                count += 1
                header = read_header(raw)
                if header.device == LAST:
                    came[header.stamp] = now
                if count % 97 == 0 and crc64(raw[HEADER:]) != header.crc:
                    raise SystemExit("a message came damaged")
    Path(out).write_text(json.dumps(came))


def never_read(port: int, out: str) -> None:
    """Connect and read nothing."""
    with socket.create_connection(("127.0.0.1", port)):
        time.sleep(3600.0)


def flood(port: int, out: str) -> None:
    """Send valid messages as fast as they are accepted, then garbage; reconnect repeatedly."""
    if hasattr(os, "sched_setscheduler"):  # a remote attacker would have no real-time priority
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    message = encode(readings_message(_one_reading(), 1)) * 100
    while True:
        try:
            with socket.create_connection(("127.0.0.1", port)) as link:
                for _ in range(2000):
                    link.sendall(message)
                link.sendall(random.randbytes(4000))
                time.sleep(0.01)
        except OSError:
            time.sleep(0.01)


CLIENTS = {f.__name__: f for f in (view, never_read, flood)}
FOURTH = {"slow": never_read, "stopped": view, "malicious": flood}


def _one_reading() -> PoseReadings:
    at = np.zeros(1)
    return PoseReadings(time=at, arclength=at, values=np.eye(4)[None], cov=np.ones(6), name="flood")


def started(stack: ExitStack, kind: str, port: int, out: Path | str) -> subprocess.Popen:
    command = [sys.executable, __file__, "--client", kind, str(port), str(out)]
    process = subprocess.Popen(command)
    stack.callback(process.kill)
    return process


@dataclass
class Timed:
    """A session with time measurements of its estimates and of its sink.

    Attributes:
        session: The session; its only sink is timed.
        ended: End of the estimate for each session time, monotonic s.
        handed: Duration of `send`, and its processor time, for each update, s.
        stamps: End of the estimate for each update's stamp, monotonic s.
        computing: Duration of each estimate, s.
    """

    session: LiveSession
    ended: dict[float, float] = field(default_factory=dict)
    handed: list[tuple[float, float]] = field(default_factory=list)
    stamps: dict[str, float] = field(default_factory=dict)
    computing: list[float] = field(default_factory=list)

    def run(self) -> None:
        """Run the session to its end."""
        smoother, (sink,) = self.session.smoother, self.session.sinks
        advance, send = smoother.advance, sink.send

        def timed_advance(at):
            state = advance(at)
            self.ended[at] = time.monotonic()
            return state

        def timed_send(update):
            began, processor = time.perf_counter(), time.thread_time()
            send(update)
            self.handed.append((time.perf_counter() - began, time.thread_time() - processor))

        smoother.advance, sink.send = timed_advance, timed_send
        for update in self.session:
            self.stamps[str(update.stamp)] = self.ended[update.time]
            self.computing.append(update.computing)


def run(recording: str, options, extra: str, folder: Path) -> dict:
    """Run a session with three viewers and perhaps an extra peer; returns its measurements."""
    session = session_of(recording, options)
    (sink,), timed = session.sinks, Timed(session)
    outs = [folder / f"viewer{k}.json" for k in range(3)]
    with ExitStack() as stack:
        with session:
            viewers = [started(stack, "view", sink.port, out) for out in outs]
            join(stack, session, extra, folder)
            timed.run()
            counts, skipped = dict(sink.counts), session.skipped
        for viewer in viewers:
            viewer.wait(20)
    late, missed = lateness(timed.stamps, outs)
    ms = 1e3
    return {
        "recording": Path(recording).name,
        "extra": extra or "none",
        "updates": len(timed.stamps),
        "skipped": skipped,
        "missed by viewers": missed,
        "advance ms (p50, p99)": _percentiles(ms * np.array(timed.computing), 50, 99),
        "late ms (p50, p99, max)": _percentiles(ms * np.array(late), 50, 99, 100),
        "send ms (p50, p99, max)": _percentiles(ms * np.array(timed.handed)[:, 0], 50, 99, 100),
        "its processor time": _percentiles(ms * np.array(timed.handed)[:, 1], 50, 99, 100),
        "counts": counts,
        "load": os.getloadavg()[0],
    }


def session_of(recording: str, options) -> LiveSession:
    """A session that replays a recording to OpenIGTLink viewers."""
    loaded = load_recording(recording)
    first, last = checked_window(loaded, None)
    window = first, min(last, first + options.seconds + 4.0)
    return LiveSession(
        loaded.robot,
        [RecordingSource(loaded, loaded.robot, window=window)],
        [IgtlSink("igtl-server://:0?send=frames,tip,line,tube,ellipsoids")],
        rate=options.rate, points=options.points, duration=options.seconds,
    )  # fmt: skip


def join(stack: ExitStack, session: LiveSession, extra: str, folder: Path) -> None:
    """Start the extra peer, if any, and wait until all peers are connected."""
    (sink,) = session.sinks
    if extra:
        fourth = started(stack, FOURTH[extra].__name__, sink.port, folder / "extra.json")
    peers = 3 + (extra in ("slow", "stopped"))
    deadline = time.monotonic() + 60.0
    while sink._endpoint.peers < peers and time.monotonic() < deadline:
        sink.poll()
        time.sleep(0.01)
    if extra == "stopped":
        os.kill(fourth.pid, signal.SIGSTOP)


def lateness(stamps: dict[str, float], outs: list[Path]) -> tuple[list[float], int]:
    """Latencies (s) from an estimate's end to each viewer, and the number of missed updates."""
    late, missed = [], 0
    for out in outs:
        came = json.loads(out.read_text())
        late += [came[s] - at for s, at in stamps.items() if s in came]
        missed += sum(s not in came for s in stamps)
    return late, missed


def _percentiles(values, *which) -> list[float]:
    return [round(float(np.percentile(values, p)), 2) for p in which] if len(values) else []


def main() -> None:
    if sys.argv[1:2] == ["--client"]:
        CLIENTS[sys.argv[2]](int(sys.argv[3]), sys.argv[4])
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="+", metavar="RECORDING")
    parser.add_argument("--rate", type=float, default=60.0)
    parser.add_argument("--points", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = []
    for recording in options.recordings:
        for extra in ("", "slow", "stopped", "malicious"):
            with tempfile.TemporaryDirectory() as folder:
                results.append(run(recording, options, extra, Path(folder)))
            _show(results[-1], options)
    if options.json:
        print(json.dumps(results))


def _show(result: dict, options) -> None:
    if not options.json:
        print(", ".join(f"{name} {value}" for name, value in result.items()), flush=True)


if __name__ == "__main__":
    main()
