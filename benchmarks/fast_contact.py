"""A real robot that is hit while moving, under a mechanical prior with and without inertia.

The recording is the public `fast_contact` of a tendon-driven robot of 0.466 m: trackers at base and
tip and two gyroscopes, evaluated by motion capture at five places. Unpublished properties of its
body are assumed: a nitinol rod of 1.6 mm, 50 g/m with its disks, and loads that bend it by its own
length (three times those that bend it by a third), which represent its tendons. Both priors have
the same nodes. Nothing is fitted.

Usage: fast_contact.py FOLDER [--windows 10:20 20:30] [--rate 40] [--mass 0.05] [--json]
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from glissando import Grid, errors_against, estimate, load_recording, load_robot
from glissando.errors import GlissandoError
from glissando.evaluation.metrics import pool
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.inertia import Inertia
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Rod

DIAMETER, YOUNG, POISSON = 1.6e-3, 60e9, 0.33
LOADS = 3.0  # standard deviation, over that which bends the rod by a third of its length
STRAIN_ERROR = np.repeat([1e-8, 1e-3], 3)
NODES, TIME_SCALE, MODES, RETARDATION, AIR = 5, 0.2, 3, 0.01, 0.05


def priors(length, mass):
    """Mechanical priors without and with inertia."""
    rod = Rod.of_tubes(length, [(DIAMETER, 0.0)], young=YOUNG, poisson=POISSON, density=1.0)
    force = LOADS * 3.0 * float(rod.stiffness[3]) / length**2
    moment = force * length
    still = MechanicalPrior(
        Mechanics(rod.stiffness[None], np.array([mass]), gravity=np.zeros(3)),
        psd_load=np.repeat([force**2, (0.1 * moment) ** 2], 3) / length,
        psd_strain_error=STRAIN_ERROR,
        var_tip=np.repeat([force**2, (0.3 * moment) ** 2], 3),
        time_scale=TIME_SCALE,
        var_base=np.full(6, 1e-4),
    )
    return {
        "without inertia": still,
        "with inertia": replace(still, inertia=Inertia(MODES, RETARDATION, AIR, force)),
    }


def judge(recording, robot, prior, window, rate):
    """RMSE (m) over all places, NEES and coverage in a window (s)."""
    begin = time.process_time()
    used, judges = recording.choose(None, None)
    readings, _ = recording.readings(used, robot, window)
    truth, _ = recording.readings(judges, robot, window, as_truth=True)
    steps = round((window[1] - window[0]) * rate)
    grid = Grid(np.linspace(0.0, robot.length, NODES), np.linspace(*window, steps + 1))
    posterior = estimate(prior, grid, readings)
    found = [errors_against(posterior, each) for each in truth]
    summary = pool(found).summary()
    wanted = "position_rmse", "rotation_rmse", "nees_position", "coverage95_position"
    return {
        **{name: float(summary[name]) for name in wanted},
        "sites": [float(np.sqrt(np.mean(each.position**2))) for each in found],
        "converged": posterior.solve.converged,
        "cpu_seconds": time.process_time() - begin,
    }


def main():
    """Print a row per window and prior, or JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--windows", nargs="+", default=["10:20", "20:30"], help="s")
    parser.add_argument("--rate", type=float, default=40.0, help="time nodes a second (default 40)")
    parser.add_argument("--mass", type=float, default=0.05, help="kg/m (default 0.05)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    options = parser.parse_args()
    robot, rows = load_robot("tdcr466"), []
    if not options.json:
        print("| window (s) | prior | all places (mm) | each (mm) | NEES | inside 95 % | s |")
        print("|---|---|---|---|---|---|---|", flush=True)
    try:
        recording = load_recording(options.folder)
        for text in options.windows:
            window = tuple(float(part) for part in text.split(":"))
            for name, prior in priors(robot.length, options.mass).items():
                row = judge(recording, robot, prior, window, options.rate)
                rows.append({"window": text, "prior": name, **row})
                if not options.json:
                    show(rows[-1])
    except GlissandoError as problem:
        print(problem)
        return 2
    if options.json:
        print(json.dumps(rows, indent=1))
    return 0


def show(row):
    """Print a row of the table."""
    sites = ", ".join(f"{1e3 * each:.1f}" for each in row["sites"])
    print(
        f"| {row['window']} | {row['prior']} | {1e3 * row['position_rmse']:.2f} | {sites} "
        f"| {row['nees_position']:.2f} | {100 * row['coverage95_position']:.0f} % "
        f"| {row['cpu_seconds']:.0f} |",
        flush=True,
    )


if __name__ == "__main__":
    raise SystemExit(main())
