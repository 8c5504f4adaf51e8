"""Checks of accelerometers against gravity, and of gyroscopes against tracked bodies' rotation.

They find wrong units, signs, axes and frames of inertial sensors.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from glissando.evaluation.plausibility.corrections import signed_axes
from glissando.evaluation.plausibility.finding import Finding
from glissando.evaluation.plausibility.session import Streams, as_poses, poses_at, weights
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.evenly import evenly_chosen
from glissando.model.sensors.accelerometer import AccelerometerReadings
from glissando.model.sensors.readings import Readings

_FEWEST = 20  # least number of readings, or of windows of rotation, for a check
_MOST = 500  # readings of a stream that are used
_LIGHT = 1.0  # m/s², gravity below which accelerometers are not checked
_SIZES = 0.4, 2.5  # plausible range of the median specific force over gravity
_ALIKE = 1.3  # largest ratio of the median reading to gravity in a unit, for the unit to be named
_NEAR = 0.06  # distance over the robot's length, within which rotations of bodies are comparable
_OFF, _BETTER = 0.5, 0.4  # RMS error over gravity of a mistake; share of it after a correction
_UNITS = {
    1.0 / 9.80665: "g, of which each is 9.80665 m/s²",
    1e3 / 9.80665: "thousandths of g, of which each is 9.80665e-3 m/s²",
    1e3: "mm/s²",
}
_WINDOW = 0.16  # s, windows over which mean rotation rates are compared
_SLOW = 0.1  # rad/s RMS, below which a robot counts as not rotating
_SCALES = {
    1.0: "",
    180.0 / np.pi: "degrees per second",
    np.pi / 180.0: "rad/s, read as degrees per second",
    1e3: "milliradians per second",
    30.0 / np.pi: "revolutions per minute",
    1e-3: "a unit 1,000 times too large",
}


def check_accelerometers(streams: Streams) -> Iterator[Finding]:
    """Check accelerometers, which at rest measure the reaction to gravity.

    Args:
        streams: Streams of a session.

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
        yield from _wrong_size(r, weight) or _wrong_axes(streams, r, weight)


def _wrong_size(r: Readings, weight: float) -> list[Finding]:
    """Finding that an accelerometer's readings are far larger or smaller than gravity."""
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


def _wrong_axes(streams: Streams, r: AccelerometerReadings, weight: float) -> list[Finding]:
    """Finding that gravity has another sign or other axes than by the tilt of a body nearby."""
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
        errors = [_rms_difference(force @ matrix, up, axes) for matrix, _ in ways]
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


def _rms_difference(seen: Array, expected: Array, axes: NDArray[np.bool_]) -> float:
    """RMS difference of specific forces (M, 3) along the known `axes` (M, 3)."""
    return float(np.sqrt(np.mean((seen - expected)[axes] ** 2)))


def check_gyros(streams: Streams) -> Iterator[Finding]:
    """Check gyroscopes against tracked bodies at their place, or else anywhere on the robot.

    Args:
        streams: Streams of a session.

    Yields:
        Findings.
    """
    full = [r for r in streams.tracked if np.all(weights(r)[1:] > 0.0) and len(r) > _FEWEST]
    for gyro in streams.sensors:
        if gyro.kind != "gyro" or len(gyro) < _FEWEST:
            continue
        place = float(np.median(gyro.arclength))
        near = [
            r for r in full
            if np.max(np.abs(r.arclength - place)) < _NEAR * streams.robot.length
        ]  # fmt: skip
        finding = None
        for body in near:
            finding = _compared(gyro, *_turns(gyro, body), body.label)
            if finding is not None:
                break
        if not near:
            finding = _scale_alone(gyro, full)
        if finding is not None:
            yield finding


