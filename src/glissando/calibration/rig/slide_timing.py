"""Calibration of the slide against the tracker, by regression of the coil's on the slide's speed.

No motion capture is needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.calibration.rig.rig import PARAMETERS, Rig, RigData
from glissando.geometry.se3 import Array

LATEST = 2.0
"""Largest delay between two clocks in the search, s."""
_FOUND = [PARAMETERS.index(name) for name in ("lead", "slide delay", "backlash")]
_LAP = 0.1  # s over which positions are differenced to speeds
_STEP = 0.025  # s between delays of the search
_NUDGE = 0.02  # s over which the carriage's speed is differenced
_EQUAL = 0.95  # of the largest correlation, above which delays count as equally good
_ROUNDS = 5
_EXACT = 1e-8  # m: standard deviation of a known backlash
_CORRELATED = 4.0  # neighbouring speeds that share the noise of a coil reading
_MEMORY = 10.0  # s over which the robot's own motion is correlated
_FEWEST = 10  # speeds of the coil
_FINEST = 1e-6  # m/s: least standard deviation of the coil's speed
_MOVED = 0.1  # unexplained share of the coil's squared speed above which the robot was moving


def slide_lag(data: RigData) -> float:
    """Delay of the slide's stamps relative to the coil's, s, by correlation of their speeds.

    The coil's speed along its own axis is correlated with the carriage's; the result is zero if
    either is at rest. A periodic motion has several equal peaks: the nearest to zero is returned.

    Args:
        data: The session.
    """
    stamps, coil_speed = _coil_speeds(data)
    if np.ptp(data.travel) <= 1e-4:
        return 0.0
    lags, correlation = np.arange(-LATEST, LATEST + 1e-9, _STEP), []
    for lag in lags:
        speed = _speeds(data, data.travel, stamps + lag)
        norm = float(np.linalg.norm(speed) * np.linalg.norm(coil_speed))
        correlation.append(abs(float(speed @ coil_speed)) / norm if norm > 0.0 else 0.0)
    padded = np.pad(correlation, 1)
    peaks = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:])
    peaks &= np.array(correlation) >= _EQUAL * max(correlation)
    return float(min(lags[peaks], key=abs)) if max(correlation) > 0.0 else 0.0


def against_slide(data: RigData, expected: Rig, std: Array) -> tuple[Rig, Array]:
    """Direction, lead, backlash and slide delay relative to the tracker, by regression of speeds.

    The robot's own motion is treated as noise, whose correlation over seconds is estimated from the
    residuals; the prior is included. At constant speed of the carriage, play cannot be
    distinguished from a delay. If the robot moved much, its motion may resemble a lead or a delay:
    then only the direction and the delay of `slide_lag` are returned, with the prior covariance.

    Source: Newey and West 1987, for the covariance of least squares under correlated noise.

    Args:
        data: The session.
        expected: Prior mean of the rig.
        std: Prior standard deviations (17,).

    Returns:
        The rig and its covariance (17, 17), which is the prior's for all other parameters.
    """
    cov, play = np.diag(std**2), expected.backlash
    if not data.slides or np.ptp(data.travel) < 1e-3:
        return expected, cov
    start = slide_lag(data)
    regressed = _regress_speeds(data, expected, std, start)
    if regressed is None:
        return expected, cov
    (gain, lag, play), inverse, share = regressed
    direction = 1 if gain > 0.0 else -1
    if share > _MOVED:
        gain, lag, play = expected.lead, start, expected.backlash
    else:
        turn = np.diag([direction, 1.0, 1.0])
        cov[np.ix_(_FOUND, _FOUND)] = turn @ inverse @ turn
    clock = np.array([lag, 0.0])
    found = replace(expected, direction=direction, lead=abs(gain), backlash=play, slide_clock=clock)
    return found, cov


def _regress_speeds(
    data: RigData, expected: Rig, std: Array, lag: float
) -> tuple[Array, Array, float] | None:
    """Signed lead, slide delay and backlash (3,), their covariance, and the unexplained share.

    The share is that of the coil's squared speed which is neither the carriage's nor noise. None if
    slide or coil rested, or the coil has too few readings.
    """
    prior_information = np.diag(np.maximum(std[_FOUND], _EXACT) ** -2.0)
    found = np.array([0.0, lag, expected.backlash])
    stamps, coil_speed = _coil_speeds(data)
    if stamps.size < _FEWEST or not coil_speed @ coil_speed > 0.0:
        return None
    for _ in range(_ROUNDS):
        gain, lag, play = found
        followed = data.travel - 0.5 * play * data.side
        behind, speed, ahead = (
            _speeds(data, followed, stamps + lag + h) for h in (-_NUDGE, 0.0, _NUDGE)
        )
        if not speed @ speed > 0.0:
            return None
        found[0] = gain = gain or float(speed @ coil_speed / (speed @ speed))
        by_play = -0.5 * _speeds(data, data.side, stamps + lag)
        by_lag = (ahead - behind) / (2.0 * _NUDGE)
        jacobian = np.stack([speed, gain * by_lag, gain * by_play], axis=1)
        residual = coil_speed - gain * speed
        information, rhs = _information(stamps, jacobian, residual)
        inverse = np.linalg.inv(information + prior_information)
        deviation = found - [np.copysign(expected.lead, gain), 0.0, expected.backlash]
        found = found + inverse @ (rhs - prior_information @ deviation)
    white = 2.0 * residual.size * (_noise(data) / _LAP) ** 2
    share = max(float(residual @ residual) - white, 0.0) / float(coil_speed @ coil_speed)
    return found, np.asarray(inverse, dtype=np.float64), share


def _noise(data: RigData) -> float:
    """Standard deviation of the white noise of the coil's position along its axis, m."""
    place, axis = data.coil[:, :3, 3], data.coil[1:-1, :3, 2]
    kinks = np.einsum("mi,mi->m", place[2:] - 2.0 * place[1:-1] + place[:-2], axis)
    return float(np.median(np.abs(kinks)) / 0.6745 / 6.0**0.5)


