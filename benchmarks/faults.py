"""What is lost when a program is killed, stopped twice, or loses disk, device, clock or folder.

Each trial runs `record`, `replay` or `live` on simulated devices that speak their devices' bytes,
lets a fault happen at a random moment between the program's start and its end, and looks at what is
left: does the stage stand still, with torque as its setup says, what did the log lose, does it
open, is anything still running, was there a traceback; is a resumed replay the uninterrupted one.

Usage: faults.py [--count N] [--seed S] [--lanes L] [--fault NAME,…] [--json FILE]
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import threading
import time
import uuid
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from faults_bench import STROKE, Bench, Device, Program, free_port
from glissando.errors import DeviceError, GlissandoError
from glissando.io.journal import Journal
from glissando.io.recording import load_recording
from glissando.io.session_log import read_session
from glissando.simulation.simulate import simulate
from glissando.simulation.simulated_session import write_session

SPAN = 3.0  # s of a recording that is replayed as it was, and of a live estimate
_EARLY = 0.2  # of the faults happen before a recording has begun, the others before its end
_COMPILING = 600.0  # s that the first programs may take
_AGAIN = 100_000  # added to the number of a trial whose program had ended before its fault
SIGNALS = {"SIGTERM": signal.SIGTERM, "SIGHUP": signal.SIGHUP, "kill -9": signal.SIGKILL}
GOES_ON = ("jumped clock", "flood")  # faults that a recording outlives
RECORDED = (*SIGNALS, "Ctrl-C twice", "full disk", "vanished device", *GOES_ON, "same folder")
FAULTS = (*RECORDED, "replay stopped", "replay twice", "live, lost peer")
_JUMP = """import os, time
_from, _by, _wall, _ns = float(os.environ["JUMP_AT"]), 3600.0, time.time, time.time_ns
_off = lambda: _by * float(os.environ["JUMP_BY"]) * (time.monotonic() > _from)
time.time = lambda: _wall() + _off()
time.time_ns = lambda: _ns() + int(1e9 * _off())
"""
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
_FLOOD = """import os, socket, sys, time
ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
frame = bytes(4) + b"\\x02\\0" + os.urandom(144)
print("ready", flush=True)
sent, end = 0, time.monotonic() + 20.0
while time.monotonic() < end:
    for data in (os.urandom(1 + sent % 1400), frame, b"", bytes(1400)):
        ear.sendto(data, ("127.0.0.1", int(sys.argv[1])))
    sent += 1
    if sent % 25 == 0: time.sleep(0.005)
"""
_LISTENER = """import socket, sys, time
while True:
    try:
        with socket.create_connection(("127.0.0.1", int(sys.argv[1]))) as link:
            print("ready", flush=True)
            while link.recv(65536): pass
    except OSError: time.sleep(0.05)
