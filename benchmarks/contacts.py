"""One unknown lateral force on the robot of the paper: found, where and how large, by a coil.

The simulator bends the robot of `sliding700` under its weight and a force of 0.1 to 1 N anywhere on
its outer two thirds. A coil reads ten places over the length, or ten times the tip.
Usage: contacts.py [--touched N] [--untouched N] [--seed SEED] [--json]
"""

import argparse
import json
import warnings

import numpy as np

from glissando import CoilReadings, Grid, NotConvergedWarning, estimate
from glissando.estimation.contact import locate_contact, scan_contacts
from glissando.geometry import se3
from glissando.io.shipped_robots import robot_file
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Loads, Wrench, solve_shape
from glissando.simulation.bench import load_bench

NOISE = np.repeat([0.7e-3, np.radians(0.4)], [3, 2])
STD_FORCE = [0.6, 0.6, 0.02]  # N: what touches from the side hardly drags along
READ = 10
NODES = 11


def robot():
    """The simulator's rod, gravity, and a prior of that rod."""
    bench = load_bench(robot_file("sliding700"))
    rod, gravity = bench.rod, np.asarray(bench.gravity, dtype=float)
    mechanics = Mechanics(rod.stiffness[None], np.array([rod.mass_per_length]), gravity=gravity)
    prior = MechanicalPrior(
        mechanics,
        psd_load=np.repeat([1e-4, 1e-8], 3),
        psd_strain_error=np.repeat([1e-10, 1e-6], 3),
        var_tip=np.repeat([1e-5, 1e-9], 3),
        time_scale=1.0,
        var_base=np.full(6, 1e-10),
        base_pose=rod.base,
    )
    return rod, gravity, prior


def coil(rng, shape, places):
    """Readings at these places of a shape."""
    off, roll = np.zeros((2, places.size, 6))
    off[:, :5] = NOISE * rng.standard_normal((places.size, 5))
    roll[:, 5] = rng.uniform(-np.pi, np.pi, places.size)
    values = shape.at(places).pose @ se3.exp(off) @ se3.exp(roll)
    return CoilReadings(time=np.zeros(places.size), arclength=places, values=values, cov=NOISE**2)


def trial(rng, setup, way, force):
    """One shape: whether a contact is said, where and how large."""
    rod, gravity, prior = setup
    place = rng.uniform(0.3, 1.0) * rod.length
    angle = rng.uniform(0.0, 2.0 * np.pi)
    push = np.array([np.cos(angle), np.sin(angle), 0.0])
    for _ in range(6):  # what does not drag pushes across the rod as it is bent
        wrench = Wrench(place, force * push)
        shape = solve_shape(rod, [], Loads(gravity=gravity, wrenches=[wrench]))
        tangent = shape.at(np.array([place])).pose[0, :3, 2]
        across = push - tangent * (tangent @ push)
        push = across / np.linalg.norm(across)
    ends = np.linspace(0.1, 1.0, READ) if way == "sliding" else np.ones(READ)
    seen = coil(rng, shape, rod.length * ends)
    grid = Grid(np.linspace(0.0, rod.length, NODES), [0.0])
    scan = scan_contacts(estimate(prior, grid, [seen]), 0.0, std_force=STD_FORCE)
    if not scan.detected or not force:
        return scan.detected, np.nan, np.nan
    start = float(scan.arclength[scan.best])
    found = locate_contact(prior, grid, [seen], start=start, std_force=STD_FORCE)
    miss = abs(found.arclength - place) / rod.length
    size = np.linalg.norm(found.force)
    return True, miss, abs(size - force) / force


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--touched", type=int, default=40)
    parser.add_argument("--untouched", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore", NotConvergedWarning)
    setup, out = robot(), {}
    for way in ("sliding", "fixed"):
        rng = np.random.default_rng(options.seed)
        said = [trial(rng, setup, way, 0.0)[0] for _ in range(options.untouched)]
        forces = np.exp(rng.uniform(np.log(0.1), 0.0, options.touched))
        found = np.array([trial(rng, setup, way, force) for force in forces], dtype=float)
        out[way] = {
            "false_alarms": float(np.mean(said)),
            "detected": float(np.mean(found[:, 0])),
            "place_median": float(np.nanmedian(found[:, 1])),
            "force_median": float(np.nanmedian(found[:, 2])),
            "place_90": float(np.nanquantile(found[:, 1], 0.9)),
            "force_90": float(np.nanquantile(found[:, 2], 0.9)),
        }
    if options.json:
        print(json.dumps(out, indent=2))
        return
    print("| coil | false alarms | found | place, median (90 %) of length | force, median (90 %) |")
    print("|---|---|---|---|---|")
    for way, row in out.items():
        cells = [f"{100 * row[key]:.1f}" for key in ("false_alarms", "detected")]
        cells += [
            f"{100 * row[f'{what}_median']:.1f} % ({100 * row[f'{what}_90']:.1f} %)"
            for what in ("place", "force")
        ]
        print(f"| {way} | {cells[0]} % | {cells[1]} % | {cells[2]} | {cells[3]} |")


if __name__ == "__main__":
    main()
