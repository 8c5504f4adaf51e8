"""Shape and wrenches of loaded rods from few coil readings, against a prior that knows no loads.

Clamped rods bend under gravity, which is known, and a random force and moment at their middle and
at their tip, which are not; another group's solver found the shapes. A coil reads the tip alone, or
five of the stations. Of the file's shapes the first half is learned from, the second judged.
Usage: wrenches.py --shapes FILE.csv --young Pa --poisson NU --density KG --radius M --length M
       [--readings tip|five] [--json]
"""

import argparse
import csv
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from glissando import BaseVariance, CoilReadings, SeparablePrior, estimate_static
from glissando.geometry import se3
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Loads, Rod, Wrench, solve_shape

NODES = 13
SIGMAS = 1.959964  # of a normal number's middle 95 %
BODY = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # the file's tangent is body x, ours z
NOISE = np.repeat([0.7e-3, np.radians(0.4)], [3, 2])  # one standard deviation of each axis
BASELINE = "strain's moments in four quarters and its jump at the middle, of the learned shapes"
PLAIN = "one density of strain all along, of the learned shapes"
RESTARTS = 5  # of the shapes that are farthest off, which are found again from the truth
ROUNDING = 1e-4 / np.sqrt(12)  # m: the files have four decimals


@dataclass(frozen=True)
class Shapes:
    """S shapes: what is in the file.

    Attributes:
        station: Arclengths (M,), m, the base left out.
        pose: Poses (S, M, 4, 4) there.
        gravity: Acceleration (S, 3), m/s², world.
        middle: Wrench (S, 6) at half the length, world, about that point.
        tip: Wrench (S, 6) at the tip.
    """

    station: np.ndarray
    pose: np.ndarray
    gravity: np.ndarray
    middle: np.ndarray
    tip: np.ndarray

    def take(self, rows):
        """Some of the shapes."""
        others = (getattr(self, name)[rows] for name in ("pose", "gravity", "middle", "tip"))
        return Shapes(self.station, *others)


def load_shapes(file, length):
    """All shapes of a file in SoroSim's form."""
    with file.open() as text:
        rows = list(csv.reader(text))
    fractions = np.array([float(x) for x in rows[1][4:]])
    half = fractions.size // 2
    station = 0.5 * length * np.concatenate([fractions[:half], 1.0 + fractions[half:]])
    table = np.array([[float(x) for x in row[1:]] for row in rows[2:]])
    euler, place = np.moveaxis(table.reshape(-1, 2, 3, table.shape[1]), (1, 3), (0, 2))
    keep = 3 + np.flatnonzero(np.diff(station, prepend=0.0) > 0.0)
    pose = np.tile(np.eye(4), (*place[:, keep].shape[:2], 1, 1))
    turns = Rotation.from_euler("XYZ", euler[:, keep].reshape(-1, 3)).as_matrix()
    pose[..., :3, :3] = turns.reshape(*pose.shape[:2], 3, 3) @ BODY
    pose[..., :3, 3] = place[:, keep]
    wrench = np.concatenate([place[:, :3], euler[:, :3]], axis=-1)
    return Shapes(station[keep - 3], pose, wrench[:, 0, :3], wrench[:, 1], wrench[:, 2])


def mechanical_prior(material, shapes, error):
    """What is known of the rod: its material, and how large wrenches were on the learned shapes."""
    fields = {}
    for name, wrench in (("var_points", shapes.middle), ("var_tip", shapes.tip)):
        force, moment = np.mean(wrench[:, :3] ** 2), np.mean(wrench[:, 3:] ** 2)
        fields[name] = np.repeat([force, moment], 3)
    half = 0.5 * material.length
    return MechanicalPrior(
        Mechanics(material.stiffness[None], np.array([material.mass_per_length])),
        psd_load=np.repeat([1e-8, 1e-12], 3),
        psd_strain_error=np.repeat([1e-4 * error, error], 3),
        var_tip=fields["var_tip"],
        time_scale=1.0,
        var_base=np.full(6, 1e-10),
        base_pose=material.base,
        points=np.array([half]),
        var_points=fields["var_points"][None],
    )


