"""Accuracy, confidence and time of both priors for growing grids.

fast_contact is estimated with defaults for everything but the nodes. The separable prior is the
same process for any number of nodes, so it may need fewer. Times are processor seconds of this
process, covariances included, as ratios to the kinematic prior on 5 × 30 Hz, which hardly depend on
the machine.
Usage: nodes.py [FOLDER of public recordings] [--robots KINEMATIC SEPARABLE] [--runs N]
"""

import argparse
import os
import warnings
from dataclasses import replace
from itertools import product
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando import NotConvergedWarning, estimate, load_robot
from glissando.evaluation.metrics import errors_against, pool
from glissando.io.recording_folder import load_recording
from glissando.model.sensors.parameters import corrected

DATA = Path("../shared/data/spacetime")
RECORDING, WINDOW = "fast_contact", (10.0, 20.0)
ROBOTS = ("tdcr466", "tdcr466-segments")  # kinematic, separable
ARCLENGTH = (3, 5, 9)
RATES = (5.0, 10.0, 15.0, 20.0, 30.0)
REFERENCE = (5, 30.0)
MIDDLE = 0.233  # m, where the two segments meet: a node of all grids
CLAIM = 3.0  # largest time of the separable prior, over the kinematic prior's
AT_NODES = np.linspace(*WINDOW, 51)  # times that are nodes for every rate here
BETWEEN = np.linspace(*WINDOW, 241)


def on_nodes(robot, nodes, rate):
    """Robot on another grid; its joint must be a node."""
    arclength = np.linspace(0.0, robot.length, nodes)
    if np.abs(arclength - MIDDLE).min() > 1e-9:
        raise SystemExit(f"{nodes} nodes along the robot leave out its joint at {MIDDLE:g} m.")
    return replace(robot, arclength_nodes=arclength, time_rate=rate)


def solved(robot, recording):
    """Posterior of the window with the robot's settings."""
    use, _ = recording.choose(None, None)
    readings, _ = recording.readings(use, robot, WINDOW)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotConvergedWarning)
        return estimate(
            robot.prior, robot.grid(*WINDOW), readings, sensor_parameters=robot.sensor_parameters
        )


def judged(posterior, robot, known, recording):
    """Position RMSE (m), coverage, and rms position std (m) at mid-length, at nodes and between."""
    _, truth = recording.choose(None, None)
    judges, _ = recording.readings(truth, robot, WINDOW, as_truth=True)
    errors = pool([errors_against(posterior, corrected(t, known)) for t in judges]).summary()
    found = (posterior.at(MIDDLE, times).cov[:, :3, :3] for times in (AT_NODES, BETWEEN))
    stds = [np.sqrt(np.mean(np.trace(cov, axis1=1, axis2=2))) for cov in found]
    return errors["position_rmse"], errors["coverage95_position"], *stds


def row(robot, nodes, rate, numbers, solve, unit):
    """Row of the table, with times relative to `unit` (s)."""
    rmse, inside, at_nodes, between = numbers
    seconds = solve.seconds["total"]
    done = f"{solve.iterations}" + ("" if solve.converged else " (not converged)")
    return (
        f"| {robot.name} | {nodes} × {rate:g} Hz | {solve.unknowns:,} | {1e3 * rmse:.2f} | "
        f"{100 * inside:.0f} % | {1e3 * at_nodes:.2f} | {1e3 * between:.2f} | "
        f"{seconds / unit:.2f} | {done} | "
        f"{seconds / solve.iterations / unit:.3f} |"
    )


def compare(robots, recording, runs):
    """Solve reports on the reference grid, run in turns, and the median time of each robot."""
    found = [
        [solved(on_nodes(r, *REFERENCE), recording).solve for r in robots] for _ in range(runs)
    ]
    medians = np.median([[s.seconds["total"] for s in each] for each in found], axis=0)
    return found[0], medians


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=DATA, type=Path)
    parser.add_argument("--robots", nargs=2, default=ROBOTS, metavar=("KINEMATIC", "SEPARABLE"))
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    if not (options.folder / RECORDING).is_dir():
        print(f"Skipped: there is no public recording {RECORDING} in {options.folder}.")
        return
    recording = load_recording(options.folder / RECORDING)
    robots = [load_robot(name) for name in options.robots]
    known = robots[1].sensor_parameters  # of the truth, the same for both robots

    one, other = robots
    alike = replace(one, prior=other.prior)  # the same sensors, without unknown parameters
    solves, medians = compare((one, alike, other), recording, options.runs)
    unit, ratio = medians[0], medians[1] / medians[0]
    each = ratio * solves[0].iterations / solves[1].iterations
    print(
        f"{RECORDING}, {WINDOW[0]:g}-{WINDOW[1]:g} s, on {REFERENCE[0]} × {REFERENCE[1]:g} Hz; "
        f"medians of {options.runs} alternating runs:\n\n"
        f"- {one.name} takes {medians[0]:.2f} s ({solves[0].iterations} iterations).\n"
        f"- The same sensors with the prior of {other.name} take {medians[1]:.2f} s "
        f"({solves[1].iterations} iterations):\n  {ratio:.2f} times as long for an estimate, "
        f"{each:.2f} times for an iteration.\n  The estimate is "
        f"{'within' if ratio <= CLAIM else 'NOT within'} the target of {CLAIM:g} times.\n"
        f"- {other.name} itself, with an unknown parameter and a robust loss, takes "
        f"{medians[2] / medians[0]:.2f} times as long\n  ({solves[2].iterations} iterations).\n\n"
        f"Times in the table are multiples of the first of these times.\n"
    )
    heads = (
        "robot",
        "grid",
        "unknowns",
        "position (mm)",
        "inside 95 %",
        "std at mid-length, at nodes (mm)",
        "anywhere (mm)",
    )
    heads += ("time", "iterations", "time an iteration")
    print("|", " | ".join(heads), "|")
    print("|" + "---|" * len(heads))
    for robot, nodes, rate in product(robots, ARCLENGTH, RATES):
        posterior = solved(on_nodes(robot, nodes, rate), recording)
        numbers = judged(posterior, robot, known, recording)
        print(row(robot, nodes, rate, numbers, posterior.solve, unit), flush=True)


if __name__ == "__main__":
    main()
