"""The slide's encoder against a motion capture body on the sliding tube.

The body moves along a line with the tube. It determines scale, play and delay of the encoder
without the robot's shape, the tracker or the coil, and is an independent check of the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.calibration.rig.rig import PARAMETERS, Rig, RigData
from glissando.calibration.rig.slide_timing import LATEST
from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.model.short_repr import ShortRepr
from glissando.model.slide_track import side_of_play

_RATE = 1e-4  # prior standard deviation of a crystal's rate [inferred]
_STEP = 0.025  # s between delays of the initial search
_NUDGE = 1e-4  # s over which the carriage's speed is differenced
_LEAST_PLAY = 1e-6  # m: smallest play for which the side is computed
_ROUNDS = 8
_OUTLYING = 5.0  # robust standard deviations above which a residual is an outlier
_FEWEST, _NO_TRAVEL = 50, 5e-3  # readings; m of travel below which the fit is impossible
_DISAGREE = 4.0  # standard deviations
_SLIPS = 3.0  # RMS residual, over the noise of motion capture, above which a warning is given
_SAME = {"lead scale": "lead", "slide's delay": "slide delay"}


@dataclass(frozen=True)
class SlideFit(ShortRepr):
    """Constants of the slide, estimated from the motion of a body on the sliding tube.

    Attributes:
        name: Name of the body.
        lead: Metres of motion of the body per metre of travel.
        backlash: Play between encoder and body, m.
        delay: Delay of the slide's stamps relative to motion capture's, at the rig's epoch, s.
        cov: Covariance (3, 3) of lead, backlash and delay.
        along: RMS residual along the body's line, m.
        across: RMS distance from that line, by which the tube bends and wobbles, m.
    """

    name: str
    lead: float
    backlash: float
    delay: float
    cov: Array
    along: float
    across: float

    def displayed(self) -> list[tuple[str, float, float, str]]:
        """Name, value, standard deviation and unit of lead, play and delay."""
        std = np.sqrt(self.cov.diagonal())
        rows = (
            ("lead", self.lead, 1.0, "1"),
            ("play", self.backlash, 1e3, "mm"),
            ("slide delay", self.delay, 1e3, "ms"),
        )
        return [
            (name, size * value, float(size * s), unit)
            for (name, value, size, unit), s in zip(rows, std, strict=True)
        ]


def fit_slide(data: RigData) -> SlideFit | None:
    """Estimate scale, play and delay of the slide's encoder; None without a body on the tube.

    Gauss–Newton on d = c + lead · (travel less play), interpolated at the slide's stamp of each
    sample, where d is the body's coordinate along its line of motion.

    Args:
        data: The session.

    Raises:
        RecordingError: The body has too few samples, or the slide hardly moved.
    """
    body = data.tube
    if body is None or not data.slides:
        return None
    epoch = 0.5 * float(data.coil_time[0] + data.coil_time[-1])
    inside = (body.time > data.slide_time[0] + LATEST) & (body.time < data.slide_time[-1] - LATEST)
    time, place = body.time[inside], body.poses[inside, :3, 3]
    moved = float(np.ptp(data.travel))
    if time.size < _FEWEST or moved < _NO_TRAVEL:
        raise RecordingError(
            f"The body {body.name!r} on the tube was seen {time.size} times while the slide moved "
            f"{1e3 * moved:.3g} mm; show it longer, and slide over the stroke."
        )
    middle, axis = _line(place)
    along = (place - middle) @ axis
    theta = _initial_parameters(data, time, along, epoch)
    if theta[1] < 0.0:
        axis, along, theta = -axis, -along, theta * [-1, -1, 1, 1, 1]
    theta, cov, inlying = _refine(data, time, along, epoch, theta)
    lateral = (place - middle)[inlying] - np.outer(along[inlying], axis)
    residual = along[inlying] - _predicted(data, time[inlying], epoch, theta)
    rms = [float(np.sqrt(np.mean(x**2))) for x in (residual, np.linalg.norm(lateral, axis=1))]
    lead, backlash, delay = (float(x) for x in theta[1:4])
    return SlideFit(body.name, lead, backlash, delay, cov[1:4, 1:4], rms[0], rms[1])


def judgement(fit: SlideFit, rig: Rig, cov: Array, data: RigData) -> tuple[str, ...]:
    """Warnings on contradictions between the body on the tube and the calibration by the coil.

    Args:
        fit: Slide constants from the body.
        rig: Calibrated rig.
        cov: Covariance (17, 17) of the rig.
        data: The session.
    """
    out = []
    by_body = {"lead scale": (fit.lead, fit.cov[0, 0]), "slide's delay": (fit.delay, fit.cov[2, 2])}
    by_coil = {"lead scale": rig.lead, "slide's delay": float(rig.slide_clock[0])}
    for name, (value, var) in by_body.items():
        k = PARAMETERS.index(_SAME[name])
        std = float(np.sqrt(var + cov[k, k]))
        if abs(value - by_coil[name]) > _DISAGREE * std:
            out.append(
                f"The {name} is {value:.5g} by the body {fit.name!r} on the tube and "
                f"{by_coil[name]:.5g} by the coil, {abs(value - by_coil[name]) / std:.0f} standard "
                f"deviations apart: does the tube slip, stretch or wind up?"
            )
    k = PARAMETERS.index("backlash")
    more = fit.backlash - rig.backlash
    if more > _DISAGREE * np.sqrt(fit.cov[1, 1] + cov[k, k]):
        out.append(
            f"The body {fit.name!r} on the tube shows {1e3 * fit.backlash:.3g} mm of play, and the "
            f"coil behind it {1e3 * rig.backlash:.3g} mm: is it fixed to the tube?"
        )
    if fit.along > _SLIPS * data.noise.mocap[0]:
        out.append(
            f"The encoder and the body {fit.name!r} on the tube differ by {1e3 * fit.along:.3g} mm "
            f"RMS, {fit.along / data.noise.mocap[0]:.0f} times motion capture's noise: the encoder "
            f"misses steps, or the body is loose."
        )
    return tuple(out)


def _line(place: Array) -> tuple[Array, Array]:
    """Point (3,) and direction (3,) of the line fitted to positions (B, 3)."""
    middle = np.median(place, axis=0)
    return middle, np.linalg.svd(place - middle, full_matrices=False)[2][0]


def _played_travel(data: RigData, stamps: Array, backlash: float) -> Array:
    travel = data.travel - 0.5 * backlash * _side(data, backlash)
    return np.interp(stamps, data.slide_time, travel)


def _side(data: RigData, backlash: float) -> Array:
    return side_of_play(data.travel, max(backlash, _LEAST_PLAY))


def _stamps(time: Array, epoch: float, delay: float, rate: float) -> Array:
    return (time + delay - rate * epoch) / (1.0 - rate)


def _predicted(data: RigData, time: Array, epoch: float, theta: Array) -> Array:
    offset, lead, backlash, delay, rate = theta
    return np.asarray(
        offset + lead * _played_travel(data, _stamps(time, epoch, delay, rate), backlash)
    )


def _initial_parameters(data: RigData, time: Array, along: Array, epoch: float) -> Array:
    """Initial parameters (5,): offset, lead and the best delay of a grid; play and rate zero."""
    best, out = np.inf, np.zeros(5)
    for delay in np.arange(-LATEST, LATEST + 1e-9, _STEP):
        travel = _played_travel(data, time + delay, 0.0)
        columns = np.stack([np.ones(time.size), travel], axis=1)
        linear, squares, rank, _ = np.linalg.lstsq(columns, along, rcond=None)
        if rank == 2 and squares[0] < best:
            best, out = float(squares[0]), np.array([*linear, 0.0, delay, 0.0])
    return out


def _refine(
    data: RigData, time: Array, along: Array, epoch: float, theta: Array
) -> tuple[Array, Array, Array]:
    """Refined parameters (5,), their covariance (5, 5), and the mask (B,) of inliers."""
    inlying = np.ones(time.size, dtype=bool)
    for _ in range(_ROUNDS):
        inlier_time = time[inlying]
        stamps = _stamps(inlier_time, epoch, theta[3], theta[4])
        travel = _played_travel(data, stamps, theta[2])
        speed = (
            _played_travel(data, stamps + _NUDGE, theta[2])
            - _played_travel(data, stamps - _NUDGE, theta[2])
        ) / (2.0 * _NUDGE)
        side = np.interp(stamps, data.slide_time, _side(data, theta[2]))
        by_delay = theta[1] * speed
        J = np.stack(
            [
                np.ones(inlier_time.size),
                travel,
                -0.5 * theta[1] * side,
                by_delay,
                by_delay * (inlier_time - epoch),
            ],
            1,
        )
        residual = along[inlying] - (theta[0] + theta[1] * travel)
        var = max(float(residual @ residual) / (inlier_time.size - 5), 1e-14)
        information = J.T @ J / var
        information[4, 4] += _RATE**-2
        rhs = J.T @ residual / var
        rhs[4] -= theta[4] * _RATE**-2
        theta = theta + np.linalg.solve(information, rhs)
        errors = along - _predicted(data, time, epoch, theta)
        inlying = np.abs(errors) < _OUTLYING * max(1.4826 * float(np.median(np.abs(errors))), 1e-6)
    return theta, np.linalg.inv(information), inlying
