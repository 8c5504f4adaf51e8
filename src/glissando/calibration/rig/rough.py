"""A rough start: clocks by motion that correlates, the tracker's frame in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glissando.calibration.rig.model import ROWS, Model
from glissando.calibration.rig.rig import Rig, RigData
from glissando.geometry.se3 import Array

LATEST = 2.0  # s: how far clocks are looked for
_STEP = 0.1  # s between delays that are tried
_LAP = 0.1  # s over which speeds are taken
_POINT, _AXIS = 1e-3, 1e-2  # m and rad: how roughly readings should agree
_WEIGHT = np.repeat([_POINT, _AXIS], [3, ROWS - 3])
_WILD = 8.0  # times as far as most
FEWEST = 10
"""Readings with which anything can be found."""


def speeds(data: RigData) -> tuple[Array, Array]:
    """Stamps (P,) of the coil and its speed along its own axis, m/s, whatever the frame."""
    time, pose = data.coil_time, data.coil
    ahead = np.searchsorted(time, time + _LAP)
    pairs = np.flatnonzero(ahead < time.size)
    pairs = pairs[time[ahead[pairs]] - time[pairs] < 2.0 * _LAP]
    there = ahead[pairs]
    axis = pose[pairs, :3, 2] + pose[there, :3, 2]
    way = pose[there, :3, 3] - pose[pairs, :3, 3]
    norm = np.linalg.norm(axis, axis=1) * (time[there] - time[pairs])
    return 0.5 * (time[pairs] + time[there]), np.einsum("mi,mi->m", way, axis) / norm


def driven(data: RigData, stamps: Array) -> Array:
    """Speed (P,) of the carriage at slide stamps, m/s, over the time the coil's is taken."""
    ends = [np.interp(stamps + h, data.slide_time, data.travel) for h in (-0.5 * _LAP, 0.5 * _LAP)]
    return (ends[1] - ends[0]) / _LAP


def slide_lag(data: RigData) -> float:
    """How far slide stamps are ahead of the coil's, s: where their speeds go best together.

    Speed along the coil's own axis goes with that of the carriage. Zero when either rests.
    """
    stamps, along = speeds(data)
    best = (0.0, 0.0)
    for lag in np.arange(-LATEST, LATEST + 1e-9, _STEP / 4.0):
        speed = driven(data, stamps + lag)
        norm = float(np.linalg.norm(speed) * np.linalg.norm(along))
        if norm > 0.0 and np.ptp(data.travel) > 1e-4:
            best = max(best, (abs(float(speed @ along)) / norm, float(lag)))
    return best[1]


def registration(expected: Array, seen: Array) -> Array:
    """T_wt (4, 4) that best takes poses `seen` (M, 4, 4) to `expected`, roll apart.

    Points and axes together, each by its weight: the closed form of Wahba's problem.
    """
    centres = expected[:, :3, 3].mean(axis=0), seen[:, :3, 3].mean(axis=0)
    points = (expected[:, :3, 3] - centres[0]).T @ (seen[:, :3, 3] - centres[1])
    both = points / _POINT**2 + expected[:, :3, 2].T @ seen[:, :3, 2] / _AXIS**2
    u, _, vt = np.linalg.svd(both)
    out = np.eye(4)
    out[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt
    out[:3, 3] = centres[0] - out[:3, :3] @ centres[1]
    return out


def rough_start(model: Model, expected: Rig, lag: float) -> Rig:
    """The rig from which refinement starts, for the direction that is expected.

    Every delay of the tracker's clock within LATEST is tried with the frame that suits it best;
    readings that disagree with what is found are left out, and it is tried again.
    """
    best = _scan(model, expected, lag)
    kept = agreeing(model, best)
    if FEWEST < kept.size < model.data.coil_time.size:
        best = _scan(replace(model, data=model.data.at(kept)), expected, lag)
    return best


def strays(model: Model, rig: Rig) -> Array:
    """How far readings (M,) are from what the rig foretells, 1 being roughly as far as they may."""
    off = model.residual(rig).reshape(-1, ROWS) / _WEIGHT
    return np.asarray(np.linalg.norm(off, axis=1))


def agreeing(model: Model, rig: Rig) -> NDArray[np.intp]:
    """The readings that stray not much farther than most."""
    off = strays(model, rig)
    return np.flatnonzero(off <= _WILD * max(float(np.median(off)), 0.1))


def _scan(model: Model, expected: Rig, lag: float) -> Rig:
    best, least = expected, np.inf
    for delay in np.arange(-LATEST, LATEST + 1e-9, _STEP):
        tracker, slide = np.array([delay, 0.0]), np.array([delay + lag, 0.0])
        rig = replace(expected, tracker_clock=tracker)
        if model.data.slides:
            rig = replace(rig, slide_clock=slide)
        states = model.states(rig)
        rig = replace(rig, T_wt=registration(states.pose, model.data.coil))
        off = model.readings(rig).residual(states) / _WEIGHT
        cost = float(np.mean(np.minimum(off**2, 25.0))) + 1e-6 * delay**2  # the nearest of equals
        if cost < least:
            best, least = rig, cost
    return best
