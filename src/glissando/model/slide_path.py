"""The path of a sliding sensor: displacement over time within the limits of its stage."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import SimulationError
from glissando.geometry.se3 import Array
from glissando.model.short_repr import ShortRepr

_SLACK = 1e-6  # relative tolerance of limits, for rounding
_MOST = 1e9  # s, m or m/s; larger numbers are refused
_CYCLES = 100_000
_REST = 0.6  # s of rest at each stop of a calibration path
_MOST_OF_A_STAGE = {"stroke": (10.0, "m"), "speed": (10.0, "m/s"), "acceleration": (1e3, "m/s²")}
_SHORTEST_MOVE = 1e-9  # m; shorter moves are left out


@dataclass(frozen=True)
class SlideLimits:
    """Limits of a linear stage: `stroke` m, `speed` m/s, `acceleration` m/s²."""

    stroke: float
    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        for name, (most, unit) in _MOST_OF_A_STAGE.items():
            value = getattr(self, name)
            if not 0.0 < value <= most:
                metres = f"metres ({value:g} m{unit} are {value / 1e3:g} {unit})"
                right = metres if value > most else "one above zero"
                raise SimulationError(
                    f"A stage with a {name} of {value:g} {unit} cannot be; give {right}."
                )


@dataclass(frozen=True)
class SlidePath(ShortRepr):
    """Displacement of a sensor from the tip towards the base, of stepwise constant acceleration.

    Knots `time` (K,) s, `displacement` (K,) m, `speed` (K,) m/s; before the first and after the
    last the stage is at rest. The sensor's arclength is length − displacement + offset. Raises
    SimulationError when the path exceeds the limits of stroke, speed or acceleration.
    """

    time: Array
    displacement: Array
    speed: Array
    limits: SlideLimits

    def __post_init__(self) -> None:
        for name in ("time", "displacement", "speed"):
            array = np.asarray(getattr(self, name), dtype=float)
            object.__setattr__(self, name, array)
            if array.shape != np.shape(self.time) or not np.all(np.abs(array) < _MOST):
                raise SimulationError(
                    f"A slide's {name} is {array}; give finite numbers, one a knot."
                )
        _require_increasing(self.time)
        if np.any(np.abs(self.speed[[0, -1]]) > 1e-9):
            raise SimulationError(
                f"The slide begins at {self.speed[0]:g} and ends at {self.speed[-1]:g} m/s, where "
                f"the stage holds; begin and end at rest."
            )
        step = np.diff(self.time)
        gap = np.diff(self.displacement) - 0.5 * step * (self.speed[1:] + self.speed[:-1])
        if np.any(np.abs(gap) > 1e-6 + 1e-6 * np.abs(self.displacement[1:])):
            k = int(np.argmax(np.abs(gap)))
            raise SimulationError(
                f"From {self.time[k]:g} to {self.time[k + 1]:g} s the slide's speeds and "
                f"displacements differ by {1e3 * gap[k]:.3g} mm; leave the speeds out or correct "
                f"them."
            )
        acceleration = np.diff(self.speed) / step
        least, most = self._reach(acceleration)
        self._require("stroke", "m", most, self.limits.stroke)
        self._require("speed", "m/s", float(np.abs(self.speed).max()), self.limits.speed)
        sharpest = float(np.abs(acceleration).max(initial=0.0))
        self._require("acceleration", "m/s²", sharpest, self.limits.acceleration)
        if least < -1e-9:
            raise SimulationError(
                f"The slide goes {-1e3 * least:.3g} mm beyond the tip; "
                f"displacements run from 0, the tip, towards the base."
            )

    def _reach(self, acceleration: Array) -> tuple[float, float]:
        """Least and largest displacement, turning points between knots included."""
        turning = self.speed[1:] * self.speed[:-1] < 0.0
        sharp = np.where(turning, acceleration, 1.0)
        peaks = np.where(turning, self.displacement[:-1] - 0.5 * self.speed[:-1] ** 2 / sharp, 0.0)
        places = np.concatenate([self.displacement, peaks[turning]])
        return float(places.min()), float(places.max())

    @staticmethod
    def _require(what: str, unit: str, value: float, limit: float) -> None:
        if value > limit * (1.0 + _SLACK) + 1e-12:
            raise SimulationError(
                f"The slide's {what} would be {value:.4g} {unit}; the stage allows {limit:g} "
                f"{unit}. Ask for less, or for a stage that can."
            )

    @property
    def duration(self) -> float:
        """Time of the last knot, seconds."""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> Array:
        """Displacement (…) in metres at times (…)."""
        t = np.clip(np.asarray(time, dtype=float), self.time[0], self.time[-1])
        k, into = self._piece(t)
        step = self.time[k + 1] - self.time[k]
        acceleration = (self.speed[k + 1] - self.speed[k]) / step
        return self.displacement[k] + into * (self.speed[k] + 0.5 * acceleration * into)

    def speed_at(self, time: ArrayLike) -> Array:
        """Speed (…) in m/s, positive towards the base; zero while the stage holds."""
        t = np.asarray(time, dtype=float)
        moving = (t >= self.time[0]) & (t <= self.time[-1])
        k, into = self._piece(np.clip(t, self.time[0], self.time[-1]))
        share = into / (self.time[k + 1] - self.time[k])
        return np.where(moving, self.speed[k] + share * (self.speed[k + 1] - self.speed[k]), 0.0)

    def _piece(self, time: Array) -> tuple[np.ndarray, Array]:
        k = np.clip(np.searchsorted(self.time, time, "right") - 1, 0, self.time.size - 2)
        return k, time - self.time[k]

    @staticmethod
    def hold(displacement: float, duration: float, limits: SlideLimits) -> SlidePath:
        """Path of a sensor that rests at a displacement, m, for a duration, s."""
        if not (np.isfinite(duration) and duration > 0.0):
            raise SimulationError(f"A slide of {duration:g} s cannot be; give seconds above zero.")
        still = np.full(2, float(displacement))
        return SlidePath(np.array([0.0, duration]), still, np.zeros(2), limits)

    @staticmethod
    def moves(stops: ArrayLike, limits: SlideLimits, *, speed: float | None = None) -> SlidePath:
        """Path between stops (S,), m, as fast as `speed` (by default the limit) and limits allow.

        The speed profile of a move is a trapezoid, or a triangle where the move is short.
        """
        places = np.asarray(stops, dtype=float)
        cruise = limits.speed if speed is None else speed
        if not (np.isfinite(cruise) and cruise > 0.0):
            raise SimulationError(f"A slide at {cruise:g} m/s cannot be; give a speed above zero.")
        SlidePath._require("speed", "m/s", cruise, limits.speed)
        pieces = [
            _trapezoid(low, high, cruise, limits.acceleration)
            for low, high in pairwise(places)
            if abs(high - low) > _SHORTEST_MOVE
        ]
        return SlidePath._joined(float(places[0]), pieces, limits)

    @staticmethod
    def oscillate(
        cycles: int, stroke: float, limits: SlideLimits, *, speed: float | None = None
    ) -> SlidePath:
        """Path from the tip `stroke` metres towards the base and back, `cycles` times."""
        if not (0 < cycles <= _CYCLES and cycles == int(cycles)):
            raise SimulationError(
                f"{cycles:g} cycles cannot be; give a whole number from 1 to {_CYCLES:,}."
            )
        if not (np.isfinite(stroke) and stroke > 0.0):
            raise SimulationError(f"A stroke of {stroke:g} m cannot be; give metres above zero.")
        return SlidePath.moves([0.0, *[stroke, 0.0] * int(cycles)], limits, speed=speed)

    @staticmethod
    def calibrate(duration: float, stroke: float, limits: SlideLimits) -> SlidePath:
        """Path back and forth over a stroke at the limiting speed, with a rest at each stop.

        A lag shifts the sensor in proportion to speed, play also at rest: both can be estimated.
        """
        SlidePath.hold(0.0, duration, limits), SlidePath.oscillate(1, stroke, limits)  # checks
        pieces, place, spent = [], 0.0, 0.0
        for turn in cycle([0.5, 0.25, 0.75, 0.5, 1.0, 0.5, 0.75, 0.25, 0.5, 0.0]):
            target = turn * stroke
            move = _trapezoid(place, target, limits.speed, limits.acceleration)
            lasts = float(move[0].sum()) + _REST
            if spent + lasts >= duration:
                break
            pieces += [move, _rest_piece(_REST)]
            place, spent = target, spent + lasts
        return SlidePath._joined(0.0, [*pieces, _rest_piece(duration - spent)], limits)

    @staticmethod
    def waypoints(time: ArrayLike, displacement: ArrayLike, limits: SlideLimits) -> SlidePath:
        """Path through displacements (K,) at times (K,), at rest at each, at the least speed."""
        times, places = np.asarray(time, dtype=float), np.asarray(displacement, dtype=float)
        _require_increasing(times)
        pieces = []
        for k, (way, span) in enumerate(zip(np.diff(places), np.diff(times), strict=True)):
            most = limits.acceleration
            square = span**2 - 4.0 * abs(way) / most
            if square < 0.0:
                raise SimulationError(
                    f"From {times[k]:g} to {times[k + 1]:g} s the slide would move "
                    f"{1e3 * abs(way):.4g} mm from rest to rest; at {most:g} m/s² that takes "
                    f"{2.0 * np.sqrt(abs(way) / most):.3g} s. Give it more time."
                )
            cruise = 2.0 * abs(way) / (span + np.sqrt(square))
            SlidePath._require("speed", "m/s", cruise, limits.speed)
            if abs(way) < _SHORTEST_MOVE:
                pieces.append(_rest_piece(span))
            else:
                pieces.append(_trapezoid(places[k], places[k + 1], cruise, most))
        path = SlidePath._joined(float(places[0]), pieces, limits)
        return SlidePath(path.time + times[0], path.displacement, path.speed, limits)

    @staticmethod
    def _joined(
        start: float, pieces: Sequence[tuple[Array, Array, Array]], limits: SlideLimits
    ) -> SlidePath:
        """Path from pieces, each given as (durations, displacements, speeds at the ends)."""
        durations, ways, speeds = (
            np.concatenate([np.zeros(1), *(piece[i] for piece in pieces)]) for i in range(3)
        )
        return SlidePath(np.cumsum(durations), start + np.cumsum(ways), speeds, limits)


def _require_increasing(time: Array) -> None:
    if time.size < 2 or not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0.0):
        raise SimulationError("The times of a slide path must be two or more, and increase.")


def _rest_piece(duration: float) -> tuple[Array, Array, Array]:
    return np.array([duration]), np.zeros(1), np.zeros(1)


def _trapezoid(low: float, high: float, cruise: float, most: float) -> tuple[Array, Array, Array]:
    """Durations, displacements and end speeds of the phases of a move from rest to rest."""
    way, sign = abs(high - low), float(np.sign(high - low))
    top = min(cruise, np.sqrt(way * most))
    ramp, level = top / most, max(way / top - top / most, 0.0)
    durations, ways = [ramp, level, ramp], [0.5 * top * ramp, top * level, 0.5 * top * ramp]
    lasting = np.array([True, level > 1e-12, True])
    speeds = sign * np.array([top, top, 0.0])
    return np.array(durations)[lasting], sign * np.array(ways)[lasting], speeds[lasting]


def read_slide(path: Path, limits: SlideLimits, drawn_out: float | None = None) -> SlidePath:
    """Read a path from a CSV with columns time,displacement (rest at each) or with speed, too.

    If `drawn_out`, the arclength of the sensor at zero displacement in metres, is given, a column
    arclength may replace displacement; speed is then the rate of arclength. Raises SimulationError
    that names the invalid row.
    """
    head, rows = _read_rows(path)
    place = "arclength" if "arclength" in head and drawn_out is not None else "displacement"
    if not {"time", place} <= set(head):
        raise SimulationError(f"Slide {path.name} must have the columns time,displacement.")
    names = [name for name in ("time", place, "speed") if name in head]
    table = np.empty((len(rows), len(names)))
    for number, row in enumerate(rows):
        try:
            table[number] = [float(row[head.index(name)]) for name in names]
        except (IndexError, ValueError):
            table[number] = np.nan
        if not np.all(np.isfinite(table[number])):
            raise SimulationError(
                f"{path.name} row {number + 1}: give a number each for {', '.join(names)}."
            )
    unknown = set(head) - {"time", place, "speed"}
    if unknown:
        raise SimulationError(
            f"Slide {path.name} has a column {sorted(unknown)[0]!r}; columns are time, {place} and "
            f"speed."
        )
    if len(table) and table[0, 0] < 0.0:
        raise SimulationError(
            f"Slide {path.name} begins at {table[0, 0]:g} s; begin at 0 or later."
        )
    if place == "arclength":
        assert drawn_out is not None
        table[:, 1:] = [drawn_out, *[0.0] * (len(names) - 2)] - table[:, 1:]
    if len(names) == 3:
        _require_increasing(table[:, 0])
        return SlidePath(table[:, 0], table[:, 1], table[:, 2], limits)
    return SlidePath.waypoints(table[:, 0], table[:, 1], limits)


def _read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Column names of a CSV file, and the rows after them."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        raise SimulationError(f"Slide {path} cannot be read ({problem}).") from None
    return [name.strip() for name in rows[0]] if rows else [], rows[1:]