def _turns(gyro: Readings, body: Readings) -> tuple[Array, Array, Array]:
    """Mean rates (M, 3), rad/s, of a gyroscope and of a body in body axes, and its rotations.

    The M windows are short; rotations (M, 3, 3) are those at their starts.
    """
    order = np.argsort(body.time, kind="stable")
    time, rotation = body.time[order], as_poses(body)[order][:, :3, :3]
    starts = np.searchsorted(time, np.arange(time[0], time[-1], _WINDOW)).clip(0, time.size - 1)
    starts = starts[np.append(True, np.diff(starts) > 0)]
    first, last = starts[:-1], starts[1:]
    span = time[last] - time[first]
    clock = np.sort(gyro.time)
    inside = np.searchsorted(clock, time[last]) - np.searchsorted(clock, time[first])
    ok = (span < 3.0 * _WINDOW) & (inside >= 2)
    first, last, span = first[ok], last[ok], span[ok]
    swung = np.swapaxes(rotation[first], -1, -2) @ rotation[last]
    rates = se3.so3_log(swung) / span[:, None]
    by_time = np.argsort(gyro.time, kind="stable")
    total = _integral(gyro.time[by_time], gyro.values[by_time])
    stamps = gyro.time[by_time]
    angles = np.stack(
        [
            np.interp(time[last], stamps, column) - np.interp(time[first], stamps, column)
            for column in total.T
        ],
        axis=-1,
    )
    return angles / span[:, None], rates, rotation[first]


def _integral(time: Array, values: Array) -> Array:
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None]
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])


def _compared(
    gyro: Readings, seen: Array, rates: Array, rotation: Array, body: str
) -> Finding | None:
    """Finding that a gyroscope's rates differ from those of a body at its place, by a mistake."""
    sizes = [np.sqrt(np.mean(np.sum(each**2, axis=1))) for each in (rates, seen)]
    if len(seen) < _FEWEST or max(sizes) < _SLOW:
        return None
    turned = np.einsum("mij,mj->mi", rotation, rates)  # in the world
    tries = [(scale, "", rates) for scale in _SCALES]
    tries += [(scale, "in the world's axes, not its own", turned) for scale in (1.0, 180.0 / np.pi)]
    for matrix, shown in signed_axes():
        text = "with the wrong sign" if shown == "−x, −y, −z" else f"about {shown} for x, y, z"
        tries += [(scale, text, rates @ matrix.T) for scale in (1.0, 180.0 / np.pi)]
    unexplained = np.array([_unexplained_share(seen, scale * other) for scale, _, other in tries])
    best = int(np.argmin(unexplained))
    scale, text, _ = tries[best]
    if best == 0 or unexplained[best] > 0.5 or unexplained[best] > 0.4 * unexplained[0]:
        return None
    what = " and ".join(part for part in (_unit(scale), text) if part)
    return Finding(
        "gyro",
        f"{gyro.label!r} does not turn as {body!r} at its place does: it probably reads {what} "
        f"({unexplained[best]:.0%} of its signal is left unexplained then, "
        f"{min(unexplained[0], 99.0):.0%} as it is), or the rotations of {body!r} are inverted, "
        f"mirrored or in another unit; give rad/s in the cross-section's axes.",
        True, (gyro.label,), what,
    )  # fmt: skip


def _unit(scale: float) -> str:
    return f"in {_SCALES[scale]}" if _SCALES[scale] else ""


def _unexplained_share(seen: Array, expected: Array) -> float:
    """Share of the measured rates' power not explained by the expected ones, bias aside; robust."""
    error, size = seen - expected, seen - np.median(seen, axis=0)
    error = error - np.median(error, axis=0)
    square = np.sum(error**2, axis=1), np.sum(size**2, axis=1)
    top = [np.sort(part)[: int(0.95 * len(part))].mean() for part in square]
    return float(top[0] / max(top[1], 1e-30))


def _scale_alone(gyro: Readings, full: list[Readings]) -> Finding | None:
    """Finding that a gyroscope's rates are far larger or smaller than those of tracked bodies."""
    sizes = []
    for body in full:
        seen, rates, _ = _turns(gyro, body)
        if len(seen) >= _FEWEST:
            sizes.append((_rms(seen), _rms(rates)))
    if not sizes or max(rate for _, rate in sizes) < _SLOW:
        return None
    size, rate = max(sizes, key=lambda pair: pair[1])
    ratio = size / rate
    if 0.04 < ratio < 12.0:
        return None
    unit = "degrees per second" if ratio > 1.0 else "another unit"
    return Finding(
        "gyro",
        f"{gyro.label!r} turns with {size:.3g} rad/s, tracked bodies with {rate:.3g} rad/s: it "
        f"probably reads in {unit}; give rad/s.",
        True, (gyro.label,), unit,
    )  # fmt: skip


def _rms(rates: Array) -> float:
    """RMS of rates (M, 3) about their median, without outliers."""
    square = np.sort(np.sum((rates - np.median(rates, axis=0)) ** 2, axis=1))
    return float(np.sqrt(square[: int(0.98 * square.size)].mean()))
