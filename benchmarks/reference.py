"""Processor time of glissando against the published C++ implementation, run in turns.

    python benchmarks/reference.py BUILT [--data FOLDER] [--rounds 5] [--only NAME …] [--json FILE]

BUILT is a folder with the programs stc_batch, stc_window and stc_filter and their settings under
source/stc/assets/config; each prints JSON of its runs. FOLDER holds the public recordings. Every
round runs both programs in new processes on one thread, in alternating order; ratios are of the two
runs of a round. numba's kernels are compiled before.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

THREADS = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
os.environ.update(THREADS)

import numpy as np

from glissando import FixedLagSmoother, load_robot
from glissando.evaluation.run import chosen_streams, run_estimate
from glissando.io.recording_folder import load_recording

# name: program, its robot, our robot, recording, window (s), time nodes (None for a batch)
TASKS = {
    "batch, free": ("batch", "robot2", "tdcr466", "slow_free_space", (19.0, 29.0), None),
    "batch, contact": ("batch", "robot2", "tdcr466", "fast_contact", (10.0, 20.0), None),
    "batch, extensible": ("batch", "robot1", "extensible1m", "extensible", (0.0, 1.0), None),
    "window, free": ("window", "robot2", "tdcr466", "slow_free_space", (19.0, 29.0), 4),
    "window, contact": ("window", "robot2", "tdcr466", "fast_contact", (10.0, 20.0), 4),
    "filter, free": ("filter", "robot2", "tdcr466", "slow_free_space", (19.0, 29.0), 1),
    "filter, contact": ("filter", "robot2", "tdcr466", "fast_contact", (10.0, 20.0), 1),
}
WARM = 2  # estimates in a process after the first


def answer(command):
    """Parsed JSON of the last line that a program prints."""
    done = subprocess.run(
        list(map(str, command)),
        env={**os.environ, **THREADS},
        cwd=tempfile.gettempdir(),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1) or not done.stdout.strip():
        raise SystemExit(f"{command[0]} failed ({done.returncode}): {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def theirs(options, name):
    """Seconds of each batch estimate, or of each update, of the C++ program."""
    program, robot, _, recording, _, nodes = TASKS[name]
    settings = options.built / "source/stc/assets/config"
    command = [
        options.built / f"stc_{program}", settings / f"robot/{robot}.json",
        settings / f"trial/{recording}.json", "--data", options.data / recording,
        "--repeat", 1 + WARM,
    ]  # fmt: skip
    runs = answer(command)["runs"]
    if not runs[0]["success"]:
        raise SystemExit(f"{name}: the C++ program did not converge")
    return [run["seconds"] for run in runs] if nodes is None else runs[0]["latency"]


def ours(options, name):
    """Seconds of each batch estimate, or of each update, of glissando in its own process."""
    return answer([sys.executable, Path(__file__).resolve(), "--worker", name, options.data])


def worker(name, data):
    """Seconds of each batch estimate, or of each update, of glissando in this process."""
    _, _, robot, recording, window, nodes = TASKS[name]
    recording, robot = load_recording(Path(data) / recording), load_robot(robot)
    if nodes is None:
        seconds = []
        for _ in range(1 + WARM):
            run = run_estimate(recording, robot, window=window, use=None, truth=None)
            seconds.append(run.posterior.solve.seconds["total"])
            del run  # frees its memory for the next run
        return seconds
    readings, _, _ = chosen_streams(recording, robot, window, None, None)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=nodes)
    seconds, since = [], -np.inf
    for now in np.linspace(*window, round((window[1] - window[0]) * robot.time_rate) + 1):
        arrived = [r.select((r.time > since) & (r.time <= now)) for r in readings]
        start = time.process_time()
        for stream in filter(len, arrived):
            smoother.add(stream)
        smoother.advance(float(now))
        seconds.append(time.process_time() - start)
        since = now
    return seconds


def _reported(name, seconds):
    """Reported times of a run: of the first and later estimates, or of updates."""
    if TASKS[name][-1] is None:
        return {"first, s": seconds[0], "warm, s": float(np.median(seconds[1:]))}
    median, p99 = 1e3 * np.percentile(seconds, [50, 99])
    return {"median update, ms": float(median), "p99 update, ms": float(p99)}


def table(found):
    """Least, median and largest time of all rounds, as a Markdown table."""
    three = "{:.3g} / {:.3g} / {:.3g}".format
    yield from ["| processor time | C++ | glissando | times as fast |", "|---|---|---|---|"]
    for name, rounds in found.items():
        for what in rounds[0]["C++"]:
            both = np.array([[turn[who][what] for turn in rounds] for who in ("C++", "glissando")])
            rows = (*both, both[0] / both[1])
            cells = (three(*np.percentile(row, [0, 50, 100])) for row in rows)
            yield f"| {name}: {what} | {' | '.join(cells)} |"


def main():
    if sys.argv[1:2] == ["--worker"]:
        print(json.dumps(worker(*sys.argv[2:])))
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    beside = Path(__file__).parents[1] / ".." / "shared" / "data" / "spacetime"
    parser.add_argument("built", type=Path, help="folder of the built programs")
    parser.add_argument("--data", type=Path, default=beside, help="folder of the recordings")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="+", choices=TASKS, default=list(TASKS))
    parser.add_argument("--json", type=Path, help="write every number here")
    options = parser.parse_args()
    options.data, options.built = options.data.resolve(), options.built.resolve()
    programs, found = {"C++": theirs, "glissando": ours}, {name: [] for name in options.only}
    for name in options.only:
        ours(options, name)
    for turn in range(options.rounds):
        for name in options.only:
            order = list(programs)[:: 1 if turn % 2 == 0 else -1]
            found[name].append(
                {who: _reported(name, programs[who](options, name)) for who in order}
            )
            print(f"round {turn + 1}, {name}: {found[name][-1]}", file=sys.stderr, flush=True)
    print("\n".join(table(found)))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
