"""Gain of a sliding coil, emulated on motion of a real robot, by period of the slide.

There is no recording of a sliding sensor. The real robot carries motion-capture bodies, five in the
public recordings: the one nearest to a virtual place s*(t) is read as a coil with random roll, and
the others are truth. There are no other readings; the prior fixes the base. Arms are a coil fixed
at the tip, one that oscillates over the last quarter, and one that traverses the robot except its
base, with s* a cosine in time. Bodies are the recording's pose streams that are marked as truth.
A body has an unknown constant offset on the robot, common to all its readings: each body read is a
stream with its own mount, and truth has the same uncertainty. So many readings at one place inform
no more than that place.
All arms are compared on common truth: samples of bodies that no arm of the period reads then. These
exclude the tip, which the fixed coil always reads, and body 3 while the swinging coil reads it,
when the traversing coil is far from it: this favours the traverse. The comparison of each arm with
the fixed coil where neither reads is fairer, and own truth shows the cost of leaving the tip.
Usage: real_slide.py [FOLDER of public recordings] [--recording FOLDER] [--window T0 T1]
[--robot FILE] [--periods S …] [--json]
"""

import argparse
import json
import os
import warnings
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando import (
    CoilReadings,
    GlissandoError,
    NotConvergedWarning,
    SensorParameter,
    estimate,
    load_robot,
)
from glissando.evaluation.metrics import Errors, errors_against, pool
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording
from glissando.model.sensors.parameters import corrected
from script import run, say

DATA = Path("../shared/data/spacetime")
WINDOWS = [("slow_free_space", (19.0, 45.0)), ("fast_contact", (10.0, 30.0))]
STD = np.repeat([1e-3, np.radians(1.0)], 3)  # m, rad: white noise of motion capture
MOUNT_STD = np.repeat([1.5e-3, np.radians(1.0)], 3)  # m, rad: a body's mount on the robot
SWINGS = {"fixed": (1.0, 1.0), "oscillating": (0.75, 1.0), "traverse": (0.25, 1.0)}  # of length
BASE = 0.05  # of the length: bodies nearer than this to the base are fixed by the prior
PERIODS = (0.5, 1.0, 2.0, 4.0)
BLOCK = 2.0  # seconds of one block of the bootstrap
DRAWS = 2000
SEED = 7


@dataclass(frozen=True)
class Bodies:
    """Corrected motion capture in a window: a stream per body, and rows by common time.

    `row` (B, K) is the row of a body at each of the times (K,), −1 where it has no sample.
    """

    streams: list
    time: np.ndarray
    row: np.ndarray

    @property
    def arclength(self):
        """Arclengths of the bodies (B,), m."""
        return np.array([s.arclength[0] for s in self.streams])


def load_bodies(recording, robot, window):
    """Bodies in the order of arclength, with frames and mounts corrected and the noise set here."""
    names = [n for n, s in recording.streams.items() if s.truth and s.rows.kind == "pose"]
    found, _ = recording.readings(names, robot, window, as_truth=True)
    found = sorted((r for r in found if len(r)), key=lambda r: float(np.mean(r.arclength)))
    if len(found) < 3:
        raise GlissandoError(
            f"{recording.name}: {len(found)} of {len(names)} streams of poses that are marked as "
            f"truth were seen from {window[0]:g} to {window[1]:g} s; three are needed."
        )
    farthest = float(found[-1].arclength.max())
    if not 0.9 < farthest / robot.length < 1.01:
        raise GlissandoError(
            f"{recording.name}: the farthest body sits at {farthest:g} m and {robot.name} is "
            f"{robot.length:g} m long; give the --robot of this recording."
        )
    cov = STD**2 + MOUNT_STD**2
    streams = [replace(corrected(r, robot.sensor_parameters), cov=cov) for r in found]
    time = np.unique(np.concatenate([s.time for s in streams]))
    row = np.full((len(streams), time.size), -1)
    for body, stream in enumerate(streams):
        row[body, np.searchsorted(time, stream.time)] = np.arange(len(stream))
    return Bodies(streams, time, row)


def nearest(bodies, swing, period):
    """Index (K,) of the body nearest to s*(t), for limits `swing` in m; −1 without a sample."""
    low, high = swing
    place = low + (high - low) * 0.5 * (1.0 + np.cos(2.0 * np.pi * bodies.time / period))
    body = np.argmin(np.abs(bodies.arclength[:, None] - place), axis=0)
    seen = bodies.row[body, np.arange(body.size)] >= 0
    return np.where(seen, body, -1)


