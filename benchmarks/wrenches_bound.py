"""Bounds on estimates of a rod's wrenches: Cramér–Rao bounds, and least squares from the truth."""

import time

import numpy as np
from scipy.optimize import least_squares

from glissando.geometry import se3
from wrenches_problem import NOISE, equilibrium, exact

RESTARTS = 5  # shapes with the largest errors, which are solved again from the truth


def cramer_rao(material, shapes, used):
    """Lower bounds of the standard deviations (S, 12) of both wrenches, and of positions (S, M), m.

    Computed by finite differences of the simulator's shapes at the truth. The base's pose, the rod
    and gravity are taken as known, and wrenches as normal with the variance over all shapes: the
    van Trees bound. The bound of a position is the root of its least mean squared error.
    """
    var = np.concatenate([np.repeat([np.mean(w[:, :3] ** 2), np.mean(w[:, 3:] ** 2)], 3)
                          for w in (shapes.middle, shapes.tip)])  # fmt: skip
    steps = np.tile(np.repeat([1e-3, 3e-4], 3), 2)
    wrenches, places = [], []
    for i in range(len(shapes.pose)):
        loads = np.concatenate([shapes.middle[i], shapes.tip[i]])
        truth, gravity = equilibrium(material, shapes, i), shapes.gravity[i]
        true_pose, *moved = (
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
            [se3.log(se3.inverse(true_pose) @ m) / h for m, h in zip(moved, steps, strict=True)], -1
        )
        white = (slope[used[i], :5] / NOISE[:, None]).reshape(-1, 12)
        cov = np.linalg.inv(white.T @ white + np.diag(1.0 / var))
        wrenches.append(np.sqrt(np.diag(cov)))
        places.append(np.sqrt(np.einsum("mij,jk,mik->m", slope[:, :3], cov, slope[:, :3])))
    return np.array(wrenches), np.array(places)


def least_squares_fit(material, shapes, coil, spread, i, *, from_truth):
    """Both wrenches of shape i (12,) by least squares on the simulator's shapes, and two costs.

    The initial guess is the true wrenches or zero. The costs are those at the truth and at the
    minimum, with a prior of standard deviations `spread` (12,) on the wrenches.
    """
    measured, place = coil.values[coil.time == i], coil.arclength[coil.time == i]
    back, near = se3.inverse(measured), equilibrium(material, shapes, i) if from_truth else None

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
    """Distance of the estimate from the minimum next to the truth, for the largest errors."""
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
