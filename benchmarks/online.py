"""Write the measured part of docs/online.md: latency, errors and memory of the online estimator.

One thread; the time of the arithmetic alone is given for comparison. FOLDER holds the public
recordings.
Usage: online.py [--data FOLDER] [--learned FILE] [--hours H]
"""

import argparse
import os
import platform
import time
from dataclasses import replace
from datetime import date
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from estimate import arc
from glissando import CoilReadings, FixedLagSmoother, PoseReadings, load_robot
from glissando.evaluation.replay import replay
from glissando.io.recording_folder import load_recording
from glissando.model.sensors.parameters import SensorParameter

# Published for the reference implementation's window of four nodes and its filter: tip RMSE (mm)
# and milliseconds an update, median and 99 % (one thread of a 2.5 GHz Xeon core).
PUBLISHED = [
    ("slow_free_space", (19.0, 29.0), (5.4, 5.4), (25, 42), (16, 23)),
    ("fast_contact", (10.0, 20.0), (6.0, 8.1), (27, 42), (12, 21)),
    ("fast_contact", (20.0, 30.0), (7.9, 8.3), (27, 40), (12, 24)),
    ("extensible", (0.0, 1.0), (None, None), (None, None), (319, None)),
]
SIZES = [(5, 4), (5, 1), (10, 10)]
ROUNDS = 5
DOF = 18
LENGTH = load_robot("tdcr466").length
TRACKER_RATE = 40.0  # Hz: rate of the tracker, which was polled at 50 Hz
LATE = {"slow_free_space": 0.02, "fast_contact": 0.002}  # s: delay of motion capture

MEASURED = "## On the public recordings\n"  # the page below this heading is generated


def number(value, scale=1.0, digits=1):
    return "–" if value is None else f"{scale * value:.{digits}f}"


def tip(judged):
    sites = judged["sites"] if judged else []
    return max(sites, key=lambda s: s["arclength"])["position_rmse"] if sites else None


def run(data, name, window, nodes, lag):
    """Replay one row of the table; returns its report as a dictionary."""
    recording = load_recording(data / name)
    robot = recording.robot
    robot = replace(robot, arclength_nodes=np.linspace(0.0, robot.length, nodes))
    return replay(recording, robot, window=window, lag=(lag - 1) / robot.time_rate).as_json()


