"""What can be known of a rod's wrenches at best: Cramér–Rao bounds, and search from the truth."""

import time

import numpy as np
from scipy.optimize import least_squares

from glissando.geometry import se3
from wrenches_problem import NOISE, equilibrium, exact

RESTARTS = 5  # of the shapes that are farthest off, which are found again from the truth


def cramer_rao(material, shapes, used):
    """Least standard deviations (S, 12) of both wrenches, and of positions (S, M), m.

    By differences of the simulator's shapes at the truth. Readings of the base's pose, the rod and
    gravity are taken as sure, and wrenches as normal with the variance of all of them: the bound of
    van Trees. A position's is the root of its squared error's least mean.
    """
    var = np.concatenate([np.repeat([np.mean(w[:, :3] ** 2), np.mean(w[:, 3:] ** 2)], 3)
                          for w in (shapes.middle, shapes.tip)])  # fmt: skip
    steps = np.tile(np.repeat([1e-3, 3e-4], 3), 2)
    wrenches, places = [], []
    for i in range(len(shapes.pose)):
        loads = np.concatenate([shapes.middle[i], shapes.tip[i]])
        truth, gravity = equilibrium(material, shapes, i), shapes.gravity[i]
        here, *moved = (
            shape.at(shapes.station).pose
            for shape in [
                truth,
                *(
                    exact(material, gravity, each[:6], each[6:], truth)
                    for each in loads + np.diag(steps)
                ),
            ]
        )
        slope = np.stack(
            [se3.log(se3.inverse(here) @ m) / h for m, h in zip(moved, steps, strict=True)], -1
        )
        white = (slope[used[i], :5] / NOISE[:, None]).reshape(-1, 12)
        cov = np.linalg.inv(white.T @ white + np.diag(1.0 / var))
        wrenches.append(np.sqrt(np.diag(cov)))
        places.append(np.sqrt(np.einsum("mij,jk,mik->m", slope[:, :3], cov, slope[:, :3])))
    return np.array(wrenches), np.array(places)


def least_squares_fit(material, shapes, coil, spread, i, *, from_truth):
    """Both wrenches of shape i (12,) by least squares on the simulator's shapes, and two costs.

    The search begins at the true wrenches or at none. The costs are what is left at the truth and
    at the minimum, with the spread (12,) that wrenches have.
    """
    seen, place = coil.values[coil.time == i], coil.arclength[coil.time == i]
    back, near = se3.inverse(seen), equilibrium(material, shapes, i) if from_truth else None

    def residual(part):
        loads = part * spread
        shape = exact(material, shapes.gravity[i], loads[:6], loads[6:], near)
        at = back @ shape.at(place).pose
        lean = np.cross([0.0, 0.0, 1.0], at[:, :3, 2])[:, :2]
        sine = np.linalg.norm(lean, axis=1, keepdims=True)
        lean = lean * np.arctan2(sine, at[:, 2:3, 2]) / np.maximum(sine, 1e-12)
        return np.append(np.hstack([at[:, :3, 3], lean]) / NOISE, part)

    truth = np.concatenate([shapes.middle[i], shapes.tip[i]]) / spread
    start = truth if from_truth else np.zeros(12)
    found = least_squares(residual, start, method="lm", diff_step=1e-5)
    return found.x * spread, (0.5 * np.sum(residual(truth) ** 2), found.cost)


def other_minima(material, shapes, coil, used, found, prior, squares):
    """How far the estimate is from the minimum next to the truth, of the shapes farthest off."""
    spread, out = np.sqrt(np.concatenate([prior.var_points[0], prior.var_tip])), []
    began = time.process_time()
    for i in np.argsort(squares)[-RESTARTS:]:
        loads, costs = least_squares_fit(material, shapes, coil, spread, i, from_truth=True)
        place = shapes.station[~used[i]]
        near = equilibrium(material, shapes, i)
        shape = exact(material, shapes.gravity[i], loads[:6], loads[6:], near)
        there = shape.at(place).pose[:, :3, 3]
        off = np.linalg.norm(found.at(place, i).position - there, axis=-1)
        out.append((float(1e3 * off.max()), float(costs[0] - costs[1])))
    return {
        "farthest_mm": max(m for m, _ in out),
        "cost_of_truth_above": [c for _, c in out],
        "seconds_each": (time.process_time() - began) / len(out),
    }
