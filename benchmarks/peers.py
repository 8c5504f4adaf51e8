"""Static shapes against GTSAM and curves: accuracy, confidence and time; writes the page.

A robot is read in a few places; its position between them is predicted. Shapes are another group's
(a steel rod, base fixed, four poses read) and a real robot's (base and tip read by a tracker,
motion capture between them). Ours and GTSAM's each have a uniform prior, whose numbers maximise
their own likelihood of the truth of other shapes. One thread; times of ours and GTSAM's alternate
in one process and include everything from arrays of readings to mean and covariance at the queries.
Usage: peers.py [--tune]   (--tune fits the numbers again first, in a few minutes)
"""

import argparse
import os
import time
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

import peers_curves
import peers_gtsam
import shapes
from glissando import BaseVariance, PoseReadings, SeparablePrior, estimate_static, load_robot
from glissando.errors import GlissandoError
from glissando.io.robot_file import parse_robot
from glissando.model.table import Table
from glissando.solver.gauss_newton import SolverOptions
from peers_page import TEXT, draw, ratios
from peers_problems import REPORTED_ON, ROD_NOISE, TUNED_ON, Numbers

EACH = 100  # shapes solved together where time is measured


# Parameters for growing grids: soft in shear, so that GTSAM can factor dense ones.
COMMON = [-3.0, 0.0, -0.5, -3.0, 1.3, 0.0, *ROD_NOISE]
# Found by --tune, rounded: decimal logarithms of the numbers, ours and GTSAM's.
TUNED = {
    "steel rod": [
        [-9.0, -0.27, -0.5, -9.0, 4.78, 0.0, -3.15, -2.16],
        [-7.0, 0.02, -0.5, -7.0, 2.3, 0.0, -3.15, -2.16],
    ],
    "real robot": [
        [-7.85, 0.94, -0.5, -7.85, 0.72, 0.0, -2.48, -1.05],
        [-4.83, 1.85, -0.5, -4.83, -0.44, 0.0, -2.49, -2.01],
    ],
}


def uniform(problem, numbers):
    """Our uniform prior, with the parameters that GTSAM's has."""
    base_std = problem.base_std or 10.0  # a base that is read has no other prior
    base = BaseVariance(np.full(6, base_std**2), numbers.base_strain)
    return SeparablePrior(numbers.psd, 1.0, base, base_pose=problem.base_pose)


def ours(problem, numbers, nodes=None, prior=None, options=None):
    """Positions (M, 3) at the queries with covariances (M, 3, 3), in the world."""
    poses = PoseReadings(
        time=problem.reading_shape,
        arclength=problem.reading_arclength,
        values=problem.reading_pose,
        cov=numbers.noise**2,
    )
    found = estimate_static(
        prior or uniform(problem, numbers),
        problem.nodes if nodes is None else nodes,
        [poses],
        count=problem.count,
        options=options,
    )
    at = found.at(problem.query_arclength, problem.query_shape)
    return at.position, at.cov_position_world


def judged(problem, place, cov=None):
    """Median error and RMSE (mm), and the share inside the 95 % ellipsoid, None without `cov`."""
    error = place - problem.query_position
    size = 1e3 * np.linalg.norm(error, axis=1)
    row = {"median": np.median(size), "rmse": np.sqrt(np.mean(size**2)), "inside": None}
    if cov is not None:
        row["inside"] = np.mean(surprise(problem, error, cov)[0] <= chi2.ppf(0.95, 3))
    return row


def surprise(problem, error, cov):
    """NEES (M,) of errors, truth noise included, and log-determinants (M,) of the covariance."""
    cov = cov + problem.true_std**2 * np.eye(3)
    nees = np.einsum("mi,mi->m", error, np.linalg.solve(cov, error[..., None])[..., 0])
    return nees, np.linalg.slogdet(cov)[1]


def tuned(name, solve, stiffest):
    """Decimal logarithms of the numbers that maximise the likelihood of the truth under `solve`.

    Free are the densities of shear and of bending, the variance of the base's bending, and the
    noise of a real tracker; torsion is hardly observable.
    """
    problem = TUNED_ON[name]()
    start = np.array([-5.0, 0.0, -0.5, -5.0, 1.3, 0.0, *ROD_NOISE])
    free = [0, 1, 4] if name == "steel rod" else [0, 1, 4, 6, 7]

    def logs_of(x):
        logs = start.copy()
        logs[free] = x
        logs[3] = logs[0]  # shear at the base is as stiff as along the body
        return logs

    def cost(x):
        if x[0] < stiffest:
            return 1e9
        try:
            place, cov = solve(problem, Numbers.of(logs_of(x)))
        except (GlissandoError, RuntimeError):
            return 1e9
        return float(np.sum(surprise(problem, place - problem.query_position, cov)))

    simplex = np.vstack([start[free], start[free] + 0.7 * np.eye(len(free))])
    options = {"maxfev": 40 * len(free), "initial_simplex": simplex, "fatol": 0.3, "xatol": 0.02}
    found = minimize(cost, start[free], method="Nelder-Mead", options=options)
    return logs_of(found.x).round(2).tolist()


