"""Shape and wrenches of loaded rods from few coil readings, against priors without loads.

Clamped rods bend under known gravity, and under unknown random forces and moments at their middle
and tip; another group's solver computed the shapes. A coil reads the tip only, or five of the
stations. Priors are learned on the first half of the file's shapes and tested on the second.
Usage: wrenches.py --shapes FILE.csv --young Pa --poisson NU --density KG --radius M --length M
       [--readings tip|five] [--json]
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from glissando import estimate_static
from glissando.simulation import Rod
from script import run, say
from wrenches_bound import RESTARTS, cramer_rao, other_minima
from wrenches_problem import (
    BODY,
    ROUNDING,
    load_shapes,
    mechanical_prior,
    read,
    solver_error,
    strain_priors,
    with_gravity,
)

NODES = 13
SIGMAS = 1.959964  # half-width of a normal variable's central 95 %
BASELINE = "strain's moments in four quarters and its jump at the middle, of the learned shapes"
PLAIN = "one density of strain all along, of the learned shapes"


def judge(material, file_shapes, how):
    """All results for one way of reading, `how`."""
    half = len(file_shapes.pose) // 2
    learned, judged = file_shapes.take(slice(0, half)), file_shapes.take(slice(half, None))
    few = learned.take(slice(0, None, 5))
    coil, used = read(judged, half, how)
    count, nodes = len(judged.pose), np.linspace(0.0, material.length, NODES)
    mechanical = mechanical_prior(material, learned, solver_error(material, few))
    say("shapes with the mechanical prior")
    began = time.process_time()
    found = estimate_static(with_gravity(mechanical, judged.gravity), nodes, [coil], count=count)
    seconds = time.process_time() - began
    say("shapes with priors on strain")
    strain, plain = (
        estimate_static(each, nodes, [coil], count=count) for each in strain_priors(material, few)
    )
    out = {"shapes": count, "readings": how, "seconds": seconds, "strain_prior": BASELINE}
    out |= {"plain_prior": PLAIN, "converged": int(found.converged.sum())}
    for name, posterior in (("plain", plain), ("strain", strain), ("mechanical", found)):
        out[name], squares = positions(material, judged, used, posterior)
    say("the least errors that there can be")
    out["restarted_from_truth"] = other_minima(
        material, judged, coil, used, found, mechanical, squares
    )
    least, least_place = cramer_rao(material, judged, used)
    bound = 1e3 * float(np.sqrt(np.mean(least_place[~used] ** 2)))
    out["bound_of_rmse_mm"] = bound
    for key, name in (("", "strain"), ("_plain", "plain")):
        out[f"ratio_of_rmse{key}"] = out["mechanical"]["rmse_mm"] / out[name]["rmse_mm"]
        out[f"ratio_of_bound{key}"] = bound / out[name]["rmse_mm"]
    return out | wrenches(material, judged, found, least)


def positions(material, judged, used, posterior):
    """Statistics of position errors at unread stations, and sums of squares (S,), mm²."""
    at = posterior.at(judged.station, np.arange(len(used))[:, None])
    gap = at.position - judged.pose[..., :3, 3]
    cov = at.cov_position_world + ROUNDING**2 * np.eye(3)
    std = np.sqrt(np.einsum("...ii->...i", cov))[~used]
    nees = np.einsum("...i,...i->...", gap, np.linalg.solve(cov, gap[..., None])[..., 0])
    size = 1e3 * np.linalg.norm(gap, axis=-1)
    squares = np.sum(np.where(used, 0.0, size) ** 2, axis=1)
    beyond = (used * judged.station).max(axis=1) > 0.5 * material.length
    return {
        "share_of_worst_two_shapes": float(np.sort(squares)[-2:].sum() / squares.sum()),
        "rmse_where_read_beyond_half_mm": float(
            np.sqrt(squares[beyond].sum() / np.sum(~used[beyond]))
        ),
        "rmse_mm": float(np.sqrt(np.mean(size[~used] ** 2))),
        "rmse_expected_mm": float(1e3 * np.sqrt(3.0 * np.mean(std**2))),
        "median_mm": float(np.median(size[~used])),
        "components_inside_95": float(np.mean(np.abs(gap[~used]) < SIGMAS * std)),
        "nees": float(np.mean(nees[~used]) / 3.0),
    }, squares


def wrenches(material, judged, found, least):
    """Statistics of wrench errors, and of standard deviations over the bounds `least` (S, 12)."""
    errors, stds = [], []
    for place, truth in ((0.5 * material.length, judged.middle), (material.length, judged.tip)):
        load = found.load(place, np.arange(len(truth)), frame="world")
        errors.append(load.wrench - truth)
        stds.append(load.std)
    error, std = np.concatenate(errors, axis=1), np.concatenate(stds, axis=1)
    inside = np.abs(error) < SIGMAS * std
    names = [f"{where} {what} {axis}" for where in ("middle", "tip")
             for what in ("force", "moment") for axis in "xyz"]  # fmt: skip
    shares = {"median": 0.5, "from": 0.05, "to": 0.95}
    return {
        "wrench_components_inside_95": float(np.mean(inside)),
        "std_over_cramer_rao": {
            name: float(np.quantile(std / least, q)) for name, q in shares.items()
        },
        "wrenches": {
            name: {
                "rmse": float(np.sqrt(np.mean(error[:, j] ** 2))),
                "std": float(np.sqrt(np.mean(std[:, j] ** 2))),
                "inside_95": float(np.mean(inside[:, j])),
            }
            for j, name in enumerate(names)
        },
    }


def table(found):
    """Results as lines of text."""
    lines = [
        f"{found['shapes']} shapes, coil at {found['readings']}, {found['seconds']:.0f} s of CPU"
    ]
    for name in ("mechanical", "strain", "plain"):
        row = found[name]
        lines.append(
            f"{name:10}  RMSE {row['rmse_mm']:.2f} mm (its covariance says "
            f"{row['rmse_expected_mm']:.2f}), median {row['median_mm']:.2f} mm, "
            f"components inside 95 %: {100 * row['components_inside_95']:.1f} %, "
            f"NEES {row['nees']:.2f}"
        )
    bound, again = found["std_over_cramer_rao"], found["restarted_from_truth"]
    above = ", ".join(f"{c:.1f}" for c in again["cost_of_truth_above"])
    lines += [
        f"RMSE {found['ratio_of_rmse']:.2f} of the strain prior's ({found['strain_prior']}), "
        f"{found['ratio_of_rmse_plain']:.2f} of the plain one's ({found['plain_prior']})",
        f"the least RMSE that these readings allow is {found['bound_of_rmse_mm']:.2f} mm (van "
        f"Trees), {found['ratio_of_bound']:.2f} and {found['ratio_of_bound_plain']:.2f} of theirs",
        f"found again from the truth, the {RESTARTS} shapes farthest off are "
        f"{again['farthest_mm']:.3f} mm from the estimate; the truth's cost is higher by {above}; "
        f"least squares take {again['seconds_each']:.2f} s each",
        f"the worst two shapes make {100 * found['mechanical']['share_of_worst_two_shapes']:.0f} % "
        f"of the squared error; RMSE of shapes that were read beyond half the length: "
        f"{found['mechanical']['rmse_where_read_beyond_half_mm']:.2f} mm",
        f"wrench components inside 95 %: {100 * found['wrench_components_inside_95']:.1f} %",
        f"standard deviations of wrenches {bound['median']:.3f} of the Cramér–Rao bound "
        f"({bound['from']:.3f} to {bound['to']:.3f})",
    ]
    for name, row in found["wrenches"].items():
        lines.append(
            f"  {name:16} RMSE {row['rmse']:.4f}, std {row['std']:.4f}, "
            f"inside 95 %: {100 * row['inside_95']:.1f} %"
        )
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--shapes", type=Path, required=True, help="file of shapes (CSV)")
    parser.add_argument("--young", type=float, required=True, help="Young's modulus, Pa")
    parser.add_argument("--poisson", type=float, required=True, help="Poisson's ratio")
    parser.add_argument("--density", type=float, required=True, help="density, kg/m³")
    parser.add_argument("--radius", type=float, required=True, help="radius, m")
    parser.add_argument("--length", type=float, required=True, help="length, m")
    readings = "a coil at the tip, or at five stations (default: tip)"
    parser.add_argument("--readings", choices=("tip", "five"), default="tip", help=readings)
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    for name, least, most, unit in (
        ("young", 1e4, 1e13, "Pa"), ("poisson", -1.0, 0.5, ""), ("density", 1.0, 3e4, "kg/m³"),
        ("radius", 1e-6, 0.1, "m"), ("length", 1e-3, 50.0, "m"),
    ):  # fmt: skip
        value = getattr(options, name)
        if not least <= value <= most:
            parser.error(f"--{name} is {value:g}; give {least:g} to {most:g} {unit}".rstrip())
    base = np.eye(4)
    base[:3, :3] = BODY
    material = Rod.of_tubes(
        options.length,
        [(2.0 * options.radius, 0.0)],
        young=options.young,
        poisson=options.poisson,
        density=options.density,
        base=base,
    )
    found = judge(material, load_shapes(options.shapes, options.length), options.readings)
    print(json.dumps(found, indent=2) if options.json else table(found))


if __name__ == "__main__":
    run(main)
