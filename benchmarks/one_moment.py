"""Consistency of static shapes read at the tip only: Gaussian posterior against samples.

Shapes are drawn from the prior of a robot file with [base] and a separable prior; each is estimated
from readings at its tip, by `estimate`, by `estimate_static`, which names shapes of which others
are probable, and by `sample_static`. The table has the share inside 95 % and the NEES per degree of
freedom (1 if consistent), in the middle and at the tip.
Usage: one_moment.py [--robot FILE] [--shapes N] [--draws N]
"""

import argparse
import os
import warnings

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from scipy.stats import chi2

from glissando import (
    CoilReadings,
    Grid,
    PositionReadings,
    estimate,
    estimate_static,
    load_robot,
    sample_static,
)
from glissando.evaluation.prior_predictive import PriorPredictive
from glissando.model.state import State

LAYOUTS = {
    "position": lambda at: PositionReadings(**at, values=np.zeros((1, 3)), cov=1e-6),
    "coil": lambda at: CoilReadings(**at, values=np.eye(4)[None], cov=[1e-6] * 3 + [1e-4] * 2),
}
PARTS = {"position": slice(0, 3), "rotation": slice(3, 6)}


def squared(error, mean, cov):
    """NEES of position and of rotation, for a covariance (6, 6) of both."""
    miss = error[:6] - mean[:6]
    return [miss[p] @ np.linalg.solve(cov[p, p], miss[p]) for p in PARTS.values()]


def of_estimate(at, truth):
    """NEES of position and of rotation, for an estimate and the covariances that it states."""
    miss = at.pose[:3, :3].T @ (truth.pose[:3, 3] - at.position)
    position = miss @ np.linalg.solve(at.position_covariance(), miss)
    error = truth.difference(State(at.pose, at.strain, at.velocity))
    return [position, squared(error, np.zeros(6), at.cov)[1]]


def of_draws(shapes, truth):
    """NEES of position and of rotation, for samples (S,) of the state at a place."""
    first = shapes.take(slice(0, 1))
    apart = shapes.difference(first)[:, :6]
    error = truth.take(np.newaxis).difference(first)[0]
    return squared(error, apart.mean(axis=0), np.cov(apart.T) + 1e-12 * np.eye(6))


def judged(robot, layout, shapes, draws):
    """NEES (shapes, 3 methods, 2 places, 2 parts) of position and rotation; which were named."""
    grid = Grid(robot.arclength_nodes, [0.0])
    predictive = PriorPredictive(robot, grid, [layout])
    rows, named = [], []
    for seed in range(shapes):
        session = predictive.draw(np.random.default_rng([1, seed]))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            posterior = estimate(robot.prior, grid, session.readings)
            static = estimate_static(robot.prior, grid.arclength, session.readings)
        drawn = sample_static(
            robot.prior, grid.arclength, session.readings, size=draws,
            rng=np.random.default_rng(seed),
        )  # fmt: skip
        named.append(0 in static.others)
        row = ([], [], [])
        for n in (grid.arclength.size // 2, grid.arclength.size - 1):
            fine = int(np.argmin(np.abs(predictive.fine.arclength - grid.arclength[n])))
            truth = session.truth.take((0, fine))
            for method, found in enumerate((posterior, static)):
                row[method].append(of_estimate(found.at(grid.arclength[n], 0), truth))
            row[2].append(of_draws(drawn.take((slice(None), n)), truth))
        rows.append(row)
    return np.array(rows), np.array(named)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robot", default="tdcr466-segments")
    parser.add_argument("--shapes", type=int, default=100)
    parser.add_argument("--draws", type=int, default=100)
    options = parser.parse_args()
    robot = load_robot(options.robot)
    print("| read at the tip | | middle, position | rotation | tip, position | rotation |")
    print("|---|---|---|---|---|---|")
    for name, layout in LAYOUTS.items():
        tip = {"time": [0.0], "arclength": [robot.length]}
        errors, named = judged(robot, layout(tip), options.shapes, options.draws)
        first, static, drawn = errors.swapaxes(0, 1)
        rows = {
            "`estimate`": first,
            f"`estimate_static`, {named.sum()} shapes that it names": static[named],
            f"`estimate_static`, the other {(~named).sum()}": static[~named],
            "`sample_static`": drawn,
        }
        for method, each in rows.items():
            if not len(each):
                continue  # with few shapes none may be named
            flat = each.reshape(len(each), -1)
            inside = 100.0 * np.mean(flat <= chi2.ppf(0.95, 3), axis=0)
            nees = flat.mean(axis=0) / 3.0
            cells = (f"{i:.0f} %, {m:.2g}" for i, m in zip(inside, nees, strict=True))
            print(f"| {name} | {method} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
