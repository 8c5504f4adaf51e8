"""Detection and location of one unknown lateral force on the paper's robot by a coil.

The simulator bends the robot of `sliding700`, at a random angle to gravity, under its weight and a
force of 0.1 to 1 N anywhere. A coil reads ten places over the length, or the tip ten times.
Usage: contacts.py [--touched N] [--untouched N] [--seed SEED] [--json] [--page] [--figure FILE.png]
"""

import argparse
import json
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from glissando import CoilReadings, FalseConfidenceWarning, Grid, NotConvergedWarning, estimate
from glissando.estimation.contact import scan_contacts
from glissando.estimation.contact_place import locate_contact
from glissando.geometry import se3
from glissando.io.shipped_robots import robot_file
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Loads, Wrench, solve_shape
from glissando.simulation.bench import load_bench
from glissando.visualization.canvas import canvas, save_figure
from plan_page import table, write
from script import run

warnings.simplefilter("ignore", FalseConfidenceWarning)  # of a robot before its touch is found

NOISE = np.repeat([0.7e-3, np.radians(0.4)], [3, 2])
STD_FORCE = 0.6  # N, per component
READ = 10
NODES = 11
WAYS = {"sliding": np.linspace(0.1, 1.0, READ), "fixed": np.ones(READ)}  # of the length
SIGMAS = 1.959964  # half-width of a normal variable's central 95 %
PAGE = Path(__file__).parents[1] / "docs" / "loads.md"
COLUMNS = ("place", "force", "found", "miss", "off", "std_place", "std_force", "z_place", "z_force")


def robot():
    """The simulator's rod, and a mechanical prior of that rod."""
    rod = load_bench(robot_file("sliding700")).rod
    prior = MechanicalPrior(
        Mechanics(rod.stiffness[None], np.array([rod.mass_per_length])),
        psd_load=np.repeat([1e-4, 1e-8], 3),
        psd_strain_error=np.repeat([1e-9, 1e-6], 3),
        var_tip=np.repeat([1e-5, 1e-9], 3),
        time_scale=1.0,
        var_base=np.full(6, 1e-10),
        base_pose=rod.base,
    )
    return rod, prior


def coil(rng, shape, places):
    """Noisy coil readings of a shape at arclengths."""
    noise, roll = np.zeros((2, places.size, 6))
    noise[:, :5] = NOISE * rng.standard_normal((places.size, 5))
    roll[:, 5] = rng.uniform(-np.pi, np.pi, places.size)
    values = shape.at(places).pose @ se3.exp(noise) @ se3.exp(roll)
    return CoilReadings(time=np.zeros(places.size), arclength=places, values=values, cov=NOISE**2)


