"""Recordings with a fault at a random time, for `faults.py`."""

import os
import signal
import time
import uuid

import numpy as np

from faults_bench import STROKE, Device, Program
from glissando.errors import GlissandoError
from glissando.io.recording_folder import load_recording
from glissando.io.session_log import read_session

SIGNALS = {"SIGTERM": signal.SIGTERM, "SIGHUP": signal.SIGHUP, "kill -9": signal.SIGKILL}
GOES_ON = ("jumped clock", "flood")  # faults after which a recording continues
RECORDED = (*SIGNALS, "Ctrl-C twice", "full disk", "vanished device", *GOES_ON, "same folder")
_EARLY = 0.2  # share of the faults before a recording has begun; the others are during it
_JUMP = """import os, time
_from, _by, _wall, _ns = float(os.environ["JUMP_AT"]), 3600.0, time.time, time.time_ns
_off = lambda: _by * float(os.environ["JUMP_BY"]) * (time.monotonic() > _from)
time.time = lambda: _wall() + _off()
time.time_ns = lambda: _ns() + int(1e9 * _off())
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


class RecordTrial:
    """A recording on a bench with a fault at a time drawn from `rng`.

    Attributes:
        happened: Time of the fault on the monotonic clock, s.
        over: Whether the program had ended before.
    """

    def __init__(self, bench, fault, rng, lasts):
        self.bench, self.fault, self.rng, self.lasts = bench, fault, rng, lasts
        self.out, self.hold = (
            bench.folder / f"session-{uuid.uuid4().hex[:8]}",
            bool(rng.integers(2)),
        )
        bench.setup(self.hold)
        self.early, self.share = rng.random() < _EARLY, rng.random()
        self.device = str(rng.choice(["servo", "aurora", "vicon"]))
        self.room = int(rng.integers(500, 30_000)) if fault == "full disk" else None
        self.command = ["record", "--setup", bench.folder / "bench.toml", "--slide", "oscillate"]
        self.command += ["--cycles", "1", "--stroke", STROKE, "--out", self.out]
        self.jump = self.flood = self.refused = None
        self.program = Program(self.command, room=self.room, **self._clock())

    def _clock(self):
        """Environment variables that make the program's clock jump, for that fault."""
        if self.fault != "jumped clock":
            return {}
        folder = self.bench.folder
        (folder / "sitecustomize.py").write_text(_JUMP)
        path = f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
        self.jump = time.monotonic() + self.share * sum(self.lasts)
        by = str(self.rng.choice([-1, 1]))
        return {"PYTHONPATH": path, "JUMP_AT": str(self.jump), "JUMP_BY": by}

    def wait(self):
        """Wait until the time of the fault."""
        if self.early:
            self.program.running_for(self.share * self.lasts[0])
            return
        while not (self.out / "session.mcap").exists() and self.program.process.poll() is None:
            time.sleep(0.002)
        self.program.running_for(self.share * self.lasts[1])

    def strike(self):
        """Cause the fault and wait for the program's exit status."""
        self.happened, program = time.monotonic(), self.program
        self.over = program.process.poll() is not None
        if self.fault in SIGNALS:
            program.alone(SIGNALS[self.fault])
        elif self.fault == "Ctrl-C twice":
            program.send(signal.SIGINT)
            time.sleep(self.rng.uniform(0.0, 0.5))
            program.send(signal.SIGINT)
        elif self.fault == "vanished device":
            self.bench.devices[self.device].kill()
        elif self.fault == "same folder" and not self.over:
            self.refused = Program(self.command).ended()
        elif self.fault == "flood":
            self.flood = Device("-c", _FLOOD, str(self.bench.mocap_port))
        status = program.ended()
        if self.jump:
            self.happened, self.over = self.jump, time.monotonic() < self.jump
        if self.flood:
            self.flood.kill()
        return status

    def left(self, status):
        """Check the state after the fault: a row of the table."""
        program, fault, happened = self.program, self.fault, self.happened
        row = {"fault": fault, "moment": happened - program.began, "status": status}
        row |= {"traceback": "Traceback" in program.said(), "left": program.left()}
        row["missed"] = status == 0 if self.room else self.over
        row["refused"] = self.refused in (None, 2)
        gone = fault == "vanished device" and self.device
        if gone != "servo":
            since = happened if fault in SIGNALS else time.monotonic()
            row["moves_on"] = self.bench.moved_until(since)
            held = self.bench.torque() == self.hold
            row["torque"] = held or fault == "kill -9" or not _moved(self.out)
        if gone:
            self.bench.start(gone)
        shown = "messages" in program.said()  # in its progress line: messages had been logged
        stopped = fault in SIGNALS or fault == "Ctrl-C twice"
        row |= _kept(self.out, happened if stopped else None, shown)
        if fault in GOES_ON and (self.out / "session.mcap").exists():
            row["lost"] = _longest_gap(self.out)
        row["said"] = (program.said().strip().splitlines() or [""])[-1][:200]
        return row


def record_trial(bench, fault, rng, lasts):
    """Run one recording with a fault; returns a row of the table."""
    trial = RecordTrial(bench, fault, rng, lasts)
    trial.wait()
    return trial.left(trial.strike())


def _moved(out):
    """Whether a session moved its stage before it ended."""
    log = out / "session.mcap"
    return log.exists() and "/slide" in read_session(log).topics


def _longest_gap(out):
    """Longest time between two messages of the tracker or the slide in a log, s."""
    topics = read_session(out / "session.mcap").topics.items()
    times = [t.time_ns for name, t in topics if not name.startswith("/mocap")]
    return 1e-9 * max((int(np.diff(t).max()) for t in times if len(t) > 1), default=0)


def _kept(out, happened, shown):
    """Whether a session's log opens, and the time (s) before `happened` that it lacks."""
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
    except GlissandoError as problem:  # the log opens, but has too few data for a recording
        return {"opens": "holds no pose" in str(problem), "lost": lost, "why": str(problem)}
