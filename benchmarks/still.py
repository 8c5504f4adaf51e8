"""Confidence of a still robot that a coil reads at its tip, and the cost of its estimate.

Shapes are drawn from the prior of a robot file with [base] and a separable prior, and held still;
`estimate` finds the motion, or `FixedLagSmoother` with --online, and says where others are
probable. The table has the position in the middle: share inside 95 %, NEES per degree of freedom (1
if consistent), and share far off; iterations are updates with --online.
Usage: still.py [--robot FILE] [--shapes N] [--seconds S] [--online]
"""

import argparse
import os
import time
import warnings

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from scipy.stats import chi2

from glissando import (
    CoilReadings,
    FalseConfidenceWarning,
    FixedLagSmoother,
    Grid,
    estimate,
    load_robot,
)
from glissando.evaluation.prior_predictive import PriorPredictive
from glissando.geometry import se3

RATE, STD = 40.0, np.repeat([1e-3, 1e-2], [3, 2])  # Hz; m and rad
FAR = 0.1  # m


def coil(robot, moments, values):
    """Readings of a coil at the tip."""
    at = np.full(moments.size, robot.length)
    return CoilReadings(time=moments, arclength=at, values=values, cov=STD**2, name="coil")


def batch(robot, tip, place, seconds):
    """The state halfway, whether it is doubtful, and the number of iterations."""
    found = estimate(robot.prior, robot.grid(0.0, seconds), [tip])
    doubtful = not found.solve.converged or bool(found.solve.doubt)
    return found.at(place, 0.5 * seconds), doubtful, found.solve.iterations


def online(robot, tip, place, seconds):
    """The last state of a smoother, whether it warned, and the number of updates."""
    smoother, before = FixedLagSmoother(robot.prior, robot.arclength_nodes), -1.0
    with warnings.catch_warnings(record=True, action="always") as caught:
        for now in np.arange(1.0, seconds * robot.time_rate) / robot.time_rate:
            smoother.add(tip.select((tip.time > before) & (tip.time <= now)))
            smoother.advance(now)
            before = now
    doubtful = any(issubclass(w.category, FalseConfidenceWarning) for w in caught)
    return smoother.at(place, smoother.time), doubtful, smoother.updates


def judged(robot, predictive, seed, seconds, find):
    """NEES and error (m) of the middle, whether others are named, iterations, processor time."""
    truth = predictive.draw(np.random.default_rng([1, seed])).truth
    moments = np.arange(0.0, seconds, 1.0 / RATE)
    noise = np.zeros((moments.size, 6))
    noise[:, :5] = STD * np.random.default_rng(seed).standard_normal((moments.size, 5))
    tip = coil(robot, moments, truth.pose[0, -1] @ se3.exp(noise))
    place = robot.arclength_nodes[robot.arclength_nodes.size // 2]
    began = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        at, named, steps = find(robot, tip, place, seconds)
    took = time.process_time() - began
    own = truth.pose[0, int(np.abs(predictive.fine.arclength - place).argmin()), :3, 3]
    miss = at.pose[:3, :3].T @ (own - at.position)
    square = miss @ np.linalg.solve(at.position_covariance(), miss)
    return square, float(np.linalg.norm(miss)), named, steps, took


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robot", default="tdcr466-segments")
    parser.add_argument("--shapes", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--online", action="store_true")
    options = parser.parse_args()
    robot = load_robot(options.robot)
    one = coil(robot, np.zeros(1), np.eye(4)[None])
    predictive = PriorPredictive(robot, Grid(robot.arclength_nodes, [0.0]), [one])
    find = online if options.online else batch
    rows = [judged(robot, predictive, k, options.seconds, find) for k in range(options.shapes)]
    squares, errors, named, iterations, took = map(np.array, zip(*rows, strict=True))
    print("| shapes | | inside 95 % | NEES | far off | iterations, median (most) | seconds |")
    print("|---|---|---|---|---|---|---|")
    groups = {"with a warning": named, "without": ~named, "all": np.ones(named.size, dtype=bool)}
    for group, rows in groups.items():
        if not rows.any():
            continue
        inside = 100.0 * np.mean(squares[rows] <= chi2.ppf(0.95, 3))
        far, nees = 100.0 * np.mean(errors[rows] > FAR), squares[rows].mean() / 3.0
        steps = f"{np.median(iterations[rows]):.0f} ({iterations[rows].max()})"
        print(
            f"| {group} | {rows.sum()} | {inside:.0f} % | {nees:.2g} | {far:.0f} % | {steps} | "
            f"{np.median(took[rows]):.2g} |"
        )


if __name__ == "__main__":
    main()
