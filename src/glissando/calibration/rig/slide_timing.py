"""The slide against the tracker, by the speeds of carriage and coil; no motion capture needed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.calibration.rig.rig import PARAMETERS, Rig, RigData
from glissando.geometry.se3 import Array

LATEST = 2.0
"""Largest delay between two clocks that is looked for, s."""
_FOUND = [PARAMETERS.index(name) for name in ("lead", "slide delay", "backlash")]
_LAP = 0.1  # s over which speeds are taken
_STEP = 0.025  # s between delays that are tried
_NUDGE = 0.02  # s over which the carriage's speed is differenced
_ROUNDS = 5
_EXACT = 1e-8  # m, standard deviation of a backlash that is known
_CORRELATED = 4.0  # neighbouring speeds that share the noise of a coil reading


def slide_lag(data: RigData) -> float:
    """Delay of the slide's stamps relative to the coil's, s, by correlation of their speeds.

    The coil's speed along its own axis goes with the carriage's. Zero when either is at rest.

    Args:
        data: The session.
    """
    stamps, coil_speed = _coil_speeds(data)
    best = (0.0, 0.0)
    for lag in np.arange(-LATEST, LATEST + 1e-9, _STEP):
        speed = _speeds(data, data.travel, stamps + lag)
        norm = float(np.linalg.norm(speed) * np.linalg.norm(coil_speed))
        if norm > 0.0 and np.ptp(data.travel) > 1e-4:
            best = max(best, (abs(float(speed @ coil_speed)) / norm, float(lag)))
    return best[1]


def against_slide(data: RigData, expected: Rig, std: Array) -> tuple[Rig, Array]:
    """Direction, lead, backlash and slide delay relative to the tracker, by regression of speeds.

    The robot's own motion counts as noise. While the carriage moves at one speed, play looks like a
    late clock: of the backlash what was expected counts as well.

    Args:
        data: The session.
        expected: The rig before calibration.
        std: Standard deviations (17,) of its parameters.

    Returns:
        The rig and its covariance (17, 17), which stays as it was for all other parameters.
    """
    cov, play = np.diag(std**2), expected.backlash
    if not data.slides or np.ptp(data.travel) < 1e-3:
        return expected, cov
    known = np.diag([0.0, 0.0, max(std[_FOUND[2]], _EXACT) ** -2.0])
    lag, gain = slide_lag(data), 0.0
    stamps, coil_speed = _coil_speeds(data)
    for _ in range(_ROUNDS):
        followed = data.travel - 0.5 * play * data.side
        behind, speed, ahead = (
            _speeds(data, followed, stamps + lag + h) for h in (-_NUDGE, 0.0, _NUDGE)
        )
        if not speed @ speed > 0.0:  # the slide rested while the coil was seen
            return expected, cov
        gain = gain or float(speed @ coil_speed / (speed @ speed))
        turned = -0.5 * _speeds(data, data.side, stamps + lag)
        by_lag = (ahead - behind) / (2.0 * _NUDGE)
        jacobian = np.stack([speed, gain * by_lag, gain * turned], axis=1)
        residual = coil_speed - gain * speed
        var = _CORRELATED * float(residual @ residual) / residual.size
        inverse = np.linalg.inv(jacobian.T @ jacobian / var + known)
        pull = jacobian.T @ residual / var - known @ [0.0, 0.0, play - expected.backlash]
        step = inverse @ pull
        gain, lag, play = gain + float(step[0]), lag + float(step[1]), play + float(step[2])
    direction = 1 if gain > 0.0 else -1
    turn = np.diag([direction, 1.0, 1.0])
    cov[np.ix_(_FOUND, _FOUND)] = turn @ inverse @ turn
    clock = np.array([lag, 0.0])
    found = replace(expected, direction=direction, lead=abs(gain), backlash=play, slide_clock=clock)
    return found, cov


def _coil_speeds(data: RigData) -> tuple[Array, Array]:
    """Stamps (P,) of the coil and its speed along its own axis, m/s, in any frame."""
    time, pose = data.coil_time, data.coil
    later = np.searchsorted(time, time + _LAP)
    first = np.flatnonzero(later < time.size)
    first = first[time[later[first]] - time[first] < 2.0 * _LAP]
    last = later[first]
    axis = pose[first, :3, 2] + pose[last, :3, 2]
    way = pose[last, :3, 3] - pose[first, :3, 3]
    norm = np.linalg.norm(axis, axis=1) * (time[last] - time[first])
    return 0.5 * (time[first] + time[last]), np.einsum("mi,mi->m", way, axis) / norm


def _speeds(data: RigData, travel: Array, stamps: Array) -> Array:
    """Change of a travel (L,) a second (P,) at stamps of the slide, over the coil's time."""
    ends = [np.interp(stamps + h, data.slide_time, travel) for h in (-0.5 * _LAP, 0.5 * _LAP)]
    return (ends[1] - ends[0]) / _LAP
