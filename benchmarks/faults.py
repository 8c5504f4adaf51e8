"""Losses when a program is killed, stopped twice, or loses disk, device, clock or folder.

Each trial runs `record`, `replay` or `live` on simulated devices with the devices' own protocols,
causes a fault at a random time between the program's start and its end, and checks the result:
does the stage stop, with torque as in its setup; what is missing in the log, and does it open; are
processes still running; was there a traceback; does a resumed replay equal an uninterrupted one.

Usage: faults.py [--count N] [--seed S] [--lanes L] [--fault NAME,…] [--json FILE]
"""

import argparse
import json
import sys
import tempfile
import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from faults_bench import STROKE, Bench, Program
from faults_record import RECORDED, record_trial
from faults_replay import SPAN, live_trial, newest, replay_command, replay_trial, twice_trial
from glissando.errors import DeviceError, GlissandoError
from glissando.simulation.simulate import simulate
from glissando.simulation.simulated_session import write_session

_COMPILING = 600.0  # s: time limit of the first programs, which compile kernels
_AGAIN = 100_000  # added to the number of a trial whose program had ended before its fault
FAULTS = (*RECORDED, "replay stopped", "replay twice", "live, lost peer")


def run(options, scratch):
    """Run all trials, one bench of devices per lane."""
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
                    if row.pop("missed", False):  # ended before: repeat
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
    """Durations (s) of a recording and of a replay without a fault, and the replay's result."""
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
    """Rows by fault: number and times of trials, and the worst results."""
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
    """Write the results so far, because a run takes long."""
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