def coils(bodies, read, rng):
    """Readings of the bodies `read` (K,) as coils with random roll, a stream per body."""
    streams = []
    for body, stream in enumerate(bodies.streams):
        kept = np.flatnonzero(read == body)
        own = stream.select(bodies.row[body, kept])
        roll = np.zeros((kept.size, 6))
        roll[:, 5] = rng.uniform(-np.pi, np.pi, kept.size)
        fields = {"time": own.time, "arclength": own.arclength, "mount": own.mount}
        name = f"coil at {stream.label}"
        values = own.values @ se3.exp(roll)
        streams.append(CoilReadings(**fields, values=values, cov=STD[:5] ** 2, name=name))
    return [r for r in streams if len(r)]


def mounts(readings):
    """Unknown mount of each body that is read, with roll fixed, as it is unobservable."""
    zero, std = np.zeros(6), MOUNT_STD * [1, 1, 1, 1, 1, 0]
    return [SensorParameter(f"mount of {r.name}", "mount", (r.name,), zero, std) for r in readings]


@dataclass(frozen=True)
class Arm:
    """Trial of an arm: body read at each time, errors at all samples of all bodies, the solve."""

    read: np.ndarray
    errors: list
    solve: object


def trial(bodies, robot, window, swing, period):
    """Estimate from the emulated coil, with errors at all samples of all bodies."""
    read = nearest(bodies, swing, period)
    readings = coils(bodies, read, np.random.default_rng(SEED))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotConvergedWarning)
        posterior = estimate(
            robot.prior, robot.grid(*window), readings, sensor_parameters=mounts(readings)
        )
    return Arm(read, [errors_against(posterior, s) for s in bodies.streams], posterior.solve)


def unread(bodies, arms):
    """Mask (B, K) of samples that no arm reads, without the base, which the prior fixes."""
    truth = bodies.row >= 0
    truth[bodies.arclength < BASE * bodies.arclength.max()] = False
    for arm in arms:
        truth &= np.arange(len(truth))[:, None] != arm.read
    return truth


def chosen(bodies, arm, truth):
    """Errors at the samples of the mask `truth` (B, K), and their times."""
    kept, times = [], []
    for body, errors in enumerate(arm.errors):
        rows = bodies.row[body, truth[body]]
        times.append(bodies.time[truth[body]])
        fields = {k: v[rows] if isinstance(v, np.ndarray) else v for k, v in vars(errors).items()}
        kept.append(Errors(**fields))
    return pool(kept), np.concatenate(times)


def relative_change(time, errors, against, rng):
    """Relative change of the RMSE against another, and its 95 % interval by block bootstrap.

    The interval is None for fewer than two blocks.
    """
    moments = np.unique(time)
    at = np.searchsorted(moments, time)
    sums = [np.bincount(at, e.position**2, moments.size) for e in (errors, against)]
    if np.ptp(moments) < 2.0 * BLOCK:
        return float(np.sqrt(sums[0].sum() / sums[1].sum()) - 1.0), None, None
    starts = np.flatnonzero(moments <= moments[-1] - BLOCK)
    ends = np.searchsorted(moments, moments[starts] + BLOCK)
    totals = [np.append(0.0, np.cumsum(s)) for s in sums]
    blocks = np.array([t[ends] - t[starts] for t in totals])
    count = max(1, round((moments[-1] - moments[0]) / BLOCK))
    drawn = blocks[:, rng.integers(0, starts.size, (DRAWS, count))].sum(axis=-1)
    found = np.sqrt(sums[0].sum() / sums[1].sum()) - 1.0
    return found, *np.quantile(np.sqrt(drawn[0] / drawn[1]) - 1.0, [0.025, 0.975])


def rows(bodies, robot, window, periods):
    """Yield a dictionary per arm, period and kind of truth: common to all arms, or its own."""

    def estimated(arm, period):
        say(f"{arm}, a period of {period:g} s")
        swing = [share * robot.length for share in SWINGS[arm]]
        return trial(bodies, robot, window, swing, period)

    trials = cache(estimated)
    for period in periods:
        arms = {arm: trials(arm, np.inf if arm == "fixed" else period) for arm in SWINGS}
        same = unread(bodies, arms.values())
        for label in ("same", "own"):
            for arm, found in arms.items():
                truth = same if label == "same" else unread(bodies, [found])
                yield {
                    "period": period, "arm": arm, "truth": label,
                    **summary(chosen(bodies, found, truth)[0]),
                    "against_fixed": against_fixed(bodies, arms, arm, truth),
                    "converged": found.solve.converged, "iterations": found.solve.iterations,
                }  # fmt: skip


