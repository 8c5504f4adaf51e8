"""Calibration: a rough start for both directions, both refined, the likelier one taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from glissando.calibration.rig.advice import advice, fits
from glissando.calibration.rig.alone import against_slide
from glissando.calibration.rig.model import ROWS, Model
from glissando.calibration.rig.refine import Found, innovations, refine
from glissando.calibration.rig.result import Calibration
from glissando.calibration.rig.rig import Rig, RigData
from glissando.calibration.rig.rough import FEWEST, LATEST, agreeing, rough_start, slide_lag, strays
from glissando.calibration.rig.shape import shape_of, span
from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.solver.block_tridiagonal import factor

READINGS = 400  # bunches of them that are used: more of them read the same places again
_FIRST = 60  # of these that tell one direction from the other
_OUTLIER = float(chi2.isf(1e-6, ROWS))  # squared innovation of a reading that is left out
_WORST, _MOST_OUT = 0.1, 0.2  # of the largest square go at once, and of all readings at most
_EDGE = 0.02  # s: readings so near an end of the recording may be beyond it
_WAY = 1e-3  # m: a travel that is none
_DOUBT = 3.0  # of log odds, below which a direction that is stated counts for more


def calibrate(data: RigData, robot: Robot, *, readings: int = READINGS) -> Calibration:
    """What a session says of a rig, with its joint covariance and what it does not say.

    Uses at most so many `readings` of the coil, each the mean of what came within a tenth of a
    second. Without motion capture only slide against tracker is found. Raises RecordingError when
    there are too few coil readings, or none at a time when slide and motion capture ran too.
    """
    data, notes = usable(data)
    expected = Rig(np.eye(4), data.direction or 1, data.coil_arclength, _middle(data))
    std = _std(data)
    if not data.bodies:
        rig, cov = against_slide(data, expected, std)
        told = notes + advice(data, cov, std)
        return Calibration(rig, cov, data.coil_name, np.inf, (), told)
    shape = shape_of(data, robot)
    model = Model(data, shape, factor(shape.system))
    best, expected, odds = _directed(model, expected, std)
    model = _inside(model, best)
    sound = replace(model, data=model.data.at(agreeing(model, best)))
    bunched = _bunched(sound, readings)
    found = _without_outliers(refine(bunched, best, expected, std), expected, std)
    left_out = model.data.coil_time.size - sound.data.coil_time.size
    left_out += bunched.data.coil_time.size - found.model.data.coil_time.size
    notes += _doubts(data, found, odds, left_out)
    told = notes + advice(data, found.cov, std)
    return Calibration(found.rig, found.cov, data.coil_name, odds, fits(found), told)


def _std(data: RigData) -> Array:
    """How far every parameter may be off before (17,); zeros are not there to be found."""
    frame_and_mount = np.repeat([1.0, 1.0, 1e-3, 0.03], [3, 3, 2, 2])  # of a frame nothing is known
    clock = np.array([LATEST / 2.0, 1e-4])  # a crystal's rate [inferred]
    slide = np.array([0.02, data.noise.backlash]) if data.slides else np.zeros(2)
    zero = [data.coil_arclength_std]
    return np.concatenate([frame_and_mount, zero, slide, clock, clock * data.slides])


def _middle(data: RigData) -> float:
    """The middle of the time in which all devices ran."""
    return 0.5 * float(data.coil_time[0] + data.coil_time[-1])


def _directed(model: Model, expected: Rig, std: Array) -> tuple[Rig, Rig, float]:
    """The likelier direction's rig, what was expected of it, and the log odds of that direction."""
    data = model.data
    lag = slide_lag(data) if data.slides else 0.0
    few = replace(model, data=data.thinned(_FIRST))
    starts = {
        direction: rough_start(few, replace(expected, direction=direction), lag)
        for direction in ((1, -1) if data.slides else (1,))
    }
    better = min(starts.values(), key=lambda rig: float(np.median(strays(few, rig))))
    few = replace(few, data=few.data.at(agreeing(few, better)))
    tried = [_either_way(few, starts, direction, std) for direction in starts]
    tried.sort(key=lambda found: -found.log_evidence)
    best = tried[0].rig.direction
    others = [found for found in tried if found.rig.direction != best]
    odds = tried[0].log_evidence - others[0].log_evidence if others else np.inf
    odds = odds if not data.slides or np.ptp(data.travel) > _WAY else 0.0
    if odds < _DOUBT and others and data.direction == -best:
        tried = others
    return tried[0].rig, starts[tried[0].rig.direction], float(odds)


