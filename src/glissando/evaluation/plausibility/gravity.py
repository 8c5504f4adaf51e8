"""Accelerometers against gravity: unit, and by the tilt of tracked bodies beside them the signs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from glissando.evaluation.plausibility.corrections import signed_axes
from glissando.evaluation.plausibility.finding import Finding
from glissando.evaluation.plausibility.session import Streams, poses_at
from glissando.geometry.se3 import Array
from glissando.model.evenly import evenly_chosen
from glissando.model.sensors.accelerometer import AccelerometerReadings
from glissando.model.sensors.readings import Readings

_FEWEST, _MOST = 20, 500  # readings that say something, and of a stream that are looked at
_LIGHT = 1.0  # m/s²: a gravity below it is none
_SIZES = 0.4, 2.5  # times gravity: what a robot that moves feels as a rule
_ALIKE = 1.3  # times the size of a unit that a reading may be, to be named as in it
_NEAR = 0.06  # of the robot's length within which a tracked body is tilted nearly as much
_OFF, _BETTER = 0.5, 0.4  # of gravity: error that is a mistake, and share of it that a cure leaves
_UNITS = {
    1.0 / 9.80665: "g, of which each is 9.80665 m/s²",
    1e3 / 9.80665: "thousandths of g, of which each is 9.80665e-3 m/s²",
    1e3: "mm/s²",
}


def check_accelerometers(streams: Streams) -> Iterator[Finding]:
    """Findings on accelerometers: at rest they read the reaction to gravity.

    Args:
        streams: A session.

    Yields:
        Findings.
    """
    for r in streams.sensors:
        if not isinstance(r, AccelerometerReadings) or len(r) < _FEWEST:
            continue
        weight = float(np.linalg.norm(r.gravity))
        if weight < _LIGHT:
            continue
        r = r.select(evenly_chosen(len(r), _MOST))
        yield from _sized(r, weight) or _turned(streams, r, weight)


def _sized(r: Readings, weight: float) -> list[Finding]:
    """The finding that a sensor reads far more or less than gravity."""
    size = float(np.median(np.linalg.norm(r.values, axis=1)))
    if _SIZES[0] < size / weight < _SIZES[1]:
        return []
    units = [u for s, u in _UNITS.items() if 1.0 / _ALIKE < size / (s * weight) < _ALIKE]
    what = units[0] if units else "another unit, or without gravity"
    sentence = (
        f"{r.label!r} reads {size:.3g} where gravity alone is {weight:.3g} m/s²: it probably reads "
        f"in {what}; give m/s², gravity included."
    )
    return [Finding("accelerometer", sentence, True, (r.label,), what)]


def _turned(streams: Streams, r: AccelerometerReadings, weight: float) -> list[Finding]:
    """The finding that gravity pulls the other way, or along other axes, than on a body beside."""
    place = float(np.median(r.arclength))
    force = np.einsum("...ij,...j->...i", r.mount[..., :3, :3], r.values / weight)
    for body in streams.tracked:
        where, pose, shown = poses_at(body, r.time)
        near = np.abs(where - place) < _NEAR * streams.robot.length
        axes = shown[:, 1:] * near[:, None] > 0.0
        if axes[:, 2].sum() < _FEWEST:
            continue
        up = -np.einsum("mji,j->mi", pose[:, :3, :3], r.gravity / weight)
        ways = [(np.eye(3), ""), (-np.eye(3), "with the wrong sign")]
        ways += [(matrix, f"along {shown} for x, y, z") for matrix, shown in signed_axes()]
        errors = [_off(force @ matrix, up, axes) for matrix, _ in ways]
        best = int(np.argmin(errors))
        if best and errors[0] > _OFF and errors[best] < _BETTER * errors[0]:
            what = ways[best][1]
            sentence = (
                f"{r.label!r} feels gravity otherwise than the tilt of {body.label!r} beside it "
                f"says: it probably reads {what} ({errors[best]:.2f} of gravity is left "
                f"unexplained then, {errors[0]:.2f} as it is), or its gravity {r.gravity} m/s² "
                f"does not point down; at rest an accelerometer with z up reads +9.81."
            )
            return [Finding("accelerometer", sentence, True, (r.label,), what)]
    return []


def _off(seen: Array, expected: Array, axes: NDArray[np.bool_]) -> float:
    """RMS of what forces (M, 3) differ by along the axes that are known."""
    return float(np.sqrt(np.mean((seen - expected)[axes] ** 2)))
