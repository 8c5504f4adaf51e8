"""Write docs/results.md: every number of that page is measured here.

Usage: results.py [--data FOLDER]   (FOLDER holds the public space-time recordings)
"""

import argparse
import os
import platform
from dataclasses import replace
from datetime import date
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
import scipy

import sorosim
from estimate import peak_memory, scene, timed
from glissando import (
    BaseDensity,
    CoilReadings,
    Grid,
    PoseReadings,
    WhiteNoisePrior,
    estimate,
    load_robot,
)
from glissando.evaluation.run import run_estimate
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording

# Published position RMSE (mm) of the reference implementation, by site, and its CPU seconds for the
# batch (one thread of a 2.5 GHz Xeon core).
PUBLISHED = [
    ("slow_free_space", (19.0, 29.0), [None, 7.5, 13.8, 12.1, 5.4], 3.5),
    ("fast_contact", (10.0, 20.0), [None, 8.6, 12.8, 9.0, 6.1], 3.4),
    ("fast_contact", (20.0, 30.0), [None, 8.3, 16.1, 15.6, 7.9], 3.7),
    ("extensible", (0.0, 1.0), [None, 2.9, 3.3, 2.3], 13.4),
]


def runs(data):
    """Yield an estimate of each published window with all defaults."""
    for name, window, published, seconds in PUBLISHED:
        recording = load_recording(data / name)
        run = run_estimate(recording, recording.robot, window=window, use=None, truth=None)
        yield f"{name} {window[0]:g}-{window[1]:g} s", run, published, seconds


def accuracy(label, run, published, strict=True):
    """Lines of the accuracy table for one window, from the base to the tip."""
    lines = []
    for errors, theirs in zip(
        sorted(run.errors, key=lambda e: e.arclength[0]), published, strict=True
    ):
        found = errors.summary()
        lines.append(
            f"| {label} | {errors.arclength[0]:.4f} | {1e3 * found['position_rmse']:.1f} | "
            f"{'' if theirs is None else theirs} | {np.degrees(found['rotation_rmse']):.1f} | "
            f"{found['nees_position']:.2f} | {100 * found['coverage95_position']:.0f} % |"
        )
    return lines


def bent_rod_std(nodes):
    """Standard deviation of position (mm) at mid-length of a bent rod read once at its tip."""
    strain = np.array([0, 0, 1, 2, 0, 0.0])
    base = BaseDensity(
        np.full(6, 1e-14), np.array([8e-6, 8e-6, 8e-6, 14, 14, 1e-8]), np.full(6, 1e-6)
    )
    psd = np.array([5.1e-4, 5.1e-4, 5.1e-4, 4, 4, 0.45])
    prior = WhiteNoisePrior(psd, psd, psd, psd, base, rest_strain=strain)
    tip = CoilReadings(
        time=np.zeros(1),
        arclength=np.full(1, 0.7),
        values=se3.exp(0.7 * strain)[None],
        cov=np.array([7e-4] * 3 + [np.radians(0.4)] * 2) ** 2,
    )
    grid = Grid(np.linspace(0.0, 0.7, nodes), [0.0])
    return 1e3 * float(estimate(prior, grid, [tip]).at(0.35, 0.0).std_position)


def static_std(rate, duration=2.0, firm=False):
    """Lateral standard deviation (mm) at mid-length of a still robot read at base and tip."""
    robot = load_robot("tdcr466")
    prior = robot.prior
    if firm:
        prior = replace(
            prior,
            psd_strain_time=1e-6 * prior.psd_strain_time,
            psd_velocity_time=1e-6 * prior.psd_velocity_time,
        )
    count = round(rate * duration) + 1
    grid = Grid(robot.arclength_nodes, np.linspace(0.0, duration, count))
    time = np.linspace(0.0, duration, round(40 * duration) + 1)
    readings = []
    for place in (0.0, robot.length):
        pose = np.tile(np.eye(4), (time.size, 1, 1))
        pose[:, 2, 3] = place
        where = np.full(time.size, place)
        cov = [2e-5] * 3 + [2.5e-3] * 3
        readings.append(PoseReadings(time=time, arclength=where, values=pose, cov=cov))
    found = estimate(prior, grid, readings).at(robot.length / 2, duration / 2)
    return 1e3 * float(np.sqrt(found.cov[0, 0]))


def grid_lines():
    """Lines of the grid tables."""
    nodes = (5, 9, 17, 33, 65)
    bent = " | ".join(f"{bent_rod_std(n):.2f}" for n in nodes)
    still = " | ".join(f"{static_std(rate):.2f}" for rate in (15, 30, 60, 120))
    longer, firm = (
        " | ".join(f"{static_std(30, duration, firm):.2f}" for duration in (1, 2, 4, 8))
        for firm in (False, True)
    )
    return {"bent": f"| {bent} |", "still": f"| {still} |", "longer": longer, "firm": firm}