def recordings(data):
    """Rows of the table of public recordings with published settings, each run ROUNDS times.

    Runs take turns, because a shared machine may be slow for minutes; the median run is reported.
    """
    rows = [(row, size) for row in PUBLISHED for size in SIZES]
    runs = [[run(data, *row[:2], *size) for row, size in rows] for _ in range(ROUNDS)]
    lines = []
    for ((name, window, tips, took, took_filter), (nodes, lag)), found in zip(
        rows, zip(*runs, strict=True), strict=True
    ):
        middle = sorted(found, key=lambda each: each["latency"]["median"])[ROUNDS // 2]
        times, (theirs, filtered) = middle["latency"], tips
        their_tip, their_time = (filtered, took_filter) if lag == 1 else (theirs, took)
        if nodes != 5:
            their_tip, their_time = None, (None, None)
        lines.append(
            f"| {name} {window[0]:g}–{window[1]:g} s | {nodes} | {lag} | "
            f"{number(times['median'], 1e3)} / {number(times['p99'], 1e3)} | "
            f"{number(their_time[0], 1, 0)} / {number(their_time[1], 1, 0)} | "
            f"{number(tip(middle['newest']), 1e3)} | {number(tip(middle['lagged']), 1e3)} | "
            f"{number(their_tip)} | {middle['real_time_factor']:.1f} |"
        )
        print(lines[-1], *(number(each["latency"]["median"], 1e3) for each in found), flush=True)
    return lines


def settings(data, learned):
    """Rows of errors of the tip by settings of the robot and of the tracker."""
    lines = []
    for name, window, (theirs, _), *_ in PUBLISHED[:3]:
        recording = load_recording(data / name)
        robots = {
            "published settings": recording.robot,
            "the tracker's own rate": replace(recording.robot, sensor_rate={"pose": TRACKER_RATE}),
        }
        late = np.array([LATE[name]])
        late = SensorParameter("truth", "time_offset", ("vicon4",), late, np.zeros(1))
        robots["and motion capture's delay"] = replace(
            robots["the tracker's own rate"],
            sensor_parameters=(*recording.robot.sensor_parameters, late),
        )
        if learned is not None:
            robots["learned and calibrated"] = load_robot(learned)
        for what, robot in robots.items():
            found = replay(recording, robot, window=window, lag=3 / robot.time_rate).as_json()
            both = (f"{number(tip(found[kind]), 1e3, 2)}" for kind in ("newest", "lagged"))
            lines.append(
                f"| {name} {window[0]:g}–{window[1]:g} s | {what} | {' | '.join(both)} | "
                f"{number(theirs)} |"
            )
            print(lines[-1], flush=True)
    return lines


def arithmetic(nodes, changed=2):
    """Floating-point operations (millions) of an update, and their time (ms) on this machine."""
    size = nodes * DOF
    each = 1 / 3 + 1 / 3 + 2 + 2  # factor, invert, coupling, Schur complement
    millions = changed * each * size**3 / 1e6
    a = np.random.default_rng(0).standard_normal((size, size))
    best = np.inf
    for _ in range(50):
        start = time.perf_counter()
        a @ a
        best = min(best, time.perf_counter() - start)
    return millions, 1e3 * millions * 1e6 * best / (2 * size**3)


def sliding(duration):
    """Yield time and readings of each update: a sliding coil and the base, for `duration` s."""
    step, rate = 0.1, 40.0
    for k in range(1, int(duration / step) + 1):
        now = (k - 1) * step + np.arange(1, 5) / rate
        place = LENGTH - 0.06 * np.abs(np.sin(now))
        tip_of = arc(place, now)
        yield (
            k * step,
            [
                CoilReadings(
                    time=now,
                    arclength=place,
                    values=tip_of,
                    cov=[5e-7] * 3 + [4e-5] * 2,
                    name="coil",
                ),
                PoseReadings(
                    time=now[-1:],
                    arclength=np.zeros(1),
                    values=np.eye(4)[None],
                    cov=1e-6,
                    name="base",
                ),
            ],
        )


def resident():
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def endurance(hours):
    """Number of updates, memory (MB) after a minute and at the end, median latencies (ms)."""
    robot = load_robot("tdcr466")
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=4)
    latency, early = [], 0.0
    for now, readings in sliding(3600.0 * hours):
        start = time.perf_counter()
        for stream in readings:
            smoother.add(stream)
        smoother.advance(now)
        latency.append(time.perf_counter() - start)
        if len(latency) == 600:
            early = resident()
    part = max(1, len(latency) // 12)
    medians = [1e3 * float(np.median(chunk)) for chunk in (latency[:part], latency[-part:])]
    return len(latency), early, resident(), medians


def public(data, learned):
    """Lines on latencies and errors on the public recordings."""
    return [
        MEASURED,
        f"Published settings, 30 updates a second, one thread, {platform.machine()}, "
        f"{date.today()}. Latencies are milliseconds, median / 99 % of the middle of {ROUNDS} runs "
        "in turns; RMSE of the tip in mm. The "
        "newest estimate of an interval uses readings up to its end, the lagged one all until it "
        "leaves the window (a filter is judged by its prediction). `theirs` was "
        "published for the reference implementation, whose window does not converge on "
        "`extensible`.",
        "",
        "| window | nodes | time nodes | latency | theirs | newest tip | lagged tip | theirs "
        "| × real time |",
        "|---|---|---|---|---|---|---|---|---|",
        *recordings(data),
        "",
        "The tracker's stamps are up to 20 ms late: it measures 40 times a second and was polled "
        "50 times. [`rate`](recordings.md#robot-file-keys) in the robot file replaces them by "
        "steady ones, which matters most for the newest state of a fast tip. "
        "Motion capture, the truth, is late too, differently in each recording "
        "([estimated](confidence.md#the-real-robot) together with the sensors): "
        + " and ".join(f"{1e3 * late:g} ms in `{name}`" for name, late in LATE.items())
        + ". An estimate that is itself late has smaller errors against it. The learned file is "
        "that of [the real robot](confidence.md#the-real-robot). RMSE of the tip in mm:",
        "",
        "| window | | newest | lagged | published |",
        "|---|---|---|---|---|",
        *settings(data, learned),
        "",
    ]


def limits():
    """Lines on the time of an update's arithmetic."""
    text = [
        "A lower bound for the arithmetic, if every operation were as fast as a matrix product of "
        "that size on this machine:",
        "",
        "| nodes | million operations an update | ms |",
        "|---|---|---|",
    ]
    for nodes in (5, 10):
        millions, least = arithmetic(nodes)
        text.append(f"| {nodes} | {millions:.0f} | {least:.1f} |")
    return [
        *text,
        "",
        "The rest is small triangular kernels, readings, the prior, and Python between them.",
        "",
    ]


def hours_on(hours):
    """Lines on memory and latency over a long time."""
    updates, early, late, (first, last) = endurance(hours)
    return [
        "## For hours",
        "",
        f"{hours:g} h of a coil sliding at 40 readings a second, {updates:,} updates at "
        f"maximum rate: {early:.0f} MB after the first minute and {late:.0f} MB at the end "
        f"({100 * (late / early - 1):+.1f} %); median latency {first:.2f} ms in the first twelfth, "
        f"{last:.2f} ms in the last.",
        "",
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    beside = Path(__file__).parents[1] / ".." / "shared" / "data" / "spacetime"
    parser.add_argument("--data", type=Path, default=beside)
    parser.add_argument("--learned", help="a robot file learned as docs/confidence.md shows")
    parser.add_argument("--hours", type=float, default=1.0)
    options = parser.parse_args()
    text = [*public(options.data, options.learned), *limits(), *hours_on(options.hours)]
    page = Path(__file__).parents[1] / "docs" / "online.md"
    prose = page.read_text(encoding="utf-8").partition(MEASURED)[0]
    page.write_text(prose + "\n".join(text), encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