"""


def record_trial(bench, fault, rng, lasts):
    """One recording with a fault; what it left."""
    out, hold = bench.folder / f"session-{uuid.uuid4().hex[:8]}", bool(rng.integers(2))
    bench.setup(hold)
    early, share = rng.random() < _EARLY, rng.random()
    device = str(rng.choice(["servo", "aurora", "vicon"]))
    room = int(rng.integers(500, 30_000)) if fault == "full disk" else None
    more, jump = {}, None
    if fault == "jumped clock":
        (bench.folder / "sitecustomize.py").write_text(_JUMP)
        path = f"{bench.folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
        jump = time.monotonic() + share * sum(lasts)
        more = {"PYTHONPATH": path, "JUMP_AT": str(jump), "JUMP_BY": str(rng.choice([-1, 1]))}
    command = ["record", "--setup", bench.folder / "bench.toml", "--slide", "oscillate"]
    command += ["--cycles", "1", "--stroke", STROKE, "--out", out]
    program, flood = Program(command, room=room, **more), None
    if early:
        program.running_for(share * lasts[0])
    else:
        while not (out / "session.mcap").exists() and program.process.poll() is None:
            time.sleep(0.002)
        program.running_for(share * lasts[1])
    happened, refused = time.monotonic(), None
    over = program.process.poll() is not None
    if fault in SIGNALS:
        program.alone(SIGNALS[fault])
    elif fault == "Ctrl-C twice":
        program.send(signal.SIGINT)
        time.sleep(rng.uniform(0.0, 0.5))
        program.send(signal.SIGINT)
    elif fault == "vanished device":
        bench.devices[device].kill()
    elif fault == "same folder" and not over:
        refused = Program(command).ended()
    elif fault == "flood":
        flood = Device("-c", _FLOOD, str(bench.mocap_port))
    status = program.ended()
    if jump:
        happened, over = jump, time.monotonic() < jump
    if flood:
        flood.kill()
    row = {"fault": fault, "moment": happened - program.began, "status": status}
    row |= {"traceback": "Traceback" in program.said(), "left": program.left()}
    row["missed"] = status == 0 if room else over
    row["refused"] = refused in (None, 2)
    gone = fault == "vanished device" and device
    if gone != "servo":
        row["moves_on"] = bench.moved_until(happened if fault in SIGNALS else time.monotonic())
        row["torque"] = bench.torque() == hold or fault == "kill -9" or not moved(out)
    if gone:
        bench.start(device)
    if fault in ("full disk", "vanished device"):
        happened = None  # the log may end when it was, and not later
    shown = "messages" in program.said()  # of its progress: some had been logged
    row |= kept(out, happened if fault in SIGNALS or fault == "Ctrl-C twice" else None, shown)
    if fault in GOES_ON and (out / "session.mcap").exists():
        row["lost"] = longest_gap(out)
    row["said"] = (program.said().strip().splitlines() or [""])[-1][:200]
    return row


def moved(out):
    """Whether a session came to moving its stage."""
    log = out / "session.mcap"
    return log.exists() and "/slide" in read_session(log).topics


def longest_gap(out):
    """The longest time between two messages of the tracker or the slide in a log, s."""
    topics = read_session(out / "session.mcap").topics.items()
    times = [t.time_ns for name, t in topics if not name.startswith("/mocap")]
    return 1e-9 * max((int(np.diff(t).max()) for t in times if len(t) > 1), default=0)


def kept(out, happened, shown):
    """What a session's log holds, and how much of the time before a moment it lost."""
    log = out / "session.mcap"
    if not log.exists():
        return {"opens": True, "lost": 0.0}
    session = read_session(log)
    last = max((t.time_ns[-1] for t in session.topics.values() if t.time_ns.size), default=None)
    lost = 0.0
    if happened is not None and not session.complete:
        begun = int(session.metadata["monotonic_ns"]) if shown else 1e9 * happened
        lost = max(happened - 1e-9 * (begun if last is None else last), 0.0)
    try:
        if any(name.startswith("/tracker") and t.messages for name, t in session.topics.items()):
            load_recording(log)
        return {"opens": True, "lost": lost}
    except GlissandoError as problem:  # it opens, and what it holds is no recording yet
        return {"opens": "holds no pose" in str(problem), "lost": lost, "why": str(problem)}


def replay_command(recording, out):
    return ["replay", recording, "--rate", "real", "--window", 0, SPAN, "--out", out]


def newest(out):
    """The newest states of a replay by time, and the rows that its journal holds by stream."""
    table = np.genfromtxt(out / "newest.csv", delimiter=",", names=True)
    values = np.array(table.tolist())
    rows = {name: s.rows.table() for name, s in load_recording(out / "log").streams.items()}
    return values, rows


def replay_trial(folder, recording, whole, rng, lasts):
    """A replay stopped at a random moment and resumed; how far it is from an uninterrupted one."""
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
    """Two replays into one folder, the second begun at a random moment of the first."""
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
    """A live estimate that loses the peer that sends, or the one that listens."""
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
    with Journal(out):  # nobody else has it any more
        pass
    found = load_recording(out).streams
    last = max((float(s.rows.time[-1]) for s in found.values()), default=0.0)
    # An update without a reading grows no more certain: the newest used is in the journal.
    row |= {"opens": True, "lost": max(float(times.min() - last), 0.0) if times.size else 0.0}
    row["refused"] = status in (0, 2)
    return row


