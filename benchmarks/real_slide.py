"""A sliding coil emulated on real motion: is it worth sliding, and how fast.

Nobody recorded a sliding sensor. Five motion-capture bodies ride on the real robot: the one nearest
to a virtual place s*(t) is read as a coil (its roll made random), the others then are truth.
Nothing else is read; the prior holds the base. Arms are a coil fixed at the tip, one that swings
over the last quarter, and one that traverses the robot but its base, s* a cosine of some period.
A body sits on the robot with an unknown, constant offset, which every reading of it repeats: each
body read is a stream with a mount of its own, and truth is as uncertain. A hundred readings at one
place are worth one place.
All arms are compared on the same truth: samples of bodies that no arm of the period reads then.
That leaves out the tip, which the fixed coil always reads, and body 3 while the swinging coil reads
it, which is while the traversing one is far from it: it flatters the traverse. Each against the
fixed coil where neither reads is fairer, and own truth tells what sliding away from the tip costs.
A coil does not see roll; --twist scales the prior's variance of twist.
Usage: real_slide.py [FOLDER of public recordings] [--recording FOLDER] [--window T0 T1]
[--robot FILE] [--periods S …] [--twist FACTOR] [--json]
"""

import argparse
import os
import warnings
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from scipy.stats import chi2

from glissando import CoilReadings, NotConvergedWarning, SensorParameter, estimate, load_robot
from glissando.evaluation.metrics import Errors, errors_against, pool
from glissando.geometry import se3
from glissando.io.recording import load_recording
from glissando.model.sensors.parameters import corrected

DATA = Path("../shared/data/spacetime")
WINDOWS = [("slow_free_space", (19.0, 45.0)), ("fast_contact", (10.0, 30.0))]
BODIES = [f"vicon{i}" for i in range(5)]
STD = np.repeat([1e-3, np.radians(1.0)], 3)  # m, rad: motion capture, from one frame to the next
MOUNT_STD = np.repeat([2.5e-3, np.radians(1.0)], 3)  # m, rad: where a body sits on the robot
SWINGS = {"fixed": (0.466, 0.466), "oscillating": (0.3495, 0.466), "traverse": (0.1165, 0.466)}
PERIODS = (0.5, 1.0, 2.0, 4.0)
BLOCK = 2.0  # seconds of one block of the bootstrap
DRAWS = 2000
SEED = 7


@dataclass(frozen=True)
class Bodies:
    """Motion capture in a window, put right: a stream a body, and its rows by common time.

    `row` (B, K) is the row of a body at each of the times (K,), −1 where it was not seen.
    """

    streams: list
    time: np.ndarray
    row: np.ndarray

    @property
    def arclength(self):
        """Where the bodies sit (B,), metres."""
        return np.array([s.arclength[0] for s in self.streams])


def load_bodies(recording, robot, window):
    """The bodies with frames and mounts put right, their noise as stated here."""
    found, _ = recording.readings(BODIES, robot, window, as_truth=True)
    cov = STD**2 + MOUNT_STD**2
    streams = [replace(corrected(r, robot.sensor_parameters), cov=cov) for r in found]
    time = np.unique(np.concatenate([s.time for s in streams]))
    row = np.full((len(streams), time.size), -1)
    for body, stream in enumerate(streams):
        row[body, np.searchsorted(time, stream.time)] = np.arange(len(stream))
    return Bodies(streams, time, row)


def nearest(bodies, swing, period):
    """The body (K,) nearest to s*(t), which starts at the far end; −1 where it was not seen."""
    low, high = swing
    place = low + (high - low) * 0.5 * (1.0 + np.cos(2.0 * np.pi * bodies.time / period))
    body = np.argmin(np.abs(bodies.arclength[:, None] - place), axis=0)
    seen = bodies.row[body, np.arange(body.size)] >= 0
    return np.where(seen, body, -1)


def coils(bodies, read, rng):
    """Readings of the bodies `read` (K,) as a coil whose roll says nothing, a stream a body."""
    streams = []
    for body, stream in enumerate(bodies.streams):
        kept = np.flatnonzero(read == body)
        mine = stream.select(bodies.row[body, kept])
        roll = np.zeros((kept.size, 6))
        roll[:, 5] = rng.uniform(-np.pi, np.pi, kept.size)
        fields = {"time": mine.time, "arclength": mine.arclength, "mount": mine.mount}
        name = f"coil at {stream.label}"
        values = mine.values @ se3.exp(roll)
        streams.append(CoilReadings(**fields, values=values, cov=STD[:5] ** 2, name=name))
    return [r for r in streams if len(r)]


def mounts(readings):
    """The unknown constant offset of each body that is read; that of its roll does not show."""
    zero, std = np.zeros(6), MOUNT_STD * [1, 1, 1, 1, 1, 0]
    return [SensorParameter(f"mount of {r.name}", "mount", (r.name,), zero, std) for r in readings]


def twisting(robot, factor):
    """The robot whose prior's variances of twist are so many times what they were."""
    prior, scale = robot.prior, np.array([1, 1, 1, 1, 1, factor])
    return replace(
        robot,
        prior=replace(
            prior,
            psd_strain_arclength=prior.psd_strain_arclength * scale,
            jumps=prior.jumps * scale,
            base=replace(prior.base, strain=prior.base.strain * scale),
        ),
    )


@dataclass(frozen=True)
class Arm:
    """A trial: which body was read when, errors at every sample of every body, and the solve."""

    read: np.ndarray
    errors: list
    solve: object


