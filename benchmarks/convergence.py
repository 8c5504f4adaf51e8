"""Convergence of estimates from three initial guesses, two of them far from the solution.

A robot moves at random: each third of it bends by up to 60 degrees, smoothly in time and
independently of its prior. Its sensors have the noise that its robot file states. Estimates start
from rest, from a robot wound by a quarter to half a turn about a random axis, and from another
random motion. Two estimates are equal if no point of the body differs by more than half its
standard deviation.
Usage: convergence.py [--robot FILE|NAME ...] [--problems N] [--seed N] [--json]
"""

import argparse
import json
import os
import warnings
from collections import Counter
from functools import partial
from multiprocessing import get_context
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando import NotConvergedWarning, State, estimate, load_robot, se3
from glissando.errors import SensorError, UnobservableError
from glissando.evaluation.prior_predictive import noisy_values, session_layout

ROBOTS = ("sliding700", "tdcr466-segments", "tdcr466", "extensible1m")
STARTS = ("rest", "wound", "another motion")
ALIKE = 0.5  # standard deviations: largest difference of equal estimates
THIRDS, BEND, TWIST = 3, np.radians(60.0), np.radians(10.0)  # largest angles of each third
NODES_A_CYCLE = 30  # time nodes per cycle of the fastest motion
PIECES, NUDGE = 60, 1e-4  # steps of the integration along the robot; s for velocities


class Motion:
    """Smooth random motion of a robot on a fixed base."""

    def __init__(self, robot, rng):
        size = (THIRDS, 3)
        self.length, self.base = robot.length, robot.prior.rest_state(robot.grid(0, 1)).pose[0, 0]
        most = np.array([BEND, BEND, TWIST]) * THIRDS / robot.length
        self.mean, self.swing = 0.5 * most * rng.uniform(-1.0, 1.0, (2, *size))
        self.rate, self.phase = rng.uniform(0.0, 2.0 * np.pi, (2, *size))
        self.rate *= robot.time_rate / NODES_A_CYCLE

    def strain(self, place, time):
        """Strains (M, 6) at arclengths and times (M,)."""
        third = np.minimum(place / self.length * THIRDS, THIRDS - 1).astype(int)
        wave = np.sin(self.rate[third] * time[:, None] + self.phase[third])
        turn = self.mean[third] + self.swing[third] * wave
        return np.concatenate([np.tile([0.0, 0.0, 1.0], (time.size, 1)), turn], axis=1)

    def pose(self, place, time):
        """Poses (M, 4, 4) at arclengths and times (M,)."""
        pose = np.tile(self.base, (time.size, 1, 1))
        step = place / PIECES
        for i in range(PIECES):
            pose = pose @ se3.exp(step[:, None] * self.strain((i + 0.5) * step, time))
        return pose

    def at(self, place, time):
        """States (M,) at arclengths and times (M,)."""
        pose, later = self.pose(place, time), self.pose(place, time + NUDGE)
        velocity = se3.log(se3.inverse(pose) @ later) / NUDGE
        return State(pose, self.strain(place, time), velocity)


def wound(robot, grid, rng):
    """Rest shape of the robot, uniformly bent and twisted by a quarter to half a turn in total."""
    axis = rng.standard_normal(3)
    turn = rng.uniform(0.5, 1.0) * np.pi * axis / np.linalg.norm(axis)
    rest = robot.prior.rest_state(grid)
    step = np.zeros((*grid.shape, rest.dof))
    step[..., 9:12] = turn / robot.length
    return robot.prior.retract_strains(grid, rest, step)


def on_nodes(motion, grid):
    """States of a motion at the nodes (K, N)."""
    place, time = np.tile(grid.arclength, grid.time.size), np.repeat(grid.time, grid.arclength.size)
    return motion.at(place, time).reshape(*grid.shape)


def solved(robot, grid, readings, start):
    """Posterior from an initial guess, or the message of the error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotConvergedWarning)
        try:
            return estimate(robot.prior, grid, readings, initial=start,
                            sensor_parameters=robot.sensor_parameters)  # fmt: skip
        except (UnobservableError, SensorError, np.linalg.LinAlgError) as problem:
            return str(problem)


def row(posterior, best):
    """Comparison of an estimate with the one of least cost for the same problem."""
    if isinstance(posterior, str):
        return {"end": "refused", "why": posterior}
    off = np.linalg.norm((posterior.state.pose - best.state.pose)[..., :3, 3], axis=-1)
    std = np.linalg.norm(best.std_pose()[..., :3], axis=-1)
    most = float((off / std).max())
    solve = posterior.solve
    end = "alike" if most <= ALIKE else "elsewhere"
    return {"end": end if solve.converged else f"{end}, not converged", "std off": most,
            "iterations": solve.iterations, "cost above": solve.cost - best.solve.cost,
            "refused": {name: len(rows) for name, rows in solve.refused.items()}}  # fmt: skip


def judged(name, seed, number):
    """Result of one problem from each initial guess."""
    robot = load_robot(name)
    grid, layout = session_layout(robot)
    rng = np.random.default_rng([seed, number])
    motion, other = Motion(robot, rng), Motion(robot, rng)
    readings = [
        r.changed(values=noisy_values(r, motion.at(r.arclength, r.time), rng)) for r in layout
    ]
    starts = (None, wound(robot, grid, rng), on_nodes(other, grid))
    ends = [solved(robot, grid, readings, start) for start in starts]
    best = min((p for p in ends if not isinstance(p, str)), key=lambda p: p.solve.cost)
    return {"problem": number} | {s: row(p, best) for s, p in zip(STARTS, ends, strict=True)}


def main():
    """Print a row per robot and initial guess, or JSON of all problems."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--robot", nargs="+", default=ROBOTS, metavar="FILE|NAME")
    parser.add_argument("--problems", type=int, default=250, help="of each robot")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    every = {}
    with get_context("spawn").Pool(os.cpu_count()) as pool:
        for name in options.robot:
            each = partial(judged, name, options.seed)
            rows = every[name] = pool.map(each, range(options.problems), 5)
            for start in STARTS if not options.json else ():
                ends = Counter(r[start]["end"] for r in rows)
                most = max(r[start].get("iterations", 0) for r in rows)
                words = ", ".join(f"{count} {end}" for end, count in ends.most_common())
                print(f"| {Path(name).stem} | {start} | {words} | {most} |", flush=True)
    if options.json:
        print(json.dumps(every))


if __name__ == "__main__":
    main()