def with_gravity(prior, gravity):
    """The prior of shapes under a gravity (S, 3) of their own."""
    return replace(prior, mechanics=replace(prior.mechanics, gravity=gravity))


def solver_error(material, shapes):
    """Density of strain's error (angular, 1/m) that explains how far the shapes are from ours.

    White noise of density q on curvature moves a straight rod's cross-section at s sideways by a
    variance of q s³/3 in each of two directions. The files' own rounding is taken off.
    """
    found = []
    for i in range(len(shapes.pose)):
        rod = exact(material, shapes.gravity[i], shapes.middle[i], shapes.tip[i])
        gap = rod.at(shapes.station).pose[:, :3, 3] - shapes.pose[i, :, :3, 3]
        found.append(np.sum(gap**2, axis=1) - 3.0 * ROUNDING**2)
    mean = np.maximum(np.mean(found, axis=0), ROUNDING**2)
    far = shapes.station > 0.25 * material.length
    return float(np.mean((1.5 * mean / shapes.station**3)[far]))


def strain_priors(material, shapes):
    """Priors that know no loads, of the learned shapes: with moments by place, and with one."""
    length = material.length
    edges = length * np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    places = np.sort(np.concatenate([edges, [0.5 * length - 1e-6]]))
    strain = np.array(
        [
            exact(material, *loads).at(places).strain
            for loads in zip(shapes.gravity, shapes.middle, shapes.tip, strict=True)
        ]
    )
    change = np.mean(np.diff(strain, axis=1)[..., 3:] ** 2, axis=0)
    change[:, :2] = change[:, :2].mean(axis=1, keepdims=True)
    first = np.mean(strain[:, 0, 3:] ** 2, axis=0)
    first[:2] = first[:2].mean()
    stiff = np.full(3, 1e-9)
    rows = [np.concatenate([stiff, row]) for row in change]
    quarters = [np.concatenate([stiff, rows[i][3:] / (0.25 * length)]) for i in (0, 1, 3, 4)]
    none = np.concatenate([stiff, np.full(3, 1e-9)])
    base = BaseVariance(np.full(6, 1e-10), np.concatenate([stiff, first]))
    jumps = np.array([none, rows[2], none])
    even = np.concatenate([stiff, change.sum(axis=0) / length])
    return (
        SeparablePrior(
            np.maximum(quarters, 1e-9), 1.0, base, base_pose=material.base, joints=edges[1:4],
            jumps=jumps,
        ),
        SeparablePrior(even, 1.0, base, base_pose=material.base),
    )  # fmt: skip


def exact(material, gravity, middle, tip):
    """The simulator's shape under these loads."""
    half, length = 0.5 * material.length, material.length
    ends = [Wrench(s, w[:3], w[3:]) for s, w in ((half, middle), (length, tip))]
    return solve_shape(material, [], Loads(gravity=gravity, wrenches=ends))


def read(shapes, first, how):
    """Coil readings of all shapes, each of its own seed, and which stations (S, M) were read."""
    count = shapes.station.size
    used, time_, place, values = np.zeros((len(shapes.pose), count), dtype=bool), [], [], []
    for i, pose in enumerate(shapes.pose):
        rng = np.random.default_rng(first + i)
        stops = np.array([count - 1]) if how == "tip" else rng.choice(count, 5, replace=False)
        off, roll = np.zeros((2, stops.size, 6))
        off[:, :5] = NOISE * rng.standard_normal((stops.size, 5))
        roll[:, 5] = rng.uniform(-np.pi, np.pi, stops.size)
        values.append(pose[stops] @ se3.exp(off) @ se3.exp(roll))
        time_.append(np.full(stops.size, i))
        place.append(shapes.station[stops])
        used[i, stops] = True
    data = {"time": np.concatenate(time_), "arclength": np.concatenate(place)}
    coil = CoilReadings(**data, values=np.concatenate(values), cov=NOISE**2)
    return coil, used