# Smallest densities of shear (decimal logarithms) without loss of precision: GTSAM cannot factor
# some shapes at −7.5; results of ours do not change below.
STIFFEST = ((ours, -9.0), (peers_gtsam.solve, -7.0))


def segmented(problem):
    """Prior with segments: learned on other rods, or that of the real robot's shipped file."""
    if problem.name == "steel rod":
        robot = parse_robot(Table(shapes.LEARNED, "steel rod", GlissandoError))
        return replace(robot.prior, base_pose=problem.base_pose)
    prior = load_robot("tdcr466-segments").prior
    base = BaseVariance(np.full(6, 100.0), prior.base.strain)
    return replace(prior, base=base, base_pose=problem.base_pose)


def methods(problem):
    """Names and solvers of all methods compared on a problem; curves have no covariance."""
    our_numbers, their_numbers = (Numbers.of(logs) for logs in TUNED[problem.name])
    jointed = segmented(problem)
    nodes = np.union1d(problem.nodes, jointed.joints)
    out = {
        "**ours**": lambda p: ours(p, our_numbers),
        "**ours**, a prior of segments": lambda p: ours(p, our_numbers, nodes, jointed),
    }
    out["GTSAM, WNOA on SE(3)"] = lambda p: peers_gtsam.solve(p, their_numbers)
    for name in peers_curves.CURVES:
        out[name] = lambda p, name=name: (peers_curves.solve(p, name), None)
    return out


def accuracy(problem):
    """Accuracy of every method on a problem, by name."""
    return {name: judged(problem, *solve(problem)) for name, solve in methods(problem).items()}


def accuracy_row(name, row):
    """Row of the table of accuracy without its last cell, the time."""
    inside = "" if row["inside"] is None else f"{100 * row['inside']:.1f} %"
    return f"| {name} | {row['rmse']:.2f} | {row['median']:.2f} | {inside} |"


def timed(solvers, problem, rounds):
    """Milliseconds of processor time per shape, by name: medians of rounds with all in turn."""
    seconds = {name: [] for name in solvers}
    for _ in range(rounds):
        for name, solve in solvers.items():
            began = time.process_time()
            solve(problem)
            seconds[name].append(time.process_time() - began)
    return {name: 1e3 * float(np.median(s)) / problem.count for name, s in seconds.items()}


def refinements(problem):
    """Ours and GTSAM's on growing grids with equal parameters."""
    numbers = Numbers.of(np.array(COMMON))
    out = {
        ("ours", problem.nodes.size): lambda p: ours(p, numbers),
        ("ours", problem.stations.size): lambda p: ours(p, numbers, p.stations),
    }
    for times in range(4):
        count = peers_gtsam.refine(problem.stations, times).size
        out["GTSAM", count] = lambda p, times=times: peers_gtsam.solve(p, numbers, times)
    return out


def distances(problem):
    """Largest difference of each grid's result from the limit, of means (mm) and of std (%)."""
    numbers, exact = Numbers.of(np.array(COMMON)), SolverOptions(tolerance=1e-6)
    fine = peers_gtsam.refine(problem.stations, 2)
    place, cov = ours(problem, numbers, fine, options=exact)
    std = np.sqrt(np.einsum("mii->mi", cov))
    out = {}
    for key, solve in refinements(problem).items():
        found, spread = solve(problem)
        far = np.sqrt(np.einsum("mii->mi", spread)) / std - 1.0
        out[key] = 1e3 * np.abs(found - place).max(), 1e2 * np.abs(far).max()
    return out


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tune", action="store_true", help="find the priors' numbers again first")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--page", type=Path, default=Path("docs/peers.md"))
    options = parser.parse_args()
    if options.tune:
        for name in TUNED_ON:
            TUNED[name] = [tuned(name, *each) for each in STIFFEST]
        print("TUNED =", TUNED)
    problems = {name: make() for name, make in REPORTED_ON.items()}
    rods, real = problems.values()
    few = rods.first(EACH)
    far = distances(few)
    times = timed(refinements(few), few, options.rounds)
    refinement = [
        f"| {who} | {nodes} | {far[who, nodes][0]:.1e} | {far[who, nodes][1]:.2g} % | "
        f"{times[who, nodes]:.2f} |"
        for who, nodes in far
    ]
    tables = {name: accuracy(problem) for name, problem in problems.items()}
    rows = {}
    for name, problem in problems.items():
        first = problem.first(EACH)
        took = timed(methods(first), first, options.rounds)
        rows[name] = [
            f"{accuracy_row(method, row)} {took[method]:.2f} |"
            for method, row in tables[name].items()
        ]
    draw(options.page.with_suffix(".png"), tables, far, times)
    options.page.write_text(
        TEXT.format(
            gtsam=version("gtsam"),
            each=EACH,
            read=", ".join(f"{s:.3g}" for s in rods.nodes[1:]),
            refinement="\n".join(refinement),
            ratios=ratios(far, times, EACH),
            rods=rods.count,
            asked=rods.query_shape.size // rods.count,
            steel="\n".join(rows["steel rod"]),
            moments=real.count,
            real="\n".join(rows["real robot"]),
        )
    )
    print(options.page.read_text())


if __name__ == "__main__":
    main()
