"""Shape and wrenches of loaded rods against a static least-squares fit, for docs/loads.md.

Both have the same readings at five stations and the same rod, gravity and variance of wrenches. The
fit solves the simulator's boundary value problem for every finite difference, from zero wrenches;
errors are those of shapes for which the fit succeeds. Processor time per shape, on one thread.
Usage: wrenches_peers.py --shapes FILE.csv [--count N] [--page]   (a steel rod like SoroSim's)
"""

import argparse
import os
import time
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando import estimate_static
from glissando.errors import NoShapeError
from glissando.simulation import Rod
from plan_page import table, write
from wrenches import NODES
from wrenches_bound import least_squares_fit
from wrenches_problem import (
    BODY,
    exact,
    load_shapes,
    mechanical_prior,
    read,
    solver_error,
    with_gravity,
)

PAGE = Path(__file__).parents[1] / "docs" / "loads.md"
LENGTH = 0.6
PUBLISHED = [
    ["bendier (Ferguson, Kuntz and Hermans 2026), published", "", "8 to 54", "yes"],
]


def measured(shapes, count):
    """Rows of ours and of the fit: RMSE of positions (mm), processor time per shape (ms)."""
    base = np.eye(4)
    base[:3, :3] = BODY
    material = Rod.of_tubes(
        LENGTH, [(1.6e-3, 0.0)], young=200e9, poisson=0.33, density=7870.0, base=base
    )
    half = len(shapes.pose) // 2
    learned, judged = shapes.take(slice(0, half)), shapes.take(slice(half, half + count))
    coil, used = read(judged, half, "five")
    prior = mechanical_prior(
        material, learned, solver_error(material, learned.take(slice(0, None, 5)))
    )
    spread = np.sqrt(np.concatenate([prior.var_points[0], prior.var_tip]))
    nodes, own = np.linspace(0.0, LENGTH, NODES), with_gravity(prior, judged.gravity)
    estimate_static(own, nodes, [coil], count=count)  # warm-up: compiles kernels
    began = time.process_time()
    found = estimate_static(own, nodes, [coil], count=count)
    ours = found.at(judged.station, np.arange(count)[:, None]).position
    seconds = [time.process_time() - began]
    began, fitted, failed = time.process_time(), np.full_like(ours, np.nan), 0
    for i in range(count):
        try:
            loads, _ = least_squares_fit(material, judged, coil, spread, i, from_truth=False)
            shape = exact(material, judged.gravity[i], loads[:6], loads[6:])
            fitted[i] = shape.at(judged.station).pose[:, :3, 3]
        except NoShapeError:  # the rod buckles under an intermediate wrench
            failed += 1
    seconds.append(time.process_time() - began)
    rows = []
    for name, place, spent, cov in (
        ("**ours**, with all wrenches", ours, seconds[0], "yes"),
        (f"static least squares ({failed} of {count} fail)", fitted, seconds[1], "no"),
    ):
        size = 1e3 * np.linalg.norm(place - judged.pose[..., :3, 3], axis=-1)
        rmse = np.sqrt(np.mean(size[~used & np.isfinite(fitted[..., 0])] ** 2))
        rows.append([name, f"{rmse:.2f}", f"{1e3 * spent / count:.0f}", cov])
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--shapes", type=Path, required=True, help="file of shapes (CSV)")
    parser.add_argument("--count", type=int, default=60, help="shapes that are judged")
    parser.add_argument("--page", action="store_true", help="write the table into docs/loads.md")
    options = parser.parse_args()
    rows = measured(load_shapes(options.shapes, LENGTH), options.count)
    text = table(["", "RMSE (mm)", "ms a shape", "covariance"], [*rows, *PUBLISHED])
    if options.page:
        write("others", text, PAGE)
    else:
        print(text)


if __name__ == "__main__":
    main()
