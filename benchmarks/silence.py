"""Consistency of the newest state's covariance before, during and after a pause of readings.

For every robot, a fixed-lag smoother reads a coil at the tip of a random, still arc for a second;
then there are no readings for the pause; then it reads a coil at the tip of another random arc,
because after a long pause the robot may be anywhere. The table has the NEES of the tip's position
at the last update before the pause, at its end before any reading, at the first update with a
reading, and at the fifth. A still robot has smaller errors than a prior for moving ones predicts,
so NEES is tested against the upper bound only; `tests/estimation/test_reading_pause.py` draws
motions from the prior itself, for which NEES is inside both bounds.

Usage: silence.py [--robots NAME …] [--pauses SECONDS …] [--sessions N] [--first-seed N] [--json]
"""

import argparse
import json
import os
from copy import deepcopy

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from scipy.stats import chi2

from glissando import CoilReadings, FixedLagSmoother, load_robot
from glissando.geometry import se3
from glissando.io.shipped_robots import shipped_robots

STEP, UPDATES = 1.0 / 30.0, 30
COV = np.repeat([1e-6, 1e-4], [3, 2])
WHEN = ("before", "during", "first", "fifth")


def arc(rng, length):
    """Pose (4, 4) of the tip of a random arc of a length."""
    bend, plane = rng.uniform(0.2, 1.5), rng.uniform(-np.pi, np.pi)
    return se3.exp(np.array([0, 0, length, bend * np.cos(plane), bend * np.sin(plane), 0]))


def squared(newest, tip):
    """NEES of the tip's position."""
    error = newest.pose[-1, :3, :3].T @ (tip[:3, 3] - newest.position[-1])
    return float(error @ np.linalg.solve(newest.cov[-1, :3, :3], error))


def updated(smoother, rng, tip, time):
    """Newest state after a reading of the tip."""
    wobble = np.append(np.sqrt(COV) * rng.standard_normal(5), rng.uniform(-np.pi, np.pi))
    measured = (
        tip @ se3.exp(np.append(wobble[:5], 0.0)) @ se3.exp(np.append(np.zeros(5), wobble[5]))
    )
    place = np.full(1, smoother.arclength[-1])
    smoother.add(
        CoilReadings(
            time=np.full(1, time), arclength=place, values=measured[None], cov=COV, name="tip"
        )
    )
    return smoother.advance(time)


def judge(robot, sessions, pauses, first_seed):
    """NEES per degree of freedom (pauses, 4) of a robot, and the number of refused readings."""
    found, refused = np.zeros((sessions, len(pauses), len(WHEN))), 0
    for i in range(sessions):
        rng = np.random.default_rng([first_seed, i])
        tip, smoother = arc(rng, robot.length), FixedLagSmoother(robot.prior, robot.arclength_nodes)
        for k in range(UPDATES):
            newest = updated(smoother, rng, tip, k * STEP)
        found[i, :, 0] = squared(newest, tip)
        for j, pause in enumerate(pauses):
            after, start = deepcopy(smoother), smoother.time + pause
            other = arc(rng, robot.length)
            found[i, j, 1] = squared(after.advance(start), other)
            for k in range(1, 6):
                newest = updated(after, rng, other, start + k * STEP)
                if k in (1, 5):
                    found[i, j, 2 + (k == 5)] = squared(newest, other)
            refused += sum(sum(count.values()) for count in after.dropped.values())
    return found.mean(axis=0) / 3.0, refused


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", default=shipped_robots())
    parser.add_argument("--pauses", nargs="+", type=float, default=[10.0, 100.0, 1e3, 1e4])
    parser.add_argument("--sessions", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=500)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    high = chi2.ppf(0.999, 3 * options.sessions) / (3 * options.sessions)
    rows = []
    if not options.json:
        print(f"NEES of {options.sessions} sessions; 99.9 % of true ones are below {high:.2f}.\n")
        print("| robot | prior | pause (s) | " + " | ".join(WHEN) + " | refused |")
        print("|" + "---|" * (4 + len(WHEN)))
    for name in options.robots:
        robot = load_robot(name)
        nees, refused = judge(robot, options.sessions, options.pauses, options.first_seed)
        for pause, values in zip(options.pauses, nees, strict=True):
            row = dict(zip(WHEN, values.tolist(), strict=True))
            rows.append({"robot": name, "pause": pause, **row, "refused": refused})
            if not options.json:
                shown = " | ".join(f"{value:.2f}" for value in values)
                print(f"| {name} | {robot.prior.kind} | {pause:g} | {shown} | {refused} |",
                      flush=True)  # fmt: skip
    if options.json:
        print(json.dumps({"high": high, "rows": rows}))


if __name__ == "__main__":
    main()