TEXT = """\
# Accuracy and speed

`benchmarks/results.py` measures every number on this page and writes it.

## Accuracy on the public recordings

The estimates use a tracker at base and tip and two gyroscopes. The settings are those published for
these robots, converted to densities; motion capture is the truth. The published column is the
position RMSE of the reference implementation's batch estimator. NEES is per degree of freedom (1
is ideal); the last column is the share of samples inside the 95 % position ellipsoid. With the
published settings the estimates are underconfident in slow motion, and overconfident at the tip in
the last window of fast contact, where tracker and motion capture differ by uncalibrated constants
of several millimetres.

| recording | site (m) | position RMSE (mm) | published (mm) | rotation RMSE (°) | NEES | inside 95 % |
|---|---|---|---|---|---|---|
{accuracy}

## Physics of the simulator

Another group's solver, SoroSim, computed 500 shapes of a 0.6 m steel rod under gravity and
wrenches at its middle and tip. The table gives their differences from the shapes of glissando's
simulator: the distance at the tip, and the largest angle anywhere. SoroSim represents strain by a
few modes in each of two segments, and its files have four decimals.

| median (mm) | 99 % (mm) | largest (mm) | largest angle (°) |
|---|---|---|---|
{physics}

## What the grid does to confidence

A rod of 0.70 m is bent to 2 rad/m, its base is known, and a coil of five degrees of freedom is read
once at the tip. The table gives the standard deviation of position (mm) at mid-length by the
number of nodes. White noise on independent components, the published form with second-order rows,
gives 16.12, 13.46, 12.87, 12.73, 12.69 on the same grids (computed with GTSAM's factors in
`tests/estimation/test_gtsam.py`).

| 5 nodes | 9 | 17 | 33 | 65 |
|---|---|---|---|---|
{bent}

A tracker reads base and tip of a still robot for 2 s. The table gives the lateral standard
deviation (mm) at mid-length by the number of time nodes per second; it hardly depends on them,
because more nodes do not repeat the prior.

| 15 nodes/s | 30 | 60 | 120 |
|---|---|---|---|
{still}

The next table gives the same standard deviation by the length of the recording in seconds, with the
published settings and with densities of strain and velocity in time that are 10⁶ times smaller.
With such small densities the prior pulls a still shape that is observed twice as long twice as
strongly to constant strain. This is a limit of the white-noise prior; with the wide published
settings it has no visible effect.

| | 1 s | 2 | 4 | 8 |
|---|---|---|---|---|
| published | {longer} |
| 10⁶ times smaller | {firm} |

## Speed

The table gives processor seconds on one thread, including covariances, for the first estimate of a
fresh process and as the median of five. The published column is the C++ reference on one core of a
2.5 GHz Xeon. `make bench` also prints larger grids.

| recording | unknowns | iterations | first (s) | median (s) | published (s) |
|---|---|---|---|---|---|
{speed}

The next table gives the time by the number of time nodes, with five arclength nodes, a sliding coil
and a gyroscope: seconds for all iterations, and microseconds per unknown and iteration.

| time nodes | iterations | total (s) | µs |
|---|---|---|---|
{growth}

Peak memory of the process that made this page: {memory:.0f} MB. {machine}
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/spacetime"))
    parser.add_argument("--page", type=Path, default=Path("docs/results.md"))
    options = parser.parse_args()
    accuracy_lines, speed_lines = [], []
    for label, run, published, seconds in runs(options.data):
        accuracy_lines += accuracy(label, run, published)
        first = run.posterior.solve
        again = [
            estimate(run.robot.prior, run.posterior.grid, run.readings).solve.seconds["total"]
            for _ in range(5)
        ]
        speed_lines.append(
            f"| {label} | {first.unknowns:,} | {first.iterations} | {first.seconds['total']:.2f} | "
            f"{np.median(again):.2f} | {seconds} |"
        )
    machine = (
        f"Measured {date.today():%Y-%m-%d} on {platform.machine()}, Python "
        f"{platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}."
    )
    growth = []
    for times in (151, 301, 601):
        solve, seconds = timed(*scene(5, times), 3)
        each = 1e6 * seconds["total"] / solve.unknowns / solve.iterations
        growth.append(f"| {times} | {solve.iterations} | {seconds['total']:.2f} | {each:.1f} |")
    machine += " Memory includes Python and its libraries."
    tables = {"accuracy": "\n".join(accuracy_lines), "speed": "\n".join(speed_lines)}
    options.page.write_text(
        TEXT.format(
            **tables,
            **grid_lines(),
            physics=sorosim.line(options.data.parent / "sorosim" / sorosim.FILE.name),
            growth="\n".join(growth),
            memory=peak_memory(),
            machine=machine,
        )
    )
    print(options.page.read_text())


if __name__ == "__main__":
    main()
