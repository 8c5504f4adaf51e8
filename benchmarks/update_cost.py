"""Processor time of an online update with each prior, on the same nodes and readings.

Also the time of a scan for contacts after an update, without and with a contact.

A simulated rod of the shipped robot's length is swayed by a force at its tip while a coil slides
along it, and in the second half of the time pushed from the side. The priors' smoothers take
turns, update by update, so that other load affects all equally. With a recording, its readings and
its robot, or the robot of a file, are used instead; each update's time is the least of several
runs.
Usage: update_cost.py [--nodes N ...] [--window K] [--updates U] [--seed S] [--json]
       update_cost.py --recording FOLDER --between A B [--robot FILE] [--nodes N ...] [--window K]
"""

import argparse
import json
import os
import time
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando import BaseVariance, CoilReadings, FixedLagSmoother, SeparablePrior, load_robot
from glissando.evaluation.run import chosen_streams
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording
from glissando.io.shipped_robots import robot_file
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Loads, Wrench, load_bench
from glissando.simulation.motion import solve_motion

RATE, COIL_RATE = 10.0, 40.0  # Hz, of time nodes and of readings
FORCE, MOMENT = 0.1, 0.01  # N and N m: standard deviations of the unknown wrench at the tip
TOUCH, AT = 0.5, 0.5  # N: lateral contact force; its place as a fraction of the length
NOISE = np.repeat([0.7e-3, np.radians(0.4)], [3, 2])
WEIGHT = [0.0, 0.0, -9.81]  # m/s²
WARM = 10  # warm-up updates, not timed
RUNS = 4  # runs through a recording


def readings(rod, count, seed):
    """Readings of a coil that oscillates along the swaying rod, for `count` updates."""
    rng = np.random.default_rng(seed)
    phase, lasts = rng.uniform(0.0, 2.0 * np.pi, 3), (count + 1) / RATE
    knots = np.arange(0.0, lasts + 0.25, 0.25)

    def loads(now):
        force = FORCE * np.sin(2.0 * np.pi * now / np.array([5.0, 7.0, 9.0]) + phase)
        touch = np.array([TOUCH * (2.0 * now > lasts), 0.0, 0.0])
        wrenches = [Wrench(rod.length, force), Wrench(AT * rod.length, touch)]
        return Loads(gravity=WEIGHT, wrenches=wrenches)

    motion = solve_motion(rod, [], loads, knots, knots[[0, -1]])
    at = np.arange(0.0, lasts, 1.0 / COIL_RATE)
    place = rod.length * (0.55 + 0.45 * np.cos(2.0 * np.pi * at / 4.0))
    off = np.zeros((at.size, 6))
    off[:, :5] = NOISE * rng.standard_normal((at.size, 5))
    values = motion.at(place, at).pose @ se3.exp(off)
    return CoilReadings(time=at, arclength=place, values=values, cov=NOISE**2, name="coil")


def priors(rod):
    """Mechanical prior, separable prior with a similar variance of strain, and the robot's own."""
    stiff = rod.stiffness
    tip = np.repeat([FORCE**2, MOMENT**2], 3)
    var = (tip[3:] + (0.5 * rod.length) ** 2 * tip[:3]) / stiff[3:] ** 2
    mechanics = Mechanics(stiff[None], np.array([rod.mass_per_length]), gravity=np.array(WEIGHT))
    base = np.full(6, 1e-10)
    mechanical = MechanicalPrior(
        mechanics, np.repeat([1e-3, 1e-7], 3), np.repeat([1e-6, 1e-2], 3), tip, 2.0, base,
        base_pose=rod.base,
    )  # fmt: skip
    spread = np.concatenate([np.full(3, 1e-6), var])
    separable = SeparablePrior(
        spread / rod.length, 2.0, BaseVariance(base, spread), base_pose=rod.base
    )
    return {
        "mechanical": mechanical,
        "separable": separable,
        "white": load_robot("sliding700").prior,
    }


