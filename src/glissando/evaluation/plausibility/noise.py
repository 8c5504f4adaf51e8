"""Check of stated noise against the noise of readings at rest, estimated from differences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from glissando.evaluation.plausibility.finding import Finding
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings

_BLOCK = 16  # rows of a block; the blocks with the least noise are taken to be at rest
_FEWEST = 4 * _BLOCK
_TOO_SMALL = 6.0  # ratio of measured to stated noise; chance gives at most 1.6 in 10,000 blocks
_LENGTHS = 0.06  # largest plausible std of positions over the robot's length
_ANGLE = 0.3  # rad, largest plausible std of angles
_RATE = 20.0  # rad/s, largest plausible std of rotation rates
_FINEST = {"positions": 3e-5, "angles": 1e-4, "turn rates": 1e-5}  # least plausible std
_STILL = 2.0  # scatter about a line over white noise, beyond which a block is moving
_THIRD = np.sqrt(20.0)  # std of a third difference of white noise


def check_noise(readings: Sequence[Readings], length: float) -> Iterator[Finding]:
    """Check the stated standard deviations of sensors.

    A stated standard deviation may exceed the white noise, since it includes bias. It cannot be far
    below the noise of a sensor at rest, nor a considerable part of the robot's length.

    Args:
        readings: Streams of sensors with the stated `cov`.
        length: Length of the robot, m.

    Yields:
        Findings.
    """
    for r in readings:
        for what, rows, largest, seen in _parts(r, length):
            stated = float(np.sqrt(np.median(np.diagonal(r.cov, axis1=-2, axis2=-1)[..., rows])))
            unit = {"positions": "m", "angles": "rad"}.get(what, "rad/s")
            if stated > largest:
                yield _too_large(r, what, unit, stated, largest, seen)
            elif seen > _TOO_SMALL * stated or stated < _FINEST[what]:
                cause = "a variance given for a standard deviation, or another unit"
                yield Finding(
                    "noise",
                    f"The stated noise of {r.label!r} is {stated:.3g} {unit} in {what}, less than "
                    f"such sensors err{_scatter(seen, unit)}: probably {cause}; give the "
                    f"standard deviation, bias and all, in {unit}.",
                    seen > 20.0 * stated, (r.label,), "small",
                )  # fmt: skip


def _too_large(
    r: Readings, what: str, unit: str, stated: float, largest: float, seen: float
) -> Finding:
    cause = {"m": "millimetres", "rad": "degrees", "rad/s": "degrees per second"}[unit]
    return Finding(
        "noise",
        f"The stated noise of {r.label!r} is {stated:.3g} {unit} in {what}"
        f"{_scatter(seen, unit)}: probably {cause}; give the standard deviation in {unit}.",
        stated > 5.0 * largest, (r.label,), cause,
    )  # fmt: skip


def _scatter(seen: float, unit: str) -> str:
    """Measured noise as part of a sentence; empty if unknown."""
    return f", while its readings at rest scatter by {seen:.3g} {unit}" if seen > 0.0 else ""


def _parts(r: Readings, length: float) -> Iterator[tuple[str, slice, float, float]]:
    """Yield parts of a reading: name, rows, largest plausible and measured noise (0 if unknown)."""
    if r.kind in ("pose", "coil"):
        rotation = _without_roll(r) if r.kind == "coil" else r.values[:, :3, :3]
        steps = np.swapaxes(rotation[:-1], -1, -2) @ rotation[1:]
        turn = np.stack([steps[:, 2, 1], steps[:, 0, 2], steps[:, 1, 0]], axis=-1)
        yield "positions", slice(0, 3), _LENGTHS * length, _at_rest(r, r.values[:, :3, 3], 0)
        columns = slice(0, 2) if r.kind == "coil" else slice(0, 3)
        yield "angles", slice(3, None), _ANGLE, _at_rest(r, turn[:, columns], 1)
    elif r.kind == "position":
        yield "positions", slice(0, 3), _LENGTHS * length, _at_rest(r, r.values, 0)
    elif r.kind == "gyro":
        yield "turn rates", slice(0, 3), _RATE, 0.0  # vibration looks like white noise


def _without_roll(r: Readings) -> Array:
    """Rotations (M, 3, 3) of a coil's axis without roll, which is arbitrary in readings."""
    axis = r.values[:, :3, 2]
    middle = axis.mean(axis=0)
    turn = se3.least_turn(middle[None] / max(float(np.linalg.norm(middle)), 1e-12))[0]
    return turn @ se3.least_turn(axis @ turn)


def _at_rest(r: Readings, values: Array, order: int) -> float:
    """Standard deviation of white noise at rest, from third differences; 0 if unknown.

    Args:
        r: The readings.
        values: Values (M − order, C), already differenced `order` times.
        order: Number of differences taken.
    """
    steps = np.diff(r.time)
    if len(values) < _FEWEST:
        return 0.0
    regular = np.abs(steps - np.median(steps)) < 0.2 * np.median(steps)
    different = np.diff(values, 3 - order, axis=0)
    ok = regular[:-2] & regular[1:-1] & regular[2:]
    different = different[: ok.size][ok[: len(different)]]
    blocks = len(different) // _BLOCK
    if blocks < 2:
        return 0.0
    shaped = different[: blocks * _BLOCK].reshape(blocks, _BLOCK, -1)
    white = np.sqrt(np.mean(shaped**2, axis=1)) / _THIRD
    if order == 0:  # a block at rest is no more than white noise about a line
        raw = values[: len(ok)][ok][: blocks * _BLOCK].reshape(blocks, _BLOCK, -1)
        ramp = np.linspace(-1.0, 1.0, _BLOCK)[:, None]
        raw = raw - raw.mean(axis=1, keepdims=True)
        raw = raw - ramp * (np.sum(ramp * raw, axis=1, keepdims=True) / np.sum(ramp**2))
        still = np.all(np.sqrt(np.mean(raw**2, axis=1)) < _STILL * white, axis=1)
        white = white[still]
    return float(np.median(np.quantile(white, 0.1, axis=0))) if len(white) > 1 else 0.0
