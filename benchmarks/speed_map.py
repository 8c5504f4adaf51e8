"""Map of the gain of sliding: errors over slide speed and robot speed, against a fixed coil.

A tendon-driven robot with inertia moves from C to S in 0.5 to 12 s while its coil slides over the
whole length and back at 20 mm/s to 1 m/s, on an elastic drive tube with stick-slip, with a tracker
whose exposure is 25 ms. The duration of the motion is known to the estimator (`paced`). Every cell
of the map is the RMSE of six motion capture frames over seeds, each with another permanent set of
the tubes and other draws of all noise; the fixed coil is at the tip, with the same seeds and
tracker.

`--write DIR` writes the robot and two studies; `glissando study DIR/fixed.toml --out DIR/fixed`,
and likewise `sliding`, runs them on all cores, and can be stopped and resumed; then `speed_map.py
DIR` prints the map, for the seeds that all cells of a robot speed have.

Usage: speed_map.py DIR [--write] [--seeds N] [--figure FILE.png] [--json]
"""

import argparse
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from glissando.errors import GlissandoError
from glissando.experiments.passes import SHAPE, driven_robot
from glissando.experiments.scenes import bench
from glissando.experiments.statistics import COLUMNS, summary
from glissando.experiments.study.plan import load_study
from glissando.experiments.study.store import Store

DURATIONS = [0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0]  # s
SPEEDS = [0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.45, 0.65, 1.0]  # m/s


def write(folder, seeds):
    """Write the robot with its drive tube, and both studies."""
    folder.mkdir(parents=True, exist_ok=True)
    driven_robot(folder)
    shared = f'robot = "robot.toml"\nshape = "{SHAPE}"\ndynamic = true\npaced = true\n'
    for name, slide, axis in (("fixed", "hold", ""), ("sliding", "traverse", f"speed = {SPEEDS}")):
        text = f'name = "{name}"\nseeds = {seeds}\n[fixed]\n{shared}slide = "{slide}"\n'
        text += f"[grid]\nduration = {DURATIONS}\n{axis}\n"
        (folder / f"{name}.toml").write_text(text)
        print(f"Wrote {folder / name}.toml")


def found(folder, name):
    """Results (D, V, S, 5) in COLUMNS by duration, speed and seed; NaN for cells not yet run."""
    study = load_study(folder / f"{name}.toml")
    rows = Store(study, folder / name, resume=True).rows
    speeds = SPEEDS if name == "sliding" else [0.0]
    out = np.full((len(DURATIONS), len(speeds), len(study.seeds), len(COLUMNS)), np.nan)
    for cell in study.cells():
        row = rows.get(cell.id)
        if row is not None and row["error"] is None:
            where = cell.settings["duration"], cell.settings["speed"] if name == "sliding" else 0.0
            place = DURATIONS.index(where[0]), speeds.index(where[1]), cell.seed
            out[place] = [row[each] for each in COLUMNS]
    return out


def tip_speed():
    """Length of the tip's path from shape to shape, m: mean speed times duration."""
    known = bench()
    actuation = known.shape(SHAPE)
    motion = known.move(actuation, known.flaws.without("set"), 0)
    time = np.linspace(actuation.time[0], actuation.time[-1], 200)
    place = motion.at(np.full(time.size, known.rod.length), time).pose[:, :3, 3]
    return float(np.linalg.norm(np.diff(place, axis=0), axis=1).sum())


def judged(folder):
    """Cells of the map: speeds, passes over the body, and the change against the fixed coil."""
    fixed, sliding = (found(folder, name) for name in ("fixed", "sliding"))
    travel, length = tip_speed(), bench().rod.length
    cells = []
    for d, duration in enumerate(DURATIONS):
        known = ~np.isnan(fixed[d, 0, :, 0]) & ~np.isnan(sliding[d, :, :, 0]).any(axis=0)
        if known.sum() < 2:
            continue
        for v, speed in enumerate(SPEEDS):
            cells.append(
                {
                    "duration": duration,
                    "tip_speed": travel / duration,
                    "slide_speed": speed,
                    "passes": speed * duration / length,
                    "fixed": summary(fixed[d, 0, known]),
                    **summary(sliding[d, v, known], fixed[d, 0, known]),
                }
            )
    return cells


