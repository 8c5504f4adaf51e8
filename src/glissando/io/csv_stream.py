"""Streams of readings in CSV files: reading, checks row by row, removal of repeated rows.

There are two layouts: that of the public space-time recordings (two header lines, poses as se(3)
logarithms) and our own (one header line of named columns). Errors name the file and the line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.atomic import write_table
from glissando.io.plain_file import plain_text, require_plain
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import sensor_class
from glissando.model.short_repr import ShortRepr
from glissando.model.tendons.channel import Channel

_PUBLIC_HEAD = "sensor type"
_PUBLIC_KINDS = {"aurora": ("pose", False), "vicon": ("pose", True), "gyro": ("gyro", False)}
_QUATERNION = ["qw", "qx", "qy", "qz"]
_NEAR_CLIP = 0.99  # a value within 1 % of its sensor's range is taken as clipped
_OFF_RATE = 2e-3  # share by which two clocks may differ


@dataclass(frozen=True)
class Rows(ShortRepr):
    """Readings of one stream as stored in a file, without their noise covariance.

    Attributes:
        kind: Kind of sensor.
        time: Times (M,), s.
        arclength: Arclengths (M,), m.
        values: Values (M, …) in the shape of the kind's readings, SI units.
        dropped: Number of rows left out, by reason.
        settings: Constants of the stream that its kind of sensor declares, by name, SI units.
    """

    kind: str
    time: Array
    arclength: Array
    values: Array
    dropped: dict[str, int]
    settings: Mapping[str, Array] = field(default_factory=dict)

    @property
    def sensor(self) -> type[Readings]:
        """Class of readings that declares the kind."""
        return sensor_class(self.kind)

    @property
    def columns(self) -> list[str]:
        """Names of a file's columns."""
        return ["time", "arclength", *self.sensor.value_columns(self.settings)]

    def table(self) -> Array:
        """The rows as numbers (M, C) in the order of `columns`, SI units."""
        return np.column_stack([self.time, self.arclength, self.sensor.to_columns(self.values)])


@dataclass(frozen=True)
class Stream(ShortRepr):
    """One sensor's rows and the description of the sensor.

    Attributes:
        name: Name of the stream and of its file.
        rows: The rows.
        truth: Whether the stream is ground truth, with which estimates are compared.
        std: Standard deviations of the sensor's noise; None to take those of the robot file.
        mount: Pose T_bc (4, 4) of the sensor in the cross-section.
        keep_repeats: Whether a row with the values of the row before is a new measurement.
        frame: Frame of the rows; a loaded recording's are in the world unless it is unknown.
        channel: Channel beside the backbone in which the sensor slides; None for the backbone.
    """

    name: str
    rows: Rows
    truth: bool = False
    std: Array | None = None
    mount: Array = field(default_factory=lambda: np.eye(4))
    keep_repeats: bool = False
    frame: str = "world"
    channel: Channel | None = None


def scale_of(unit: str, length: float, angle: float) -> float:
    """Factor from a file's unit to SI, where the file has its own units of length and angle.

    Args:
        unit: Declared unit in m, rad, 1 and quotients of these.
        length: Metres of the file's unit of length.
        angle: Radians of the file's unit of angle.

    >>> scale_of("rad/m", length=1e-3, angle=1.0)
    1000.0
    """
    scales = {"m": length, "rad": angle}
    numerator, _, denominator = unit.partition("/")
    return scales.get(numerator, 1.0) / scales.get(denominator, 1.0)


def is_public(path: Path) -> bool:
    """Whether a file begins with the header of a stream of the public space-time recordings."""
    try:
        require_plain(path)
        with path.open("rb") as file:
            start = file.read(100)
    except OSError:
        return False
    text = start.decode("utf-8-sig", "replace")
    return text.lstrip().lower().startswith(_PUBLIC_HEAD)


