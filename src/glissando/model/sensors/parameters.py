"""Sensor parameters: frames, mounts, offsets, biases; known, constant or drifting.

A sensor parameter corrects the readings of its streams. An uncertain one is estimated with the
states, as an Ornstein-Uhlenbeck process in time about its expected value, or as a constant. A known
one (`std` of zeros) is applied and never estimated. Source: (16), (18).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from glissando.errors import SensorError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings


def _frame(r: Readings, x: Array) -> Readings:
    shift = se3.exp(x)
    if r.value_shape == (4, 4):
        return r.changed(values=shift @ r.values)
    if r.value_shape == (3, 3):
        return r.changed(values=shift[:, :3, :3] @ r.values)
    turned = (shift[:, :3, :3] @ r.values[..., None])[..., 0]
    return r.changed(values=turned + shift[:, :3, 3])


def _mount(r: Readings, x: Array) -> Readings:
    return r.changed(mount=r.mount @ se3.exp(x if len(x) > 1 else x[0]))


def _bias(r: Readings, x: Array) -> Readings:
    return r.changed(values=r.values - x)


_SHIFTS: dict[str, Callable[[Readings, Array], Readings]] = {
    "frame": _frame,
    "mount": _mount,
    "bias": _bias,
}
_MOVES: dict[str, tuple[str, Callable[[Readings], Array | float], str]] = {
    "arclength_offset": ("arclength", lambda r: 1.0, "metres"),
    "time_offset": ("time", lambda r: -1.0, "seconds"),
    "slide_lag": ("arclength", lambda r: -r.slide_speed, "seconds"),
    "slide_play": ("arclength", lambda r: -0.5 * r.slide_way, "metres"),
}  # field that a parameter changes, its change by one unit of it, and that unit
SIZES = {"frame": 6, "mount": 6, "bias": 3} | dict.fromkeys(_MOVES, 1)
"""Kinds of sensor parameter, with the number of components of each."""

_TURN = 7.0  # rad
_LARGEST_VALUE: dict[str, Array | float] = {
    "frame": np.repeat([50.0, _TURN], 3),
    "mount": np.repeat([2.0, _TURN], 3),
}
_LARGEST_STD: dict[str, Array | float] = {
    "frame": np.repeat([2.0, np.pi], 3),
    "mount": np.repeat([1.0, np.pi], 3),
    "arclength_offset": 1.0,
    "time_offset": 5.0,
    "slide_lag": 5.0,
    "slide_play": 0.1,
}  # m, rad or s, beyond which a unit is wrong
_SHAPES = {"frame": ((4, 4), (3, 3), (3,)), "bias": ((3,),)}  # value shapes of each


@dataclass(frozen=True)
class SensorParameter:
    """A parameter of the sensors of some streams, known or uncertain.

    Attributes:
        name: Name, in messages and files.
        kind: frame (the transform (6,) from the streams' frame to the world, as a logarithm), mount
            (a further transform (6,) of the sensor in the cross-section), bias (3,) of a gyroscope
            or a position, arclength_offset (1,) in metres, time_offset (1,): delay of time stamps
            in seconds; slide_lag (1,): delay, in seconds, of a sliding sensor behind the reported
            travel of its slide; or slide_play (1,): travel, in metres, of the slide after a
            reversal before the sensor moves.
        streams: Names of the readings to which it applies.
        value: Expected value (size,).
        std: Standard deviation (size,) about it; zeros if it is known.
        correlation_time: Correlation time, s; infinite for a constant.

    Raises:
        SensorError: The kind is not known, sizes do not fit, or streams is not a list.
    """

    name: str
    kind: str
    streams: tuple[str, ...]
    value: Array
    std: Array
    correlation_time: float = np.inf

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in SIZES:
            kinds = ", ".join(SIZES)
            raise SensorError(
                f"Sensor parameter {self.name!r} is a {self.kind!r}; choose one of {kinds}."
            )
        streams: Any = self.streams
        if isinstance(streams, str) or not (
            isinstance(streams, Collection) and all(isinstance(each, str) for each in streams)
        ):
            raise SensorError(
                f"Sensor parameter {self.name!r}: streams is {streams!r}; give a list of names."
            )
        for part in ("value", "std"):
            given = self._numbers(part)
            object.__setattr__(self, part, given)
            if given.shape != (self.size,) or not np.all(np.isfinite(given)):
                raise SensorError(
                    f"Sensor parameter {self.name!r}: {part} is {given}; give {self.size} numbers."
                )
            self._require_units(part, given)
        object.__setattr__(self, "correlation_time", float(self._numbers("correlation_time")))
        if np.any(self.std < 0.0) or not self.correlation_time > 0.0:
            raise SensorError(
                f"Sensor parameter {self.name!r}: std {self.std} and correlation time "
                f"{self.correlation_time:g} s must not be negative."
            )

    def _require_units(self, part: str, given: Array) -> None:
        """Raise SensorError for numbers as large as millimetres, degrees or milliseconds."""
        most = (_LARGEST_VALUE if part == "value" else _LARGEST_STD).get(self.kind)
        if most is None or not np.any(over := np.abs(given) > most):
            return
        at = int(np.argmax(over))
        way = _MOVES[self.kind][2] if self.moves else ("metres", "radians")[at // 3]
        raise SensorError(
            f"Sensor parameter {self.name!r}: {part} is {given.tolist()}; give {way}, of which "
            f"{np.broadcast_to(most, given.shape)[at]:.3g} are most, in a {self.kind}."
        )

    def _numbers(self, part: str) -> Array:
        given = getattr(self, part)
        try:
            numbers: Array = np.array(given, dtype=float)
            if given is not None and (part != "correlation_time" or numbers.ndim == 0):
                return numbers
        except (TypeError, ValueError):
            pass
        wanted = "seconds" if part == "correlation_time" else f"{self.size} numbers"
        raise SensorError(
            f"Sensor parameter {self.name!r}: {part} is {given!r}; give {wanted}."
        ) from None

    @property
    def size(self) -> int:
        """Number of components."""
        return SIZES[self.kind]

    @property
    def known(self) -> bool:
        """Whether it is known exactly, and therefore not estimated."""
        return not np.any(self.std > 0.0)

    @property
    def moves(self) -> bool:
        """Whether it changes the arclengths or times of readings."""
        return self.kind in _MOVES

    @property
    def along(self) -> str:
        """Field of readings that a parameter which `moves` changes: arclength or time."""
        return _MOVES[self.kind][0]

    def lever(self, readings: Readings) -> Array | float:
        """Change of that field by one unit of a parameter which `moves`, (M,) or one number."""
        return _MOVES[self.kind][1](readings)

    def shift(self, readings: Readings, x: Array) -> Readings:
        """The readings corrected for a value `x` (M, size), or (size,) for all of them.

        Raises:
            SensorError: The sensor has no parameter of this kind.
        """
        fits = _SHAPES.get(self.kind)
        three = self.kind == "frame" and readings.value_shape == (3,)
        frameless = three and not readings.fixes_base  # rates and accelerations of its own frame
        if frameless or (fits is not None and readings.value_shape not in fits):
            raise SensorError(
                f"Sensor parameter {self.name!r}: a {type(readings).__name__} has no {self.kind}."
            )
        if self.moves:
            way, values = self.along, np.atleast_2d(x)[:, 0]
            moved = getattr(readings, way) + self.lever(readings) * values
            return readings.changed(**{way: moved})
        return _SHIFTS[self.kind](readings, np.atleast_2d(x))


def corrected(readings: Readings, sensor_parameters: Sequence[SensorParameter]) -> Readings:
    """Readings corrected for the expected values of all their sensor parameters."""
    for parameter in sensor_parameters:
        if readings.name in parameter.streams and np.any(parameter.value != 0.0):
            readings = parameter.shift(readings, parameter.value)
    return readings