def cramer_rao(material, shapes, used):
    """Least standard deviations (S, 12) of both wrenches, by differences of the simulator's shapes.

    Readings of the base's pose, the rod and gravity are taken as sure, and wrenches as normal with
    the variance of all of them.
    """
    var = np.concatenate([np.repeat([np.mean(w[:, :3] ** 2), np.mean(w[:, 3:] ** 2)], 3)
                          for w in (shapes.middle, shapes.tip)])  # fmt: skip
    out = []
    for i in range(len(shapes.pose)):
        at = shapes.station[used[i]]
        loads = np.concatenate([shapes.middle[i], shapes.tip[i]])
        here = exact(material, shapes.gravity[i], loads[:6], loads[6:]).at(at).pose
        slope = np.empty((at.size, 5, 12))
        for j, step in enumerate(np.tile(np.repeat([1e-3, 3e-4], 3), 2)):
            moved = loads + step * (np.arange(12) == j)
            there = exact(material, shapes.gravity[i], moved[:6], moved[6:]).at(at).pose
            slope[:, :, j] = se3.log(se3.inverse(here) @ there)[:, :5] / step
        white = (slope / NOISE[:, None]).reshape(-1, 12)
        out.append(np.sqrt(np.diag(np.linalg.inv(white.T @ white + np.diag(1.0 / var)))))
    return np.array(out)


def restarted(material, shapes, coil, spread, i):
    """Both wrenches of shape i (12,), by least squares from the true ones, and two costs.

    They are what is left at the truth and at the minimum, with the spread (12,) that wrenches have.
    """
    seen, place = coil.values[coil.time == i], coil.arclength[coil.time == i]
    back = se3.inverse(seen)

    def residual(part):
        loads = part * spread
        at = back @ exact(material, shapes.gravity[i], loads[:6], loads[6:]).at(place).pose
        lean = np.cross([0.0, 0.0, 1.0], at[:, :3, 2])[:, :2]
        sine = np.linalg.norm(lean, axis=1, keepdims=True)
        lean = lean * np.arctan2(sine, at[:, 2:3, 2]) / np.maximum(sine, 1e-12)
        return np.append(np.hstack([at[:, :3, 3], lean]) / NOISE, part)

    truth = np.concatenate([shapes.middle[i], shapes.tip[i]]) / spread
    found = least_squares(residual, truth, method="lm", diff_step=1e-5)
    return found.x * spread, (0.5 * np.sum(residual(truth) ** 2), found.cost)


def other_minima(material, shapes, coil, used, found, prior, squares):
    """How far the estimate is from the minimum next to the truth, of the shapes farthest off."""
    spread, out = np.sqrt(np.concatenate([prior.var_points[0], prior.var_tip])), []
    for i in np.argsort(squares)[-RESTARTS:]:
        loads, costs = restarted(material, shapes, coil, spread, i)
        place = shapes.station[~used[i]]
        there = exact(material, shapes.gravity[i], loads[:6], loads[6:]).at(place).pose[:, :3, 3]
        off = np.linalg.norm(found.at(place, i).position - there, axis=-1)
        out.append((float(1e3 * off.max()), float(costs[0] - costs[1])))
    return {"farthest_mm": max(m for m, _ in out), "cost_of_truth_above": [c for _, c in out]}


