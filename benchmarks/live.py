"""Live updates to OpenIGTLink viewers: how late they come, and what bad peers and kills cost.

    python benchmarks/live.py RECORDING... [--rate 60] [--points 30] [--seconds 8] [--kills 50]

For each recording, at its own pace: updates of all kinds (frames, tip, line, 95 % tube, ellipsoids)
go to three viewers on loopback, each a process. Late is an update's last byte at a viewer, counted
from the end of `advance`. On a machine that others use as well, `chrt -f 1 python …` keeps their
load out of it. Then the same with a fourth peer that never reads, that is stopped, or
that floods; and a tracker and a viewer that are killed again and again.
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
from pathlib import Path

import numpy as np

from glissando.evaluation.run import checked_window, chosen_streams
from glissando.hardware.live import IgtlSink, IgtlSource, LiveSession, RecordingSource
from glissando.hardware.live.igtl_sink import readings_message
from glissando.hardware.openigtlink import Endpoint, encode, stamp_of
from glissando.hardware.openigtlink.crc import crc64
from glissando.hardware.openigtlink.framer import Framer
from glissando.hardware.openigtlink.message import HEADER, read_header
from glissando.io.recording import load_recording
from glissando.model.sensors.sensors import PoseReadings

LAST = "Ellipsoids95"  # the last message of every update


def view(port: int, out: str) -> None:
    """Write when the last message of each update came, by its stamp, until the server is gone."""
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
    """Send whole messages as fast as they are taken; garbage at times, and come back."""
    if hasattr(os, "sched_setscheduler"):  # an attacker from elsewhere has no priority here
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


def track(port: int, out: str) -> None:
    """Serve a recording's readings at `port`, at their pace, from where the clock stands."""
    recording, began = Path(out).read_text().splitlines()
    loaded = load_recording(recording)
    robot = loaded.robot
    readings = chosen_streams(loaded, robot, checked_window(loaded, None), None, None)[0]
    first = min(r.time[0] for r in readings)
    done = time.time() - float(began)
    with Endpoint(f"igtl-server://127.0.0.1:{port}") as peer:
        while True:
            now = time.time() - float(began)
            for r in readings:
                some = r.select((r.time - first > done) & (r.time - first <= now))
                if len(some):
                    stamp = stamp_of(float(began) + some.time[-1] - first)
                    peer.send([encode(readings_message(some, stamp))])
            done = now
            peer.receive()
            time.sleep(0.005)


CLIENTS = {f.__name__: f for f in (view, never_read, flood, track)}


def _one_reading() -> PoseReadings:
    at = np.zeros(1)
    return PoseReadings(time=at, arclength=at, values=np.eye(4)[None], cov=np.ones(6), name="flood")


def started(stack: ExitStack, kind: str, port: int, out: Path | str) -> subprocess.Popen:
    command = [sys.executable, __file__, "--client", kind, str(port), str(out)]
    process = subprocess.Popen(command)
    stack.callback(process.kill)
    return process


def run(recording: str, options, extra: str, folder: Path) -> dict:
    """One session with three viewers and perhaps an extra peer; its figures."""
    loaded = load_recording(recording)
    first, last = checked_window(loaded, None)
    source = RecordingSource(
        loaded, loaded.robot, window=(first, min(last, first + options.seconds + 4.0))
    )
    sink = IgtlSink("igtl-server://:0?send=frames,tip,line,tube,ellipsoids")
    session = LiveSession(
        loaded.robot, [source], [sink], rate=options.rate, points=options.points,
        duration=options.seconds,
    )  # fmt: skip
    ended, spent, computed = {}, [], []
    with ExitStack() as stack:
        outs = [folder / f"viewer{k}.json" for k in range(3)]
        with session:
            viewers = [started(stack, "view", sink.port, out) for out in outs]
            if extra:
                kind = {"slow": "never_read", "stopped": "view", "malicious": "flood"}[extra]
                fourth = started(stack, kind, sink.port, folder / "extra.json")
            peers = 3 + (extra in ("slow", "stopped"))
            deadline = time.monotonic() + 60.0
            while sink._endpoint.peers < peers and time.monotonic() < deadline:
                sink._endpoint.receive()
                time.sleep(0.01)
            if extra == "stopped":
                os.kill(fourth.pid, signal.SIGSTOP)
            advance, send = session.smoother.advance, sink.send

            def timed_advance(at):
                state = advance(at)
                ended[at] = time.monotonic()
                return state

            def timed_send(update):
                began, processor = time.perf_counter(), time.thread_time()
                send(update)
                spent.append((time.perf_counter() - began, time.thread_time() - processor))

            session.smoother.advance, sink.send = timed_advance, timed_send
            stamps = {}
            for update in session:
                stamps[str(update.stamp)] = ended[update.time]
                computed.append(update.computing)
            counts, skipped = dict(sink.counts), session.skipped
        for viewer in viewers:
            viewer.wait(20)
    late, missed = [], 0
    for out in outs:
        came = json.loads(out.read_text())
        late += [came[s] - at for s, at in stamps.items() if s in came]
        missed += sum(s not in came for s in stamps)
    ms = 1e3
    return {
        "recording": Path(recording).name,
        "extra": extra or "none",
        "updates": len(stamps),
        "skipped": skipped,
        "missed by viewers": missed,
        "advance ms (p50, p99)": _percentiles(ms * np.array(computed), 50, 99),
        "late ms (p50, p99, max)": _percentiles(ms * np.array(late), 50, 99, 100),
        "send ms (p50, p99, max)": _percentiles(ms * np.array(spent)[:, 0], 50, 99, 100),
        "its processor time": _percentiles(ms * np.array(spent)[:, 1], 50, 99, 100),
        "counts": counts,
        "load": os.getloadavg()[0],
    }


