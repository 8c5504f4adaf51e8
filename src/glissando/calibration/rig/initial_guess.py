"""Initial guess of a rig: the tracker's delay by search, its frame in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glissando.calibration.rig.model import ROWS, CoilModel
from glissando.calibration.rig.rig import Rig
from glissando.calibration.rig.slide_timing import LATEST
from glissando.geometry import se3
from glissando.geometry.se3 import Array

FEWEST = 10
"""Minimum number of readings for a calibration."""
_STEP = 0.1  # s between delays that are tried
_POINT, _AXIS = 1e-3, 1e-2  # m and rad: scales of residuals
_SCALE = np.repeat([_POINT, _AXIS], [3, ROWS - 3])
_OUTLIER = 8.0  # times the median distance


def registration(expected: Array, measured: Array) -> Array:
    """Least-squares registration of measured to expected poses, independent of their roll.

    Positions and z axes are weighted jointly; the rotation solves Wahba's problem in closed form.

    Args:
        expected: Poses in the world (M, 4, 4).
        measured: Poses in the tracker's frame (M, 4, 4).

    Returns:
        Pose T_wt (4, 4) of the tracker in the world.
    """
    centres = expected[:, :3, 3].mean(axis=0), measured[:, :3, 3].mean(axis=0)
    points = (expected[:, :3, 3] - centres[0]).T @ (measured[:, :3, 3] - centres[1])
    both = points / _POINT**2 + expected[:, :3, 2].T @ measured[:, :3, 2] / _AXIS**2
    u, _, vt = np.linalg.svd(both)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt
    return se3.pose(rotation, centres[0] - rotation @ centres[1])


def rough_start(model: CoilModel, expected: Rig, lag: float) -> Rig:
    """Initial guess of the rig, in the expected rig's direction.

    Each delay of the tracker within LATEST is tried with its best-fitting frame. Outliers of the
    result are removed, and the search is repeated.

    Args:
        model: The coil's readings against the shape.
        expected: Prior mean of the rig.
        lag: Delay of the slide's stamps relative to the tracker's, s.
    """
    best = _search(model, expected, lag)
    agreed = inliers(model, best)
    if FEWEST < agreed.size < model.data.coil_time.size:
        best = _search(replace(model, data=model.data.at(agreed)), expected, lag)
    return best


def distances(model: CoilModel, rig: Rig) -> Array:
    """Norms (M,) of the coarsely scaled residuals of the readings."""
    residual = model.residual(rig).reshape(-1, ROWS) / _SCALE
    return np.asarray(np.linalg.norm(residual, axis=1))


def inliers(model: CoilModel, rig: Rig) -> NDArray[np.intp]:
    """Indices of the readings whose distance is below `_OUTLIER` times the median."""
    distance = distances(model, rig)
    return np.flatnonzero(distance <= _OUTLIER * max(float(np.median(distance)), 0.1))


def _search(model: CoilModel, expected: Rig, lag: float) -> Rig:
    """Best rig over a grid of tracker delays; the states of all delays are computed in a batch."""
    delays = np.arange(-LATEST, LATEST + 1e-9, _STEP)
    rigs = [replace(expected, tracker_clock=np.array([delay, 0.0])) for delay in delays]
    if model.data.slides:
        rigs = [replace(rig, slide_clock=np.array([lag, 0.0]) + rig.tracker_clock) for rig in rigs]
    points = [model.points(rig) for rig in rigs]
    arclength, time = (np.concatenate(axis) for axis in zip(*points, strict=True))
    states = model.states(arclength, time).reshape(len(rigs), -1)
    best, least = expected, np.inf
    for k, (rig, delay) in enumerate(zip(rigs, delays, strict=True)):
        at = states.take(k)
        predicted = at.pose @ model.readings(rig).mount
        rig = replace(rig, T_wt=registration(predicted, model.data.coil))
        residual = model.readings(rig).residual(at) / _SCALE
        cost = float(np.mean(np.minimum(residual**2, 25.0))) + 1e-6 * delay**2  # breaks ties
        if cost < least:
            best, least = rig, cost
    return best