def _either_way(model: Model, starts: dict[int, Rig], direction: int, std: Array) -> Found:
    """The rig found from a direction's start; one whose lead has turned over is the other's."""
    found = refine(model, starts[direction], starts[direction], std, rounds=1)
    if found.rig.lead > 0.0 or -direction not in starts:
        return found
    turned = replace(found.rig, direction=-direction, lead=-found.rig.lead)
    return refine(model, turned, starts[-direction], std, rounds=1)


def _inside(model: Model, rig: Rig) -> Model:
    """The model with the readings at times that motion capture and slide cover, by this rig."""
    data, (start, stop) = model.data, span(model.data)
    time = rig.true_time(data.coil_time)
    kept = (time >= start + _EDGE) & (time <= stop - _EDGE)
    if data.slides:
        stamps = rig.slide_stamps(time)
        kept &= (stamps >= data.slide_time[0]) & (stamps <= data.slide_time[-1])
    return replace(model, data=data.at(_enough(data, np.flatnonzero(kept))))


def _bunched(model: Model, count: int) -> Model:
    """The model with so many bunches of readings at most, of single ones where they are few."""
    size = model.data.bunch
    data = model.data.bunches(size, count)
    if data.coil_time.size < FEWEST * size:
        return replace(model, data=model.data.thinned(count))
    return replace(model, data=data, bunch=size)


def _enough(data: RigData, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """The rows. Raises RecordingError when they are too few."""
    if rows.size < FEWEST:
        raise RecordingError(
            f"The tracker saw {data.coil_name!r} {rows.size} times while the other devices ran; "
            f"calibration needs {FEWEST} readings or more."
        )
    return rows


def _without_outliers(found: Found, expected: Rig, std: Array) -> Found:
    """The rig found without readings that all others speak against, a fifth of them at most.

    The worst go first: they make their neighbours look bad.
    """
    count = len(innovations(found))
    while True:
        squares = np.sum(innovations(found) ** 2, axis=1)
        kept = np.flatnonzero(squares <= max(_OUTLIER, _WORST * float(squares.max())))
        if kept.size == squares.size or kept.size < (1.0 - _MOST_OUT) * count:
            return found
        found = refine(found.model.at(kept), found.rig, expected, std)


def _doubts(data: RigData, found: Found, odds: float, left_out: int) -> tuple[str, ...]:
    told = []
    if left_out:
        told.append(f"{left_out} coil readings that all others speak against were left out.")
    if not found.converged:
        told.append("The refinement has not converged: do not trust it; slide and bend more.")
    if odds < _DOUBT:
        told.append(
            f"The direction is not certain (log odds {odds:.1f}): slide the coil over more of the "
            f"robot, or state the direction in the setup."
        )
    elif data.direction not in (0, found.rig.direction):
        told.append(
            f"The setup says direction {data.direction:+d}, the readings {found.rig.direction:+d} "
            f"(log odds {odds:.0f}): the latter is taken; check the setup."
        )
    return tuple(told)


def usable(data: RigData) -> tuple[RigData, tuple[str, ...]]:
    """The data as far as all devices ran at once, within LATEST; sentences on what is missing."""
    notes = []
    if not data.slides:
        notes.append("There is no slide topic: zero is where the coil is, the rest stays unknown.")
    if not data.bodies:
        notes.append(
            "There is no motion capture: the tracker's frame, the mount, the zero and the "
            "tracker's clock stay unknown; the slide's clock is found against the tracker's."
        )
    data = data.at(np.argsort(data.coil_time, kind="stable"))
    if data.slides or data.bodies:
        times = [b.time for b in data.bodies.values()] + [data.slide_time] * data.slides
        first, last = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
        time = data.coil_time
        data = data.at(np.flatnonzero((time >= first - LATEST) & (time <= last + LATEST)))
    return data.at(_enough(data, np.arange(data.coil_time.size))), tuple(notes)
