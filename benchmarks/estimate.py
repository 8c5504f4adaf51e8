"""Time of an estimate by part (linearise, solve, covariance) for growing grids; one thread.

Times are processor seconds, medians of a few runs in one process, and ratios to the first row,
which hardly depend on the machine. A sliding coil, the base and a gyroscope are read, with the
published settings of the real robot. Public recordings are included if found.
Usage: estimate.py [--runs N] [FOLDER of public recordings]
"""

import argparse
import os
import resource
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from rich.console import Console
from rich.table import Table

from glissando import CoilReadings, Grid, GyroReadings, PoseReadings, estimate, load_robot
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording

SIZES = [(5, 76), (5, 151), (5, 301), (5, 601), (10, 201), (10, 401), (19, 31)]
PHASES = ("linearise", "solve", "covariance", "total")
RECORDINGS = [
    ("slow_free_space", (19.0, 29.0)),
    ("fast_contact", (10.0, 20.0)),
    ("fast_contact", (20.0, 30.0)),
    ("extensible", (0.0, 1.0)),
]


def arc(arclength, time):
    bend, zero = 2.0 + np.sin(time), np.zeros_like(time)
    strain = np.stack([zero, zero, zero + 1, bend, 0.5 * bend, zero], -1)
    return se3.exp(arclength[:, None] * strain)


def scene(nodes, times):
    robot = load_robot("tdcr466")
    duration = (times - 1) / robot.time_rate
    grid = Grid(np.linspace(0, robot.length, nodes), np.linspace(0, duration, times))
    time = np.arange(0.0, duration, 1 / 40)
    place = robot.length - 0.06 * np.abs(np.sin(time))
    gyro = np.zeros((time.size, 3))
    readings = [
        CoilReadings(time=time, arclength=place, values=arc(place, time), cov=1e-5),
        PoseReadings(time=time, arclength=0 * time, values=arc(0 * time, time), cov=1e-5),
        GyroReadings(time=time, arclength=0 * time, values=gyro, cov=1e-4),
    ]
    return robot.prior, grid, readings


def timed(prior, grid, readings, runs):
    solves = [estimate(prior, grid, readings).solve for _ in range(runs)]
    seconds = {phase: float(np.median([s.seconds[phase] for s in solves])) for phase in PHASES}
    return solves[0], seconds


def peak_memory():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default="../shared/data/spacetime", type=Path)
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    console = Console(width=110)
    table = Table("arclength × time", title="Estimate, covariances in, one thread")
    for heading in ("unknowns", "iterations", *(f"{p} (s)" for p in PHASES), "µs / unknown / it."):
        table.add_column(heading, justify="right")

    def row(label, solve, seconds):
        each = 1e6 * seconds["total"] / solve.unknowns / solve.iterations
        cells = [f"{seconds[p]:.3f}" for p in PHASES]
        table.add_row(label, f"{solve.unknowns:,}", str(solve.iterations), *cells, f"{each:.1f}")

    for nodes, times in SIZES:
        row(f"{nodes} × {times}", *timed(*scene(nodes, times), options.runs))
    table.add_section()
    for name, window in RECORDINGS:
        if (options.folder / name).is_dir():
            recording = load_recording(options.folder / name)
            use, _ = recording.choose(None, None)
            readings, _ = recording.readings(use, recording.robot, window)
            grid = recording.robot.grid(*window)
            solve, seconds = timed(recording.robot.prior, grid, readings, options.runs)
            row(f"{name} {window[0]:g}-{window[1]:g} s", solve, seconds)
    console.print(table)
    console.print(f"Peak memory of this process: {peak_memory():.0f} MB")


if __name__ == "__main__":
    main()