def read_public(path: Path) -> tuple[Rows, bool]:
    """Read a stream of the public space-time recordings, and whether it is ground truth.

    Rows are `time, arclength, values`; poses are logarithms [rho, phi] of T_wb.

    Raises:
        RecordingError: The file has another layout or a wrong row; the message names the line.
    """
    lines = _lines(path)
    head = [part.strip() for part in lines[0].split(",")] if lines else []
    if len(head) < 2 or not head[0].lower().startswith(_PUBLIC_HEAD):
        raise RecordingError(
            f"{path.name} line 1: the header has no sensor type, as those of the public recordings "
            f"have. Name the folder's streams and their kinds in a recording.toml, see "
            f"docs/recordings.md, or bring files of other programs in with glissando import."
        )
    if head[1].lower() not in _PUBLIC_KINDS:
        raise RecordingError(
            f"{path.name} line 1: unknown sensor type {head[1]!r}; known types are "
            f"{', '.join(_PUBLIC_KINDS)}."
        )
    kind, truth = _PUBLIC_KINDS[head[1].lower()]
    width = 8 if kind == "pose" else 5
    table = _numbers(path, lines, first=2, width=width, clock=0)
    values = se3.exp(table[:, 2:]) if kind == "pose" else table[:, 2:]
    return clean(Rows(kind, table[:, 0], table[:, 1], values, {})), truth


def read_named(
    path: Path,
    kind: str,
    settings: Mapping[str, Array] | None = None,
    *,
    length_unit: float = 1.0,
    angle_unit: float = 1.0,
    journal: bool = False,
) -> Rows:
    """Read a stream with one header line of column names, in any order.

    Args:
        path: CSV file.
        kind: Kind of sensor.
        settings: Constants of the stream that its kind declares, by name, SI units.
        length_unit: Metres of the file's unit of length.
        angle_unit: Radians of the file's unit of angle.
        journal: Whether to allow times out of order, no rows, and an unfinished last line; rows
            are then sorted by time.

    Raises:
        RecordingError: A column, a number or the file is missing or wrong; the message names the
            line.
    """
    lines = _lines(path, whole=journal)
    if not lines:
        raise RecordingError(f"{path.name} is empty; record some rows or leave the stream out.")
    sensor, settings = sensor_class(kind), settings or {}
    units = {"time": "s", "arclength": "m", **sensor.value_columns(settings)}
    header = [part.strip() for part in lines[0].split(",")]
    repeated = [name for name in units if header.count(name) > 1]
    if repeated:
        raise RecordingError(
            f"{path.name} line 1: column {repeated[0]} stands there twice; keep one."
        )
    missing = [name for name in units if name not in header]
    if missing:
        other_layout = '"' in lines[0] or ";" in lines[0] or "\t" in lines[0]
        cause = (
            "the file quotes or parts them otherwise: bring it in with glissando import"
            if (other_layout)
            else f"{', '.join(missing)} is missing"
        )
        raise RecordingError(
            f"{path.name} line 1: a {kind} stream needs the columns {','.join(units)}; {cause}."
        )
    clock = header.index("time")
    table = _numbers(path, lines, 1, len(header), None if journal else clock)
    if set(_QUATERNION) <= units.keys():
        _require_unit(path, lines, table[:, [header.index(name) for name in _QUATERNION]])
    if journal:
        table = table[np.argsort(table[:, clock], kind="stable")]
    table = table[:, [header.index(name) for name in units]]
    table *= [scale_of(unit, length_unit, angle_unit) for unit in units.values()]
    values = sensor.from_columns(table[:, 2:])
    return Rows(kind, table[:, 0], table[:, 1], values, {}, settings)


def write_named(path: Path, rows: Rows) -> None:
    """Write rows as CSV with one header line of column names, SI units."""
    write_table(path, rows.columns, rows.table())


def clean(rows: Rows, clip: float | None = None, keep_repeats: bool = False) -> Rows:
    """Remove a tracker's repeated rows and other sensors' clipped rows, and count them.

    A tracker polled faster than it measures returns the same values again. They carry no new
    information, and are wrong if the sensor has moved on meanwhile. A value at the end of its
    sensor's range is only a bound.

    Args:
        rows: Rows of one stream.
        clip: Largest absolute value that the sensor can report; None if unlimited.
        keep_repeats: Whether to keep a tracker's repeated rows.

    Returns:
        Remaining rows, whose `dropped` counts the removed ones.
    """
    if len(rows.time) == 0 or (rows.sensor.tracker and keep_repeats):
        return rows
    if rows.sensor.tracker:
        reason, bad = "repeated", rows.sensor.repeated(rows.values, rows.arclength)
    elif clip is not None:
        flat = rows.values.reshape(len(rows.time), -1)
        reason, bad = "clipped", np.any(np.abs(flat) >= _NEAR_CLIP * clip, axis=1)
    else:
        return rows
    if not bad.any():
        return rows
    dropped = {**rows.dropped, reason: int(bad.sum())}
    time, arclength, values = (a[~bad] for a in (rows.time, rows.arclength, rows.values))
    return Rows(rows.kind, time, arclength, values, dropped, rows.settings)


