"""Write docs/growth.md and its figure: cost against problem size, and the cost of the arithmetic.

Processor seconds on one thread, which other load hardly affects. The floor is the time of the
block-tridiagonal algebra at the rate at which this machine multiplies matrices of that size.
Usage: growth.py [--out FOLDER] [--runs N] [--most SHARE] [--json FILE]
"""

import argparse
import json
import os
import platform
import time
from datetime import date
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import matplotlib.pyplot as plt
import numpy as np

from estimate import arc, scene
from glissando import CoilReadings, FixedLagSmoother, estimate, load_robot
from online import DOF, sliding

TIMES = [151, 301, 751, 1501, 3001]
NODES = [3, 5, 9, 17, 33]
READINGS = [1000, 3000, 10_000, 30_000, 100_000]
FACTOR, MARGINALS = 8 / 3, 13 / 3  # n³ operations per time node: per iteration, for marginals
UPDATES = 60
ENOUGH = 3.0  # s: total time after which an estimate is not repeated

HEAD = """\
# How cost grows

![Cost against time nodes, arclength nodes, readings, and of an update](growth.png)

A coil that slides along the two-segment robot, a tracker at the base and a gyroscope are read. The
table gives processor seconds on one thread of {machine}, {day}, as medians of up to {runs} runs;
`python benchmarks/growth.py` writes this page. The floor is the time for factorisation and
covariances of the block-tridiagonal system at the rate at which the same machine multiplies
matrices of the size of its blocks; linearisation is not included in it. The cost of an estimate is
linear in time nodes and in readings. In arclength nodes it is cubic once blocks are large. At few
arclength nodes, function calls on small arrays dominate the cost of an update.
"""


def product_rate(size):
    """Floating-point operations per second of matrix products of a size."""
    a, best = np.random.default_rng(0).standard_normal((size, size)), np.inf
    count = max(1, int(2e8 / size**3))
    for _ in range(7):
        start = time.process_time()
        for _ in range(count):
            a @ a
        best = min(best, (time.process_time() - start) / count)
    return 2 * size**3 / best


def algebra(nodes, slabs, iterations, *, marginals=True):
    """Lower bound (s) for the algebra of an estimate."""
    size = nodes * DOF
    operations = slabs * (iterations * FACTOR + marginals * MARGINALS) * size**3
    return operations / product_rate(size)


def batch(nodes, times, readings, runs):
    """Median seconds of an estimate, its lower bound, and its iterations."""
    prior, grid, streams = scene(nodes, times)
    if readings:
        span, length = grid.time[-1], grid.arclength[-1]
        at = np.linspace(0.0, span, readings)
        place = length - 0.06 * np.abs(np.sin(at))
        own = CoilReadings(time=at, arclength=place, values=arc(place, at), cov=1e-5)
        streams = [own, *streams[1:]]
    seconds = []
    while len(seconds) < runs and sum(seconds) < ENOUGH:
        solve = estimate(prior, grid, streams).solve
        seconds.append(solve.seconds["total"])
    least = algebra(nodes, times, solve.iterations)
    return {"seconds": float(np.median(seconds)), "floor": least, "iterations": solve.iterations}


def update(nodes):
    """Median seconds of an update of a window of four time nodes, and its lower bound."""
    robot, took = load_robot("tdcr466"), []
    smoother = FixedLagSmoother(robot.prior, np.linspace(0.0, robot.length, nodes), window=4)
    for now, streams in sliding(0.1 * UPDATES):
        start = time.process_time()
        for stream in streams:
            smoother.add(stream)
        smoother.advance(now)
        took.append(time.process_time() - start)
    return {"seconds": float(np.median(took)), "floor": algebra(nodes, 2, 1, marginals=False)}


def measured(runs, most):
    """Cost by panel and problem size."""
    panels = {
        "time nodes": (TIMES, lambda k: batch(5, k, 0, runs)),
        "arclength nodes": (NODES, lambda n: batch(n, 151, 0, runs)),
        "readings": (READINGS, lambda m: batch(5, 301, m, runs)),
        "arclength nodes, an update": (NODES, update),
    }
    batch(NODES[0], TIMES[0], 0, 1)  # warm-up
    found = {}
    for panel, (amounts, run) in panels.items():
        found[panel] = {}
        for amount in amounts:
            if amount <= max(most * amounts[-1], amounts[0]):
                found[panel][amount] = run(amount)
                print(f"{panel}: {amount:,}: {found[panel][amount]}", flush=True)
    return found


def draw(found, path):
    """Draw a panel per kind of size, with logarithmic axes."""
    figure, axes = plt.subplots(1, len(found), figsize=(11.0, 3.0), layout="constrained")
    for plot, (panel, rows) in zip(axes, found.items(), strict=True):
        for key, style in (("seconds", "o-"), ("floor", "k--")):
            plot.loglog(list(rows), [row[key] for row in rows.values()], style, label=key)
        plot.set_xticks(list(rows), [f"{amount:,}" for amount in rows], rotation=40, minor=False)
        plot.minorticks_off()
        plot.set(xlabel=panel, ylabel="s")
    axes[0].legend(frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def table(found):
    """All numbers as a Markdown table."""
    yield from [
        "",
        "| work | amount | seconds | floor | × | iterations |",
        "|---|---|---|---|---|---|",
    ]
    for panel, rows in found.items():
        for amount, row in rows.items():
            seconds, least = row["seconds"], row["floor"]
            times = f"{seconds / least:.1f} | {row.get('iterations', '–')}"
            yield f"| {panel} | {amount:,} | {seconds:.3g} | {least:.2g} | {times} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs")
    parser.add_argument("--runs", type=int, default=3, help="estimates of each size")
    parser.add_argument("--most", type=float, default=1.0, help="share of the largest sizes to run")
    parser.add_argument("--json", type=Path, help="write every number here")
    options = parser.parse_args()
    found = measured(options.runs, options.most)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    draw(found, options.out / "growth.png")
    head = HEAD.format(machine=platform.machine(), day=date.today(), runs=options.runs)
    (options.out / "growth.md").write_text("\n".join([head[:-1], *table(found), ""]), "utf-8")


if __name__ == "__main__":
    main()