def judge(material, file_shapes, how, *, bound=20):
    """All numbers of one way of reading."""
    half = len(file_shapes.pose) // 2
    learned, judged = file_shapes.take(slice(0, half)), file_shapes.take(slice(half, None))
    few = learned.take(slice(0, None, 5))
    coil, used = read(judged, half, how)
    count = len(judged.pose)
    nodes = np.linspace(0.0, material.length, NODES)
    mechanical = mechanical_prior(material, learned, solver_error(material, few))
    began = time.process_time()
    found = estimate_static(with_gravity(mechanical, judged.gravity), nodes, [coil], count=count)
    seconds = time.process_time() - began
    strain, plain = (
        estimate_static(each, nodes, [coil], count=count) for each in strain_priors(material, few)
    )
    out = {"shapes": count, "readings": how, "seconds": seconds, "strain_prior": BASELINE}
    out |= {"plain_prior": PLAIN, "converged": int(found.converged.sum())}
    for name, posterior in (("plain", plain), ("strain", strain), ("mechanical", found)):
        at = posterior.at(judged.station, np.arange(count)[:, None])
        gap = at.position - judged.pose[..., :3, 3]
        cov = at.cov_position_world + ROUNDING**2 * np.eye(3)
        std = np.sqrt(np.einsum("...ii->...i", cov))[~used]
        nees = np.einsum("...i,...i->...", gap, np.linalg.solve(cov, gap[..., None])[..., 0])
        size = 1e3 * np.linalg.norm(gap, axis=-1)[~used]
        squares = np.sum(np.where(used, 0.0, 1e3 * np.linalg.norm(gap, axis=-1)) ** 2, axis=1)
        beyond = (used * judged.station).max(axis=1) > 0.5 * material.length
        unread = np.sum(~used[beyond])
        out[name] = {
            "share_of_worst_two_shapes": float(np.sort(squares)[-2:].sum() / squares.sum()),
            "rmse_where_read_beyond_half_mm": float(np.sqrt(squares[beyond].sum() / unread)),
            "rmse_mm": float(np.sqrt(np.mean(size**2))),
            "rmse_expected_mm": float(1e3 * np.sqrt(3.0 * np.mean(std**2))),
            "median_mm": float(np.median(size)),
            "components_inside_95": float(np.mean(np.abs(gap[~used]) < SIGMAS * std)),
            "nees": float(np.mean(nees[~used]) / 3.0),
        }
    rest = judged, coil, used, found, mechanical, squares
    out["restarted_from_truth"] = other_minima(material, *rest)
    out["ratio_of_rmse"] = out["mechanical"]["rmse_mm"] / out["strain"]["rmse_mm"]
    out["ratio_of_rmse_plain"] = out["mechanical"]["rmse_mm"] / out["plain"]["rmse_mm"]
    errors, stds = [], []
    for place, truth in ((0.5 * material.length, judged.middle), (material.length, judged.tip)):
        load = found.load(place, np.arange(count), frame="world")
        errors.append(load.wrench - truth)
        stds.append(load.std)
    error, std = np.concatenate(errors, axis=1), np.concatenate(stds, axis=1)
    out["wrench_components_inside_95"] = float(np.mean(np.abs(error) < SIGMAS * std))
    rows = np.linspace(0, count - 1, min(bound, count)).astype(int)
    least = cramer_rao(material, judged.take(rows), used[rows])
    ratio = std[rows] / least
    out["std_over_cramer_rao"] = {
        "median": float(np.median(ratio)),
        "from": float(np.quantile(ratio, 0.05)),
        "to": float(np.quantile(ratio, 0.95)),
    }
    names = ["force x", "force y", "force z", "moment x", "moment y", "moment z"]
    out["wrenches"] = {
        f"{where} {name}": {
            "rmse": float(np.sqrt(np.mean(error[:, 6 * i + j] ** 2))),
            "std": float(np.sqrt(np.mean(std[:, 6 * i + j] ** 2))),
            "inside_95": float(np.mean(np.abs(error[:, 6 * i + j]) < SIGMAS * std[:, 6 * i + j])),
        }
        for i, where in enumerate(("middle", "tip"))
        for j, name in enumerate(names)
    }
    return out


def table(found):
    """The numbers as lines of text."""
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
        f"found again from the truth, the {RESTARTS} shapes farthest off are "
        f"{again['farthest_mm']:.3f} mm from the estimate; the truth's cost is higher by {above}",
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
    parser.add_argument("--readings", choices=("tip", "five"), default="tip")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
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
    main()