def _information(time: Array, jacobian: Array, residual: Array) -> tuple[Array, Array]:
    """Robust information (3, 3) of residuals (P,) at times, and its product with their step (3,).

    The covariance of least squares is Newey and West's: products of residuals and Jacobians are
    summed over pairs, with weights that fall linearly to zero at the lag `_MEMORY`. For short
    recordings the sums are biased low and scaled up by duration / (duration − `_MEMORY`). The noise
    of readings, shared by neighbouring speeds, is added.
    """
    normal, scores = jacobian.T @ jacobian, jacobian * residual[:, None]
    step = float(np.median(np.diff(time)))
    var = max(float(residual @ residual) / residual.size, _FINEST**2)
    duration = float(np.ptp(time))
    bias_correction = duration / max(duration - _MEMORY, 0.1 * duration)
    score_cov = _CORRELATED * var * normal + bias_correction * scores.T @ scores
    for k in range(1, min(int(_MEMORY / step), len(time) - 1) + 1):
        pair = scores[k:].T @ scores[:-k]
        score_cov += bias_correction * (1.0 - k * step / _MEMORY) * (pair + pair.T)
    information = normal @ np.linalg.pinv(score_cov, hermitian=True) @ normal
    return information, information @ np.linalg.pinv(normal, hermitian=True) @ jacobian.T @ residual


def _coil_speeds(data: RigData) -> tuple[Array, Array]:
    """Stamps (P,) and speeds of the coil along its own axis, m/s; independent of the frame."""
    time, pose = data.coil_time, data.coil
    later = np.searchsorted(time, time + _LAP)
    first = np.flatnonzero(later < time.size)
    first = first[time[later[first]] - time[first] < 2.0 * _LAP]
    last = later[first]
    axis = pose[first, :3, 2] + pose[last, :3, 2]
    displacement = pose[last, :3, 3] - pose[first, :3, 3]
    norm = np.linalg.norm(axis, axis=1) * (time[last] - time[first])
    return 0.5 * (time[first] + time[last]), np.einsum("mi,mi->m", displacement, axis) / norm


def _speeds(data: RigData, travel: Array, stamps: Array) -> Array:
    """Rates (P,) of a travel (L,) at stamps of the slide, differenced over `_LAP`."""
    ends = [np.interp(stamps + h, data.slide_time, travel) for h in (-0.5 * _LAP, 0.5 * _LAP)]
    return (ends[1] - ends[0]) / _LAP