def _percentiles(values, *which) -> list[float]:
    return [round(float(np.percentile(values, p)), 2) for p in which] if len(values) else []


def kill(recording: str, options, folder: Path) -> dict:
    """Tracker and viewer are killed again and again; what of the session and the journal."""
    loaded = load_recording(recording)
    rng = random.Random(options.seed)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    orders = folder / "orders.txt"
    orders.write_text(f"{Path(recording).resolve()}\n{time.time()}")
    source = IgtlSource(f"igtl://127.0.0.1:{port}?clock=shared", loaded.robot)
    log = folder / "log"
    sink = IgtlSink("igtl-server://:0")
    session = LiveSession(
        loaded.robot, [source], [sink], rate=options.rate, journal=log, patience=60.0
    )
    used, kills, returned, updates = 0, {"tracker": 0, "viewer": 0}, 0, 0
    with ExitStack() as stack:
        stack.enter_context(session)
        tracker = started(stack, "track", port, orders)
        viewer = started(stack, "view", sink.port, folder / "viewer.json")
        heard, alive_until = False, 0.0
        for update in session:
            updates += 1
            fresh = sum(map(len, update.readings))
            used += fresh
            if fresh and not heard:
                heard, returned = True, returned + 1
                alive_until = time.monotonic() + rng.uniform(0.0, 0.5)
            if not heard or time.monotonic() < alive_until:
                continue
            if sum(kills.values()) >= options.kills:
                break
            alive_until = time.monotonic() + rng.uniform(0.0, 0.5)
            if rng.random() < 0.5 and sink._endpoint.peers:
                viewer.kill()
                viewer.wait()
                kills["viewer"] += 1
                viewer = started(stack, "view", sink.port, folder / "viewer.json")
            else:
                tracker.kill()
                tracker.wait()
                kills["tracker"], heard = kills["tracker"] + 1, False
                orders.write_text(f"{Path(recording).resolve()}\n{time.time()}")
                tracker = started(stack, "track", port, orders)
    logged = sum(s.rows.time.size for s in load_recording(log).streams.values())
    return {
        "recording": Path(recording).name,
        "killed": kills,
        "times readings came again": returned,
        "updates": updates,
        "readings used": used,
        "in the journal": logged,
    }


def main() -> None:
    if sys.argv[1:2] == ["--client"]:
        CLIENTS[sys.argv[2]](int(sys.argv[3]), sys.argv[4])
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="+", metavar="RECORDING")
    parser.add_argument("--rate", type=float, default=60.0)
    parser.add_argument("--points", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = []
    for recording in options.recordings:
        for extra in ("", "slow", "stopped", "malicious"):
            with tempfile.TemporaryDirectory() as folder:
                results.append(run(recording, options, extra, Path(folder)))
            _show(results[-1], options)
        if options.kills:
            with tempfile.TemporaryDirectory() as folder:
                results.append(kill(recording, options, Path(folder)))
            _show(results[-1], options)
    if options.json:
        print(json.dumps(results))


def _show(result: dict, options) -> None:
    if not options.json:
        print(", ".join(f"{name} {value}" for name, value in result.items()), flush=True)


if __name__ == "__main__":
    main()