def trial(bodies, robot, window, swing, period):
    """Estimate from the emulated coil, judge at all samples of all bodies."""
    read = nearest(bodies, swing, period)
    readings = coils(bodies, read, np.random.default_rng(SEED))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotConvergedWarning)
        posterior = estimate(
            robot.prior,
            robot.grid(*window),
            readings,
            sensor_parameters=mounts(readings),
        )
    return Arm(read, [errors_against(posterior, s) for s in bodies.streams], posterior.solve)


def unread(bodies, arms):
    """Samples (B, K) seen but read by none of these arms, but the base, which the prior holds."""
    truth = bodies.row >= 0
    truth[0] = False
    for arm in arms:
        truth &= np.arange(len(truth))[:, None] != arm.read
    return truth


def chosen(bodies, arm, truth):
    """Errors at the samples `truth` (B, K), and the time of each."""
    kept, times = [], []
    for body, errors in enumerate(arm.errors):
        rows = bodies.row[body, truth[body]]
        times.append(bodies.time[truth[body]])
        fields = {k: v[rows] if isinstance(v, np.ndarray) else v for k, v in vars(errors).items()}
        kept.append(Errors(**fields))
    return pool(kept), np.concatenate(times)


def relative_change(time, errors, against, rng):
    """RMSE over another's less one, and its 95 % interval from blocks of time drawn anew."""
    moments = np.unique(time)
    at = np.searchsorted(moments, time)
    sums = [np.bincount(at, e.position**2, moments.size) for e in (errors, against)]
    starts = np.flatnonzero(moments <= moments[-1] - BLOCK)
    ends = np.searchsorted(moments, moments[starts] + BLOCK)
    totals = [np.append(0.0, np.cumsum(s)) for s in sums]
    blocks = np.array([t[ends] - t[starts] for t in totals])
    count = max(1, round((moments[-1] - moments[0]) / BLOCK))
    drawn = blocks[:, rng.integers(0, starts.size, (DRAWS, count))].sum(axis=-1)
    found = np.sqrt(sums[0].sum() / sums[1].sum()) - 1.0
    return found, *np.quantile(np.sqrt(drawn[0] / drawn[1]) - 1.0, [0.025, 0.975])


def cells(errors):
    """The cells of a table that tell of pooled errors."""
    told = errors.summary()
    inside = 100 * np.mean(errors.nees_position <= chi2.ppf(0.95, 3))
    return (
        f"{errors.position.size} | {1e3 * told['position_rmse']:.1f} | "
        f"{np.degrees(told['rotation_rmse']):.1f} | {inside:.0f} % | {told['nees_position']:.2f} | "
        f"{told['nees_rotation']:.2f}"
    )


def table(bodies, robot, window, periods):
    """Yield lines of the table: a row an arm and period, on the same truth and on its own."""
    trials = cache(lambda arm, period: trial(bodies, robot, window, SWINGS[arm], period))
    head = "period (s) | arm | truth | samples | position (mm) | rotation (°) | inside 95 % |"
    yield f"| {head} NEES position | NEES rotation | against fixed, 95 % interval | solve |"
    yield "|" + "---|" * 11
    for period in periods:
        arms = {arm: trials(arm, np.inf if arm == "fixed" else period) for arm in SWINGS}
        same = unread(bodies, arms.values())
        for label, truth_of in (("same", lambda _, t=same: t), ("own", None)):
            for arm, found in arms.items():
                truth = truth_of(arm) if truth_of else unread(bodies, [found])
                errors, time = chosen(bodies, found, truth)
                change = ""
                if arm != "fixed":
                    rng = np.random.default_rng(SEED)
                    if label == "own":  # the fixed coil judged at the same samples, bar the tip
                        truth = truth & unread(bodies, [arms["fixed"]])
                    mine, time = chosen(bodies, found, truth)
                    fixed, _ = chosen(bodies, arms["fixed"], truth)
                    told = relative_change(time, mine, fixed, rng)
                    change = "{:+.0f} % ({:+.0f} to {:+.0f})".format(*(100 * t for t in told))
                solve = f"{found.solve.iterations} it."
                solve += "" if found.solve.converged else ", not converged"
                yield f"| {period:g} | {arm} | {label} | {cells(errors)} | {change} | {solve} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=DATA, type=Path)
    parser.add_argument("--robot", default="tdcr466-segments")
    parser.add_argument("--periods", nargs="+", type=float, default=PERIODS)
    parser.add_argument("--twist", default=1.0, type=float)
    options = parser.parse_args()
    if not options.folder.is_dir():
        print(f"Skipped: there are no public recordings in {options.folder}.")
        return
    robot = twisting(load_robot(options.robot), options.twist)
    scale = getattr(robot.prior, "time_scale", None)
    remembers = "" if scale is None else f", whose prior remembers a shape for {scale:.2g} s"
    print(
        f"Robot `{robot.name}`{remembers}; variance of twist × {options.twist:g}. A coil is read "
        f"with {1e3 * STD[0]:g} mm and {np.degrees(STD[3]):.2g}°, truth is as uncertain. *Same*: "
        f"bodies 1 to 4 where none of the three arms reads them; *own*: where the arm itself does "
        f"not; against fixed at the samples of both. Blocks of {BLOCK:g} s."
    )
    for name, window in WINDOWS:
        if not (options.folder / name).is_dir():
            print(f"\nSkipped: {name} is not in {options.folder}.")
            continue
        bodies = load_bodies(load_recording(options.folder / name), robot, window)
        print(f"\n{name}, {window[0]:g} to {window[1]:g} s\n")
        for line in table(bodies, robot, window, options.periods):
            print(line, flush=True)


if __name__ == "__main__":
    main()