def measured(nodes, window, updates, seed):
    """Median processor seconds of an update by prior, with smoothers in turn."""
    rod = load_bench(robot_file("sliding700")).rod
    coil = readings(rod, updates, seed)
    places = np.linspace(0.0, rod.length, nodes)
    every = {name: FixedLagSmoother(p, places, window=window) for name, p in priors(rod).items()}
    taken = {name: [] for name in (*every, "contacts", "touched")}
    for k in range(updates):
        now = k / RATE
        new = coil.select((coil.time > now - 1.0 / RATE) & (coil.time <= now))
        for name, smoother in every.items():
            began = time.process_time()
            smoother.add(new)
            smoother.advance(now)
            taken[name].append(time.process_time() - began)
        began = time.process_time()
        touched = every["mechanical"].contacts().detected.any()
        taken["touched" if touched else "contacts"].append(time.process_time() - began)
    out = {name: float(np.median(seconds[WARM:] or [np.nan])) for name, seconds in taken.items()}
    out["dropped"] = sum(sum(each.values()) for s in every.values() for each in s.dropped.values())
    return {"nodes": nodes, "window": window, **out, "ratio": out["mechanical"] / out["separable"]}


def recorded(folder, between, robot, nodes, window):
    """Median and 99 % quantile of processor seconds of updates in a window of a recording."""
    recording = load_recording(folder)
    robot = load_robot(robot) if robot else recording.robot
    places = np.linspace(0.0, robot.length, nodes)
    places = np.union1d(places, getattr(robot.prior, "joints", ()))  # joints must be nodes
    streams = chosen_streams(recording, robot, between, None, None)[0]
    count = max(2, round((between[1] - between[0]) * robot.time_rate) + 1)
    times, taken = np.linspace(*between, count), []
    for _ in range(RUNS):
        smoother = FixedLagSmoother(
            robot.prior, places, window=window, sensor_parameters=robot.sensor_parameters
        )
        since, seconds = -np.inf, []
        for now in times:
            new = [r.select((r.time > since) & (r.time <= now)) for r in streams]
            began = time.process_time()
            for readings in new:
                if len(readings):
                    smoother.add(readings)
            smoother.advance(now)
            seconds.append(time.process_time() - began)
            since = now
        taken.append(seconds)
    median, slow = np.percentile(np.min(taken, axis=0)[WARM:], [50.0, 99.0]).tolist()
    return {"nodes": nodes, "window": window, "median": median, "p99": slow}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--nodes", type=int, nargs="+", default=[5, 10, 15], help="of arclength")
    parser.add_argument("--window", type=int, default=4, help="time nodes")
    parser.add_argument("--updates", type=int, default=150, help="of each smoother")
    parser.add_argument("--seed", type=int, default=0, help="of motion and noise")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--recording", type=Path, help="folder of a recording to take instead")
    parser.add_argument("--between", type=float, nargs=2, help="seconds of it")
    parser.add_argument("--robot", help="robot file to take instead of the recording's")
    options = parser.parse_args()
    if options.recording is not None:
        given = options.recording, options.between, options.robot
        for row in [recorded(*given, n, options.window) for n in options.nodes]:
            if options.json:
                print(json.dumps(row))
                continue
            size = f"{row['nodes']:3d} nodes × {row['window']}"
            print(f"{size}: median {1e3 * row['median']:.2f} ms, 99 % {1e3 * row['p99']:.2f} ms")
        return
    rows = [measured(n, options.window, options.updates, options.seed) for n in options.nodes]
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        taken = (
            f"{name} {1e3 * row[name]:.2f} ms"
            for name in ("mechanical", "separable", "white", "contacts", "touched")
        )
        size = f"{row['nodes']:3d} nodes × {row['window']}"
        print(f"{size}: {', '.join(taken)}; mechanical over separable {row['ratio']:.2f}")


if __name__ == "__main__":
    main()