def steady(rows: Rows, rate: float) -> Rows:
    """Replace time stamps by the times of a device that measures at a constant rate, Hz.

    A host that polls faster than a tracker measures stamps a value up to one polling period late.
    The device's period is estimated within 0.2 % of 1/`rate`, each row is numbered by it, and a
    line fitted to stamps over numbers gives the times; the mean stamp is unchanged. Rows among
    which none was repeated keep their stamps. If the polling period is within 0.3 % of a simple
    fraction of the device's period, the lateness drifts as slowly as a clock and cannot be
    separated from it: times are then wrong by up to the polling period.

    Raises:
        RecordingError: The stamps do not fit a device of this rate.
    """
    if "repeated" not in rows.dropped or len(rows.time) < 3:
        return rows
    elapsed = rows.time - rows.time[0]
    count = int(np.ceil(8.0 * _OFF_RATE * rate * elapsed[-1])) + 2
    rates = rate * np.linspace(1.0 - _OFF_RATE, 1.0 + _OFF_RATE, count)
    phasors = np.array([np.mean(np.exp(2j * np.pi * f * elapsed)) for f in rates])
    best = int(np.argmax(np.abs(phasors)))
    number = np.round(rates[best] * elapsed - np.angle(phasors[best]) / (2.0 * np.pi))
    time = np.polyval(np.polyfit(number, rows.time, 1), number)
    error = float(np.abs(rows.time - time).max())
    if np.any(np.diff(number) < 1.0) or error > 1.0 / rate:
        raise RecordingError(
            f"A {rows.kind} stream's stamps are up to {1e3 * error:.3g} ms from those of a device "
            f"that measures {rate:g} times a second; correct or leave out its rate."
        )
    return replace(rows, time=time)


def _require_unit(path: Path, lines: list[str], quaternion: Array) -> None:
    """Raise RecordingError, with the line, unless every quaternion (M, 4) has norm one."""
    norm = np.linalg.norm(quaternion, axis=1)
    if np.any(np.abs(norm - 1.0) > 0.01):
        row = int(np.argmax(np.abs(norm - 1.0)))
        line = [number for number, line in enumerate(lines, start=1) if line.strip()][row + 1]
        raise RecordingError(
            f"{path.name} line {line}: the quaternion has norm {norm[row]:.3g}; give a "
            f"unit quaternion qw, qx, qy, qz."
        )


def _lines(path: Path, *, whole: bool = False) -> list[str]:
    """Lines of a file; if `whole`, without an unfinished last line."""
    try:
        text = plain_text(path)
    except OSError as problem:
        raise RecordingError(
            f"Stream file {path} cannot be read ({problem.strerror}); check the name."
        ) from None
    except UnicodeDecodeError:
        raise RecordingError(f"{path.name} is not a text file; give CSV in UTF-8.") from None
    return (text[: text.rfind("\n") + 1] if whole else text).splitlines()


def _numbers(
    path: Path, lines: list[str], first: int, width: int, clock: int | None = None
) -> Array:
    """Numbers (M, width) of the rows after the first `first` lines; empty lines are skipped.

    With a column `clock`, there must be a row and the clock must not decrease.
    """
    table = np.empty((max(len(lines) - first, 0), width))
    count, previous = 0, -np.inf
    for number, line in enumerate(lines[first:], start=first + 1):
        if not line.strip():
            continue
        cells, problem = line.split(","), ""
        try:
            if len(cells) != width:
                problem = f"{len(cells)} columns where {width} are expected; correct or delete"
            else:
                table[count] = cells
                if not np.all(np.isfinite(table[count])):
                    problem = (
                        f"a value is not finite ({line.strip()[:60]}); gaps are normal, delete"
                    )
        except ValueError as error:
            cell = str(error).rpartition(": ")[2]
            problem = f"{cell} is not a number; correct or delete"
        if problem:
            raise RecordingError(f"{path.name} line {number}: {problem} that line.")
        if clock is not None and table[count, clock] < previous:
            raise RecordingError(
                f"{path.name} line {number}: time goes back from "
                f"{seconds(previous, table[count, clock], decimals=6)} s; sort the rows or "
                f"correct the clock."
            )
        previous = previous if clock is None else table[count, clock]
        count += 1
    if count == 0 and clock is not None:
        raise RecordingError(f"{path.name} holds no rows; record some or leave the stream out.")
    return table[:count]
