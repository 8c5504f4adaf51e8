"""Replays and live estimates with a fault at a random time, for `faults.py`."""

import signal
import time
import uuid

import numpy as np

from faults_bench import Device, Program, free_port
from faults_record import SIGNALS
from glissando.io.journal import Journal
from glissando.io.recording_folder import load_recording

SPAN = 3.0  # s: duration of the replayed window, and of a live estimate
_PEER = """import sys, time, numpy as np
from glissando.hardware.openigtlink import Endpoint, Message, encode
from glissando.hardware.openigtlink import contents as c
with Endpoint(sys.argv[1]) as peer:
    print("ready", flush=True)
    k = 0
    while True:
        pose = np.eye(4); pose[2, 3] = 466.0 + 0.01 * np.sin(k); k += 1
        base = np.eye(4); base[0, 3] = 0.001 * np.sin(k)
        peer.send([encode(Message(c.Transform(p), n)) for n, p in (("base", base), ("tip", pose))])
        time.sleep(1 / 30)
"""
_LISTENER = """import socket, sys, time
while True:
    try:
        with socket.create_connection(("127.0.0.1", int(sys.argv[1]))) as link:
            print("ready", flush=True)
            while link.recv(65536): pass
    except OSError: time.sleep(0.05)
"""


def replay_command(recording, out):
    return ["replay", recording, "--rate", "real", "--window", 0, SPAN, "--out", out]


def newest(out):
    """Newest states of a replay over time, and the rows of its journal by stream."""
    table = np.genfromtxt(out / "newest.csv", delimiter=",", names=True)
    values = np.array(table.tolist())
    rows = {name: s.rows.table() for name, s in load_recording(out / "log").streams.items()}
    return values, rows


def replay_trial(folder, recording, whole, rng, lasts):
    """Stop a replay at a random time, resume it, and compare it with an uninterrupted one."""
    out = folder / f"replay-{uuid.uuid4().hex[:8]}"
    number = signal.Signals(rng.choice([*SIGNALS.values(), signal.SIGINT]))
    program = Program(replay_command(recording, out))
    moment = rng.uniform(0.1, 0.95) * lasts
    program.running_for(moment)
    missed = program.process.poll() is not None
    program.alone(number)
    status = program.ended()
    row = {"fault": "replay stopped", "moment": moment, "status": status, "left": program.left()}
    row["missed"] = missed
    row["traceback"] = "Traceback" in program.said()
    if not (out / "replay.json").exists():
        again = Program(replay_command(recording, out))
        row["status"] = again.ended()
        row["said"] = again.said()[-200:]
    values, rows = newest(out)
    same = values[:, 0, None] == whole[0][:, 0]
    match = same & (values[:, 1, None] == whole[0][:, 1])
    row["differs"] = float(np.abs(values - whole[0][match.argmax(axis=1)]).max())
    row["opens"] = all(np.array_equal(rows[name], whole[1][name]) for name in whole[1])
    row["lost"] = 0.0 if row["opens"] else float("nan")
    return row


def twice_trial(folder, recording, whole, rng, lasts):
    """Run two replays into one folder, the second started at a random time during the first."""
    out = folder / f"twice-{uuid.uuid4().hex[:8]}"
    first = Program(replay_command(recording, out))
    moment = rng.uniform(0.1, 0.9) * lasts
    time.sleep(moment)
    second = Program(replay_command(recording, out))
    ends = first.ended(), second.ended()
    _, rows = newest(out)
    opens = all(np.array_equal(rows[name], whole[1][name]) for name in whole[1])
    said = second.said().strip().splitlines()[-1][:200]
    row = {"fault": "replay twice", "moment": moment, "status": max(ends), "said": said}
    row |= {"refused": sorted(ends) == [0, 2], "opens": opens, "lost": 0.0}
    row["left"] = first.left() + second.left()
    return {**row, "traceback": "Traceback" in first.said() + second.said()}


def live_trial(folder, rng):
    """Run a live estimate during which its source or its viewer is killed."""
    out, ports = folder / f"live-{uuid.uuid4().hex[:8]}", (free_port(), free_port())
    sender = Device("-c", _PEER, f"igtl-server://:{ports[0]}")
    source = f"igtl://127.0.0.1:{ports[0]}"
    command = ["live", "--robot", "tdcr466", "--source", source, "--at", "base=0", "--at"]
    command += ["tip=0.466", "--sink", f"igtl-server://:{ports[1]}", "--journal", out]
    command += ["--duration", SPAN, "--patience", 2, "--sink", f"csv:{out}.csv"]
    program = Program(command)
    listener = Device("-c", _LISTENER, str(ports[1]))
    moment, lost = rng.uniform(0.0, SPAN), [sender, listener][int(rng.integers(2))]
    time.sleep(moment)
    lost.kill()
    status = program.ended()
    for peer in (sender, listener):
        peer.kill()
    said = program.said()
    row = {"fault": "live, lost peer", "moment": moment, "status": status, "left": program.left()}
    row |= {"traceback": "Traceback" in said, "said": said.strip().splitlines()[-1][:200]}
    times = np.genfromtxt(f"{out}.csv", delimiter=",", names=True)["time"]
    with Journal(out):  # no other process holds its lock
        pass
    found = load_recording(out).streams
    last = max((float(s.rows.time[-1]) for s in found.values()), default=0.0)
    # Updates without readings do not count: the newest reading used must be in the journal.
    row |= {"opens": True, "lost": max(float(times.min() - last), 0.0) if times.size else 0.0}
    row["refused"] = status in (0, 2)
    return row
