"""Calibration of a rig: initial guess and refinement for both directions; the likelier is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glissando.calibration.rig.advice import advice, prior_conflicts, stream_fits
from glissando.calibration.rig.carriage import fit_slide, judgement
from glissando.calibration.rig.initial_guess import FEWEST, distances, inliers, rough_start
from glissando.calibration.rig.model import ROWS, CoilModel
from glissando.calibration.rig.plausible import require_metres
from glissando.calibration.rig.refine import RigFit, refine
from glissando.calibration.rig.result import Calibration
from glissando.calibration.rig.rig import ANYWHERE, Rig, RigData
from glissando.calibration.rig.shape import estimate_shape, span
from glissando.calibration.rig.slide_timing import LATEST, against_slide, slide_lag
from glissando.calibration.rig.white_noise import with_measured_noise
from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.model.quantiles import chi_square_exceedance
from glissando.model.robot import Robot
from glissando.solver.block_tridiagonal import factor

_READINGS = 400  # blocks that are used: further blocks would repeat the same places
_FIRST = 60  # readings used to choose the direction
_OUTLIER = float(
    chi_square_exceedance(1e-6, ROWS)
)  # squared innovation above which a reading is an outlier
_WORST, _MOST_OUT = 0.1, 0.2  # of the largest square, removed in one pass; share removed at most
_EDGE = 0.02  # s: margin at the ends of the recording, for errors of the delay
_NO_TRAVEL = 1e-3  # m
_MISFIT = 1.5  # RMS of whitened innovations above which standard deviations are too small
_DOUBT = 3.0  # log odds below which the stated direction is preferred


def calibrate(data: RigData, robot: Robot, *, readings: int = _READINGS) -> Calibration:
    """Calibrate a rig from a session; without motion capture, only the slide.

    Args:
        data: The session.
        robot: The robot with its prior.
        readings: Maximum number of coil readings, each the mean over a tenth of a second.

    Returns:
        The constants, their joint covariance, and sentences on constants that the session leaves
        uncertain.

    Raises:
        RecordingError: If there are too few coil readings while slide and motion capture ran, if
            lengths do not fit the robot, or if no finite solution exists.
    """
    require_metres(data, robot)
    try:
        return _calibrated(data, robot, readings)
    except np.linalg.LinAlgError as problem:
        raise RecordingError(
            f"The calibration of {data.coil_name!r} has no solution ({problem}); check arclengths "
            f"and mounts of the bodies, or record again as docs/calibration.md says."
        ) from None


def _calibrated(data: RigData, robot: Robot, readings: int) -> Calibration:
    """Calibrate from data whose lengths are consistent with the robot."""
    data, notes = _usable(data)
    tube = fit_slide(data)
    middle = 0.5 * float(data.coil_time[0] + data.coil_time[-1])
    expected = Rig(np.eye(4), data.direction or 1, data.coil_arclength, middle)
    std = _prior_std(data)
    if not data.bodies:
        rig, cov = against_slide(data, expected, std)
        notes += advice(data, cov, std)
        return Calibration(rig, cov, data.coil_name, np.inf, (), notes, tube)
    shape = estimate_shape(data, robot)
    model = CoilModel(data, shape, factor(shape.system))
    best, expected, odds = _choose_direction(model, expected, std)
    model = _covered(model, best)
    inlying = replace(model, data=model.data.at(inliers(model, best)))
    inlying = with_measured_noise(inlying, best)
    averaged = _averaged(inlying, readings)
    fit = _without_outliers(refine(averaged, best, expected, std), expected, std)
    left_out = model.data.coil_time.size - inlying.data.coil_time.size
    left_out += averaged.data.coil_time.size - fit.model.data.coil_time.size
    notes += _warnings(data, fit, odds, left_out) + prior_conflicts(fit.rig, expected, std)
    notes += advice(data, fit.cov, std)
    if tube is not None:
        notes += judgement(tube, fit.rig, fit.cov, data)
    constants = fit.rig, fit.cov, data.coil_name, odds, stream_fits(fit), notes, tube
    return Calibration(*constants, fit.rig.channel(data))


def _prior_std(data: RigData) -> Array:
    """Prior standard deviations (17,); zero for parameters of a missing device."""
    frame_and_mount = np.repeat([ANYWHERE, 1e-3, 0.03], [6, 2, 2])
    clock = np.array([LATEST / 2.0, 1e-4])  # a crystal's rate [inferred]
    slide = np.array([0.02, data.noise.backlash]) if data.slides else np.zeros(2)
    zero = [data.coil_arclength_std]
    return np.concatenate([frame_and_mount, zero, slide, clock, clock * data.slides])


def _choose_direction(model: CoilModel, expected: Rig, std: Array) -> tuple[Rig, Rig, float]:
    """Rig and initial guess of the chosen direction, and the log odds of the likelier direction."""
    data = model.data
    lag = slide_lag(data) if data.slides else 0.0
    subset = replace(model, data=data.thinned(_FIRST))
    starts = {
        direction: rough_start(subset, replace(expected, direction=direction), lag)
        for direction in ((1, -1) if data.slides else (1,))
    }
    better = min(starts.values(), key=lambda rig: float(np.median(distances(subset, rig))))
    subset = replace(subset, data=subset.data.at(inliers(subset, better)))
    fits = [_fit_direction(subset, starts, direction, std) for direction in starts]
    fits.sort(key=lambda fit: -fit.log_evidence)
    best = fits[0].rig.direction
    others = [fit for fit in fits if fit.rig.direction != best]
    odds = fits[0].log_evidence - others[0].log_evidence if others else np.inf
    odds = odds if not data.slides or np.ptp(data.travel) > _NO_TRAVEL else 0.0
    if odds < _DOUBT and others and data.direction == -best:
        fits = others
    return fits[0].rig, starts[fits[0].rig.direction], float(odds)


def _fit_direction(model: CoilModel, starts: dict[int, Rig], direction: int, std: Array) -> RigFit:
    """Fit from a direction's initial guess; in the other direction if the lead becomes negative."""
    fit = refine(model, starts[direction], starts[direction], std, rounds=1)
    if fit.rig.lead > 0.0 or -direction not in starts:
        return fit
    turned = replace(fit.rig, direction=-direction, lead=-fit.rig.lead)
    return refine(model, turned, starts[-direction], std, rounds=1)