def rule(cells):
    """Ranges of passes during the motion in which sliding increases or reduces the error.

    Up to `near` passes, and from `far` on, the whole 95 % interval of the change is below zero in
    every cell; `costs` are the fewest and the most passes of cells where it is above.
    """
    ordered = sorted(cells, key=lambda cell: cell["passes"])
    passes = np.array([cell["passes"] for cell in ordered])
    wanted = ("low", "value", "high")
    change = np.array([[cell["position_change"][k] for k in wanted] for cell in ordered])
    fails, costs = np.flatnonzero(change[:, 2] >= 0.0), np.flatnonzero(change[:, 0] > 0.0)
    near, far = (fails[0], fails[-1] + 1) if fails.size else (passes.size, 0)

    def best_and_worst(part):
        values = change[part, 1]
        return [float(values.min()), float(values.max())] if values.size else None

    return {
        "near": float(passes[near - 1]) if near else None,
        "far": float(passes[far]) if far < passes.size else None,
        "costs": [float(passes[costs[0]]), float(passes[costs[-1]])] if costs.size else None,
        "change_near": best_and_worst(slice(0, near)),
        "change_far": best_and_worst(slice(far, None)),
        "worst": float(change[:, 1].max()),
    }


def show(cells):
    """Print the map as tables, and the rule as sentences."""
    durations = sorted({c["duration"] for c in cells})
    speeds = sorted({c["slide_speed"] for c in cells})
    at = {(c["duration"], c["slide_speed"]): c for c in cells}
    head = " | ".join(f"{1e3 * v:.0f} mm/s" for v in speeds)
    for title, text in (
        ("change of the body's RMSE against the fixed coil, %", _change),
        ("inside 95 %, and NEES per degree of freedom", _confidence),
    ):
        print(f"\n{title}\n")
        print(f"| robot: tip at | seeds | fixed (mm) | {head} |")
        print("|---|---|---|" + "---|" * len(speeds))
        for d in durations:
            first = at[d, speeds[0]]
            fixed = 1e3 * first["fixed"]["position"]["value"]
            row = " | ".join(text(at[d, v]) for v in speeds)
            print(
                f"| {1e3 * first['tip_speed']:.0f} mm/s ({d:g} s) | {first['seeds']} "
                f"| {fixed:.1f} | {row} |"
            )
    ranges = rule(cells)
    print("\nA pass is the body's length slid while the robot moves from shape to shape.")
    if ranges["near"] is not None:
        best, least = ranges["change_near"]
        print(f"Up to {ranges['near']:.2g} passes sliding pays: {best:.0f} to {least:.0f} %.")
    if ranges["costs"] is not None:
        first, last = ranges["costs"]
        print(f"Between {first:.2g} and {last:.2g} it can cost, up to {ranges['worst']:+.0f} %.")
    if ranges["far"] is not None:
        best, least = ranges["change_far"]
        print(f"From {ranges['far']:.2g} passes on it pays: {best:.0f} to {least:.0f} %.")


def draw(cells, path):
    """Draw the map with lines of equal passes; its colours end at ±100 %."""
    durations = sorted({c["duration"] for c in cells})
    change = {(c["duration"], c["slide_speed"]): c["position_change"]["value"] for c in cells}
    grid = np.array([[change[d, v] for v in SPEEDS] for d in durations])
    tip = np.array([next(c["tip_speed"] for c in cells if c["duration"] == d) for d in durations])
    figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    shown = axes.pcolormesh(
        1e3 * np.array(SPEEDS),
        1e3 * tip,
        grid,
        vmin=-100,
        vmax=100,
        cmap="RdBu_r",
        shading="nearest",
    )
    rate = {c["duration"]: c["passes"] / c["slide_speed"] for c in cells}
    for passes in (1.0 / 3.0, 1.0, 5.0):
        slide = [1e3 * passes / rate[d] for d in durations]
        axes.plot(slide, 1e3 * tip, "k--", lw=0.8)
        label = f"{passes:.2g} passes" if passes != 1.0 else "1 pass"
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
        axes.text(slide[-2], 1e3 * tip[-2], label, fontsize=8, ha="center", bbox=box)
    axes.set(xscale="log", yscale="log", xlabel="slide (mm/s)", ylabel="tip of the robot (mm/s)")
    axes.set_xlim(1e3 * SPEEDS[0] / 1.2, 1e3 * SPEEDS[-1] * 1.2)
    figure.colorbar(shown, label="change of the body's RMSE against a fixed coil (%)")
    figure.savefig(path, dpi=120, metadata={"Software": None})


def _change(cell):
    change = cell["position_change"]
    return f"{change['value']:+.0f} ({change['low']:+.0f} … {change['high']:+.0f})"


def _confidence(cell):
    return f"{100 * cell['coverage']['value']:.0f} %, {cell['nees']['value']:.1f}"


def main():
    """Write the studies, or print the map of their results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--write", action="store_true", help="write robot and studies")
    parser.add_argument("--seeds", type=int, default=30, help="of the studies (default 30)")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="draw the map, too")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    options = parser.parse_args()
    if options.write:
        write(options.folder, options.seeds)
        return 0
    try:
        cells = judged(options.folder)
    except GlissandoError as problem:
        print(problem)
        return 2
    if options.figure:
        draw(cells, options.figure)
    if options.json:
        print(json.dumps({"cells": cells, "rule": rule(cells)}, indent=1))
    else:
        show(cells)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
