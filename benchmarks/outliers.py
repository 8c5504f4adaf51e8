"""Robustness to gross errors of a tracker: accuracy with 5 % outliers, by robust loss.

Rows of both trackers of fast_contact are moved 10 cm in a random direction and rotated 45° about a
random axis. Estimates without a loss, with Geman-McClure's and with Huber's at some thresholds, on
the original rows and with outliers by some seeds; errors are against motion capture, corrected by
the robot file's known sensor parameters.
Usage: outliers.py [FOLDER of public recordings] [--robot NAME] [--seeds N]
"""

import argparse
import os
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando import NotConvergedWarning, estimate, load_robot
from glissando.errors import GlissandoError
from glissando.evaluation.metrics import errors_against, pool
from glissando.evaluation.run import chosen_streams
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording
from glissando.model.noise import GemanMcClure, Huber

DATA = Path("../shared/data/spacetime")
RECORDING = "fast_contact"
WINDOWS = [(10.0, 20.0), (20.0, 30.0)]
TRACKERS = ("aurora0", "aurora1")
SHARE, MISS, TURN = 0.05, 0.10, np.pi / 4  # of rows; m; rad
LOSSES = {  # the whitened residual of an inlier with six components has a norm of about √6
    "none": None,
    "Geman-McClure, 4": GemanMcClure(4.0),
    "Geman-McClure, 8": GemanMcClure(8.0),
    "Huber, 3": Huber(3.0),
}


@dataclass(frozen=True)
class Outcome:
    """Result of one estimate; `rmse` in metres, NaN if the estimate failed."""

    rmse: float
    suspects: int
    iterations: int
    status: str


def directions(rng, count):
    """Uniformly distributed unit vectors (count, 3)."""
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def ruined(readings, rng):
    """Readings with a share of outliers, and their number."""
    rows = rng.choice(len(readings), round(SHARE * len(readings)), replace=False)
    values = readings.values.copy()
    turn = np.zeros((rows.size, 6))
    turn[:, 3:] = TURN * directions(rng, rows.size)
    values[rows] = values[rows] @ se3.exp(turn)
    values[rows, :3, 3] += MISS * directions(rng, rows.size)
    return replace(readings, values=values), rows.size


def spoiled(readings, seed):
    """All streams with outliers in the trackers, and their number; no outliers if seed is None."""
    if seed is None:
        return readings, 0
    rng, out, count = np.random.default_rng(seed), [], 0
    for r in readings:
        wrong = 0
        if r.name in TRACKERS:
            r, wrong = ruined(r, rng)
        out, count = [*out, r], count + wrong
    return out, count


def outcome(robot, window, readings, truth, loss):
    """Estimate with a robust loss on the trackers, and evaluate the result."""
    readings = [replace(r, loss=loss) if r.name in TRACKERS else r for r in readings]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotConvergedWarning)
            posterior = estimate(
                robot.prior,
                robot.grid(*window),
                readings,
                sensor_parameters=robot.sensor_parameters,
            )
    except (GlissandoError, np.linalg.LinAlgError) as problem:
        return Outcome(np.nan, 0, 0, f"{type(problem).__name__}: {problem}")
    rmse = pool([errors_against(posterior, t) for t in truth]).summary()["position_rmse"]
    solve = posterior.solve
    return Outcome(rmse, solve.suspects, solve.iterations, solve.status)


def span(values, form="{:g}"):
    """Range of some numbers as text."""
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low} to {high}"


def rows(recording, robot, window, seeds):
    """Yield a line of the table per loss: means over seeds, with the worst."""
    readings, truth, _ = chosen_streams(recording, robot, window, None, None)
    trackers = sum(len(r) for r in readings if r.name in TRACKERS)
    bare = None
    for label, loss in LOSSES.items():
        clean = outcome(robot, window, readings, truth, loss)
        bare = clean.rmse if bare is None else bare
        found, counts = [], []
        for seed in range(seeds):
            bad, count = spoiled(readings, seed)
            found.append(outcome(robot, window, bad, truth, loss))
            counts.append(count)
        errors = np.array([f.rmse for f in found])
        done = [f.status for f in [clean, *found]].count("converged")
        suspects = "" if loss is None else f"{clean.suspects} → {span([f.suspects for f in found])}"
        yield (
            f"| {window[0]:g}-{window[1]:g} s | {label} | {1e3 * clean.rmse:.2f} | "
            f"{1e3 * errors.mean():.2f} ({1e3 * errors.max():.2f}) | "
            f"{100 * (errors.mean() / clean.rmse - 1):+.1f} % "
            f"({100 * (errors.max() / clean.rmse - 1):+.1f} %) | "
            f"{100 * (errors.mean() / bare - 1):+.1f} % | {suspects} | "
            f"{span(counts)} of {trackers} | "
            f"{clean.iterations} → {span([f.iterations for f in found])} | {done}/{1 + seeds} |"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=DATA, type=Path)
    parser.add_argument("--robot", default="tdcr466-segments")
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    if not (options.folder / RECORDING).is_dir():
        print(f"Skipped: there is no public recording {RECORDING} in {options.folder}.")
        return
    robot = load_robot(options.robot)
    recording = load_recording(options.folder / RECORDING)
    print(
        f"Robot `{robot.name}`, {RECORDING}, {options.seeds} seeds: mean (worst) of the position "
        f"RMSE over all\nsites, with a share of the trackers' rows corrupted. Growth is relative "
        f"to the clean rows with the\nsame loss, and with no loss. Without a loss, the innovation "
        f"gate of every estimate omits outliers if\nthe iteration converges, and a warning says "
        f"if it does not. Huber's loss bounds the influence of an\noutlier but keeps it.\n"
    )
    heads = ("window", "loss", "clean (mm)", "corrupted (mm)", "growth", "of no loss, clean")
    heads += ("suspects clean → corrupted", "corrupted rows", "iterations", "converged")
    print("|", " | ".join(heads), "|")
    print("|" + "---|" * len(heads))
    for window in WINDOWS:
        for line in rows(recording, robot, window, options.seeds):
            print(line, flush=True)


if __name__ == "__main__":
    main()