def _covered(model: CoilModel, rig: Rig) -> CoilModel:
    """Model with the readings at times, by this rig, at which motion capture and slide recorded."""
    data, (start, stop) = model.data, span(model.data)
    time = rig.true_time(data.coil_time)
    inside = (time >= start + _EDGE) & (time <= stop - _EDGE) & rig.covered(time, data)
    return replace(model, data=_require_enough(data.at(np.flatnonzero(inside))))


def _averaged(model: CoilModel, count: int) -> CoilModel:
    """Model with at most `count` averaged blocks, or single readings if blocks are too few."""
    size = model.data.block_size
    data = model.data.blocks(size, count)
    if data.coil_time.size < FEWEST * size:
        return replace(model, data=model.data.thinned(count))
    return replace(model, data=data, block_size=size)


def _require_enough(data: RigData) -> RigData:
    if data.coil_time.size < FEWEST:
        raise RecordingError(
            f"The tracker saw {data.coil_name!r} {data.coil_time.size} times while the other "
            f"devices ran; calibration needs {FEWEST} readings or more."
        )
    return data


def _without_outliers(fit: RigFit, expected: Rig, std: Array) -> RigFit:
    """Refit without outliers, of which at most a fifth of the readings are removed.

    The largest are removed first, because they increase their neighbours' innovations.
    """
    squares = np.sum(fit.innovations() ** 2, axis=1)
    count = squares.size
    while True:
        inlying: NDArray[np.intp]
        inlying = np.flatnonzero(squares <= max(_OUTLIER, _WORST * float(squares.max())))
        if inlying.size == squares.size or inlying.size < (1.0 - _MOST_OUT) * count:
            return fit
        fit = refine(fit.model.at(inlying), fit.rig, expected, std)
        squares = np.sum(fit.innovations() ** 2, axis=1)


def _warnings(data: RigData, fit: RigFit, odds: float, left_out: int) -> tuple[str, ...]:
    """Warnings on outliers, misfit, convergence and the direction."""
    out = []
    if left_out:
        out.append(f"{left_out} coil readings that contradict all others were left out.")
    misfit = float(np.sqrt(np.mean(fit.innovations() ** 2)))
    if misfit > _MISFIT:
        out.append(
            f"Readings of the coil are off by {misfit:.1f} times what their noise and the field's "
            f"distortion explain, and so may be what was found: do not trust its deviations."
        )
    if not fit.converged:
        out.append("The refinement has not converged: do not trust it; slide and bend more.")
    if odds < _DOUBT:
        out.append(
            f"The direction is not certain (log odds {odds:.1f}): slide the coil over more of the "
            f"robot, or state the direction in the setup."
        )
    elif data.direction not in (0, fit.rig.direction):
        out.append(
            f"Direction {data.direction:+d} is stated, and the readings say "
            f"{fit.rig.direction:+d} (log odds {odds:.0f}), which is taken; check the sign of the "
            f"travel."
        )
    return tuple(out)


def _usable(data: RigData) -> tuple[RigData, tuple[str, ...]]:
    """Data from the time when all devices ran, within LATEST, and warnings on missing devices.

    Readings that repeat the one before exactly are removed.
    """
    notes = []
    if not data.slides:
        notes.append(
            "There is no slide topic of this coil: zero is where it is, the rest stays unknown."
        )
    if not data.bodies:
        notes.append(
            "There is no motion capture: the tracker's frame, the mount, the zero and the "
            "tracker's clock stay unknown; the slide's clock is found against the tracker's."
        )
    data = data.at(np.argsort(data.coil_time, kind="stable"))
    new = np.ones(data.coil_time.size, dtype=bool)
    new[1:] = np.any(data.coil[1:] != data.coil[:-1], axis=(1, 2))
    if FEWEST <= new.sum() < new.size:
        notes.append(
            f"{int(np.sum(~new))} readings of {data.coil_name!r} have all digits of the one before "
            f"and were left out: the tracker was frozen there, or polled faster than it measures."
        )
        data = data.at(np.flatnonzero(new))
    times = [b.time for b in data.bodies.values()] + [data.slide_time] * data.slides
    if times:
        first, last = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
        inside = (data.coil_time >= first - LATEST) & (data.coil_time <= last + LATEST)
        data = data.at(np.flatnonzero(inside))
    return _require_enough(data), tuple(notes)