def run(options, scratch):
    """All trials, lane by lane."""
    chosen = options.fault or FAULTS
    jobs = [(fault, k) for k in range(options.count) for fault in FAULTS if fault in chosen]
    session = simulate("sliding700", shape="C", slide="hold", duration=SPAN + 1.0, seed=1)
    write_session(session, scratch / "recording", "sliding700")
    lock, rows, waiting = threading.Lock(), [], deque(jobs)

    def lane(number):
        folder = scratch / f"lane{number}"
        folder.mkdir()
        bench, lasts, whole = Bench(folder), None, None
        try:
            while True:
                with lock:
                    if not waiting:
                        return
                    fault, k = waiting.popleft()
                rng = np.random.default_rng([options.seed, FAULTS.index(fault), k])
                if lasts is None:
                    lasts, whole = baseline(bench, scratch / "recording")
                if fault in RECORDED:
                    row = record_trial(bench, fault, rng, lasts[0])
                elif fault == "replay stopped":
                    row = replay_trial(folder, scratch / "recording", whole, rng, lasts[1])
                elif fault == "replay twice":
                    row = twice_trial(folder, scratch / "recording", whole, rng, lasts[1])
                else:
                    row = live_trial(folder, rng)
                with lock:
                    if row.pop("missed", False):  # it had ended: another moment instead
                        waiting.append((fault, k + _AGAIN))
                        continue
                    rows.append(row)
                    save(rows, options)
                    print(json.dumps(row), file=sys.stderr, flush=True)
        finally:
            bench.close()

    with ThreadPoolExecutor(options.lanes) as pool:
        for done in [pool.submit(lane, number) for number in range(options.lanes)]:
            done.result()
    return rows


def baseline(bench, recording):
    """How long a recording and a replay last without a fault, and what the replay gives."""
    bench.setup(hold=True)
    command = ["record", "--setup", bench.folder / "bench.toml", "--cycles", 1, "--stroke", STROKE]
    for out in (bench.folder / "compiling", bench.folder / "baseline"):
        program = Program([*command, "--out", out])
        while not (out / "session.mcap").exists() and program.process.poll() is None:
            time.sleep(0.002)
        begun = time.monotonic()
        if program.ended(_COMPILING) != 0:
            raise DeviceError(f"A recording without a fault failed: {program.said()}")
        record = begun - program.began, time.monotonic() - begun
        program = Program(replay_command(recording, out.with_suffix(".replay")))
        if program.ended(_COMPILING) != 0:
            raise GlissandoError(f"A replay without a fault failed: {program.said()}")
    return (record, time.monotonic() - program.began), newest(out.with_suffix(".replay"))


def table(rows):
    """A row a fault: what was tried, and the worst of what was found."""
    out = []
    for fault in FAULTS:
        some = [row for row in rows if row["fault"] == fault]
        if some:
            out.append(
                {
                    "fault": fault,
                    "trials": len(some),
                    "first_s": min(r["moment"] for r in some),
                    "last_s": max(r["moment"] for r in some),
                    "statuses": sorted({str(r["status"]) for r in some}),
                    "tracebacks": sum(r["traceback"] for r in some),
                    "left_running": sum(r["left"] for r in some),
                    "lost_s": max(r["lost"] for r in some),
                    "not_opened": sum(not r["opens"] for r in some),
                    "moves_on_s": max(
                        (r["moves_on"] for r in some if "moves_on" in r), default=None
                    ),
                    "torque_wrong": sum(not r.get("torque", True) for r in some),
                    "not_refused": sum(not r.get("refused", True) for r in some),
                    "differs": max((r["differs"] for r in some if "differs" in r), default=None),
                }
            )
    return out


def save(rows, options):
    """Write what was found so far, for a run takes its time."""
    if options.json:
        document = {"seed": options.seed, "rows": table(rows), "trials": rows}
        options.json.write_text(json.dumps(document, indent=1) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--count", type=int, default=50, help="trials of each fault")
    add("--seed", type=int, default=0)
    add("--lanes", type=int, default=2, help="benches of devices that run at once")
    add("--fault", type=lambda text: text.split(","), default=[], help=", ".join(FAULTS))
    add("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        rows = run(options, Path(scratch))
    found = table(rows)
    for row in found:
        print(json.dumps(row))
    bad = ("tracebacks", "left_running", "not_opened", "torque_wrong", "not_refused")
    return int(any(row[key] for row in found for key in bad))


if __name__ == "__main__":
    sys.exit(main())