def against_fixed(bodies, arms, arm, truth):
    """Relative change of an arm's RMSE against the fixed coil, where neither reads."""
    if arm == "fixed":
        return None
    truth = truth & unread(bodies, [arms["fixed"]])
    (own, time), (fixed, _) = (chosen(bodies, arms[name], truth) for name in (arm, "fixed"))
    return relative_change(time, own, fixed, np.random.default_rng(SEED))


def summary(errors):
    """Summary of pooled errors: RMSE (m, rad), coverage and NEES."""
    pooled = errors.summary()
    return {
        "samples": int(errors.position.size),
        "position_rmse": pooled["position_rmse"],
        "rotation_rmse": pooled["rotation_rmse"],
        "inside_95": pooled["coverage95_position"],
        "nees_position": pooled["nees_position"],
        "nees_rotation": pooled["nees_rotation"],
    }


HEAD = """\
| period (s) | arm | truth | samples | position (mm) | rotation (°) | inside 95 % | \
NEES position | NEES rotation | against fixed, 95 % interval | solve |
|---|---|---|---|---|---|---|---|---|---|---|"""


def line(row):
    """Row of the table."""
    change = row["against_fixed"]
    if change:
        percent = [f"{100 * c:+.0f}" for c in change if c is not None]
        change = f"{percent[0]} %" + (" ({} to {})".format(*percent[1:]) if percent[1:] else "")
    solve = f"{row['iterations']} it." + ("" if row["converged"] else ", not converged")
    return (
        f"| {row['period']:g} | {row['arm']} | {row['truth']} | {row['samples']} | "
        f"{1e3 * row['position_rmse']:.1f} | {np.degrees(row['rotation_rmse']):.1f} | "
        f"{100 * row['inside_95']:.0f} % | {row['nees_position']:.2f} | "
        f"{row['nees_rotation']:.2f} | {change or ''} | {solve} |"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=DATA, type=Path, help="of the recordings")
    parser.add_argument("--recording", type=Path, metavar="FOLDER", help="this recording alone")
    window = "seconds to estimate (default: all)"
    parser.add_argument("--window", nargs=2, type=float, metavar=("T0", "T1"), help=window)
    robots = "its robot file (default: tdcr466-segments)"
    parser.add_argument("--robot", default="tdcr466-segments", metavar="FILE|NAME", help=robots)
    periods = "periods of the slide, s (default: 0.5 1 2 4)"
    parser.add_argument("--periods", nargs="+", type=float, default=PERIODS, metavar="S",
                        help=periods)  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    if options.window and not options.recording:
        parser.error("--window is of a recording; name it with --recording")
    if min(options.periods) <= 0.0:
        parser.error("--periods are seconds above zero")
    cases = [(options.folder / name, window) for name, window in WINDOWS]
    if options.recording:
        window = options.window or load_recording(options.recording).span()
        cases = [(options.recording, tuple(window))]
    cases = [(folder, window) for folder, window in cases if folder.is_dir()]
    if not cases:
        raise GlissandoError(f"{options.folder} holds no public recordings; give --recording.")
    robot, found = load_robot(options.robot), []
    if not options.json:
        print(TEXT.format(robot=robot.name, mm=1e3 * STD[0], deg=np.degrees(STD[3]),
                          mount=1e3 * MOUNT_STD[0], block=BLOCK))  # fmt: skip
    for folder, window in cases:
        bodies = load_bodies(load_recording(folder), robot, window)
        if not options.json:
            print(f"\n{folder.name}, {window[0]:g} to {window[1]:g} s\n\n{HEAD}")
        for row in rows(bodies, robot, window, options.periods):
            found.append({"recording": folder.name, "window": window, **row})
            if not options.json:
                print(line(row), flush=True)
    if options.json:
        print(json.dumps({"robot": robot.name, "rows": found}))


TEXT = """\
The robot is `{robot}`. The coil's noise is {mm:g} mm and {deg:.2g}°; the mount of each body is
known to {mount:g} mm and {deg:.2g}°, for truth and for the coil. *Same* counts the bodies except
the base's, at times when none of the three arms reads them; *own*, at times when the arm itself
does not. The column against fixed uses the samples of both arms; its interval is from resampling
blocks of {block:g} s."""


if __name__ == "__main__":
    run(main)