def pushed(rng, rod, gravity, place, size):
    """Shape under a force perpendicular to the unbent rod, and the force."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    force = size * rod.base[:3, :3] @ np.array([np.cos(angle), np.sin(angle), 0.0])
    return solve_shape(rod, [], Loads(gravity=gravity, wrenches=[Wrench(place, force)])), force


def trial(seed, setup, way, touched):
    """One trial: values in the order of COLUMNS, NaN where no contact was detected or applied."""
    (rod, prior), rng = setup, np.random.default_rng(seed)
    gravity = rng.standard_normal(3)
    gravity *= 9.81 / np.linalg.norm(gravity)
    prior = replace(prior, mechanics=replace(prior.mechanics, gravity=gravity))
    place, size = rng.uniform(0.0, rod.length), np.exp(rng.uniform(np.log(0.1), 0.0)) * touched
    shape, force = pushed(rng, rod, gravity, place, size)
    readings = coil(rng, shape, rod.length * WAYS[way])
    grid = Grid(np.linspace(0.0, rod.length, NODES), [0.0])
    scan = scan_contacts(estimate(prior, grid, [readings]), 0.0, std_force=STD_FORCE)
    if not scan.detected or not touched:
        return [place / rod.length, size, scan.detected, *[np.nan] * 6]
    start = float(scan.arclength[scan.best])
    found = locate_contact(prior, grid, [readings], start=start, std_force=STD_FORCE)
    side = force / size
    std = float(np.sqrt(side @ found.cov_force @ side))
    miss = found.arclength - place
    return [
        *(place / rod.length, size, True),
        abs(miss) / rod.length,
        abs(np.linalg.norm(found.force) - size) / size,
        found.std_arclength / rod.length,
        std,
        miss / found.std_arclength,
        side @ (found.force - force) / std,
    ]


def trials(seeds, setup, way, touched):
    """Trials (T, 9) of seeds, with a line of progress every few seconds."""
    out, last_line = [], time.monotonic()
    for k, seed in enumerate(seeds):
        out.append(trial(seed, setup, way, touched))
        if time.monotonic() - last_line > 5.0:
            last_line = time.monotonic()
            print(f"{way}, {'touched' if touched else 'untouched'}: {k + 1} of {len(seeds)}",
                  file=sys.stderr, flush=True)  # fmt: skip
    return np.array(out, dtype=float)


def share(hits):
    """Share of true entries and its exact 95 % interval."""
    bounds = binomtest(int(hits.sum()), hits.size).proportion_ci(0.95)
    return [float(hits.mean()), float(bounds.low), float(bounds.high)]


def summary(untouched, touched):
    """Detection rates with intervals, errors, and coverage of the standard deviations."""
    row = dict(zip(COLUMNS, touched.T, strict=True))
    detected = row["found"] > 0.0
    out = {"false_alarms": share(untouched[:, 2] > 0.0), "found": share(detected)}
    for third in range(3):
        in_third = (row["place"] * 3.0).astype(int) == third
        out[f"found_third_{third + 1}"] = share(detected[in_third]) if in_third.any() else None
    for name in ("miss", "off", "std_place", "std_force"):
        out[name] = [float(np.quantile(row[name][detected], q)) for q in (0.5, 0.9)]
    for name in ("z_place", "z_force"):
        out[f"{name}_inside_95"] = float(np.mean(np.abs(row[name][detected]) < SIGMAS))
    return out


def lines(found, counts):
    """Table of the page."""

    def rate(cell):
        return (
            "–"
            if cell is None
            else f"{100 * cell[0]:.1f} % ({100 * cell[1]:.1f} to {100 * cell[2]:.1f})"
        )

    def both(cell, scale, unit):
        return f"{scale * cell[0]:.2g} {unit} ({scale * cell[1]:.2g} {unit})"

    rows = [(f"false alarms of {counts[0]} untouched", [rate(f["false_alarms"]) for f in found])]
    rows.append((f"found of {counts[1]} touched", [rate(f["found"]) for f in found]))
    for third, name in enumerate(("third at the base", "middle third", "third at the tip"), 1):
        rows.append((f"… in the {name}", [rate(f[f"found_third_{third}"]) for f in found]))
    for key, name, scale, unit in (
        ("miss", "place off by, median (90 %) of the length", 100.0, "%"),
        ("off", "force off by, median (90 %)", 100.0, "%"),
        ("std_place", "standard deviation of the place", 100.0, "%"),
        ("std_force", "standard deviation of the force", 1e3, "mN"),
    ):
        rows.append((name, [both(f[key], scale, unit) for f in found]))
    for key in ("place", "force"):
        name = f"{key}s inside their 95 %"
        rows.append((name, [f"{100 * f[f'z_{key}_inside_95']:.0f} %" for f in found]))
    return table(["", "sliding coil", "fixed coil"], [[name, *cells] for name, cells in rows])


def draw(touched, path):
    """Plot the standard deviations of force and place over the place of the contact."""
    colours = {"sliding": "#0072B2", "fixed": "#D55E00"}
    with canvas(9.0, 3.6) as figure:
        panels = figure.subplots(1, 2)
        for way, rows in touched.items():
            row = dict(zip(COLUMNS, rows.T, strict=True))
            seen = row["found"] > 0.0
            label = f"{way} coil"
            for axes, key, scale in zip(
                panels, ("std_force", "std_place"), (1e3, 100), strict=True
            ):
                at = 100 * row["place"][seen], scale * row[key][seen]
                axes.plot(*at, ".", color=colours[way], ms=5, alpha=0.5)
                edges = np.linspace(0.0, 100.0, 9)
                bins = [at[1][(at[0] >= a) & (at[0] < a + 12.5)] for a in edges[:-1]]
                middle = [np.median(b) if b.size > 2 else np.nan for b in bins]
                axes.plot(edges[:-1] + 6.25, middle, color=colours[way], lw=2.5, label=label)
        for axes, name in zip(
            panels, ("of the force (mN)", "of the place (% of length)"), strict=True
        ):
            axes.set(xlabel="where something touches (% of length)", yscale="log")
            axes.set_ylabel(f"standard deviation\n{name}")
            axes.grid(True, which="both")
        panels[0].legend()
        save_figure(panels, path)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--touched", type=int, default=100, help="shapes with a contact")
    parser.add_argument("--untouched", type=int, default=340, help="shapes without")
    parser.add_argument("--seed", type=int, default=1000, help="of what is drawn")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--page", action="store_true", help="write the table into docs/loads.md")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="draw standard deviations")
    options = parser.parse_args()
    if min(options.touched, options.untouched) < 10:
        parser.error("--touched and --untouched are ten shapes or more, to have rates")
    warnings.simplefilter("ignore", NotConvergedWarning)
    setup, counts, touched, found = robot(), (options.untouched, options.touched), {}, {}
    for way in WAYS:
        seeds = [[options.seed, i] for i in range(sum(counts))]
        untouched = trials(seeds[: counts[0]], setup, way, False)
        touched[way] = trials(seeds[counts[0] :], setup, way, True)
        found[way] = summary(untouched, touched[way])
    if options.figure:
        draw(touched, options.figure)
    if options.page:
        write("contacts", lines(list(found.values()), counts), PAGE)
    elif not options.json:
        print("\n".join(lines(list(found.values()), counts)))
    if options.json:
        print(json.dumps(found, indent=2))


if __name__ == "__main__":
    run(main)
