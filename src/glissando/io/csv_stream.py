"""One CSV file, one stream of rows: read, checked row by row, and cleaned of repeats.

Two dialects: the public space-time files (two header lines, pose rows as se(3) logarithms) and our
own (one header line of named columns). Problems are reported with the file and the line.
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
    """Readings of one stream as a file holds them, without noise.

    Attributes:
        kind: Kind of sensor.
        time: Times (M,), s.
        arclength: Arclengths (M,), m.
        values: Values (M, …) as the kind's readings take them, SI units.
        dropped: Number of rows left out, by reason.
        settings: Settings of the stream that the kind declares.
    """

    kind: str
    time: Array
    arclength: Array
    values: Array
    dropped: dict[str, int]
    settings: Mapping[str, Array] = field(default_factory=dict)

    @property
    def sensor(self) -> type[Readings]:
        """The class that declares the kind."""
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
    """One sensor's rows and their description.

    Attributes:
        name: Name of the stream and of its file.
        rows: The rows.
        truth: Whether estimates are judged by it.
        std: Standard deviations, which override those of the robot file; None to take those.
        mount: Pose T_bc (4, 4) of the sensor in the cross-section.
        keep_repeats: Whether rows that repeat the one before are readings of their own.
        frame: Frame of the rows; streams of a loaded recording are in the world frame.
        channel: The channel beside the backbone that it slides in, if there is one.
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
    """Factor to SI of a declared unit in a file whose lengths and angles are scaled.

    Args:
        unit: Unit in m, rad, 1 and quotients of these.
        length: Metres of the file's unit of length.
        angle: Radians of the file's unit of angle.

    >>> scale_of("rad/m", length=1e-3, angle=1.0)
    1000.0
    """
    scales = {"m": length, "rad": angle}
    above, _, below = unit.partition("/")
    return scales.get(above, 1.0) / scales.get(below, 1.0)


def is_public(path: Path) -> bool:
    """Whether a file begins as a stream of the public space-time recordings does."""
    try:
        require_plain(path)
        with path.open("rb") as file:
            begun = file.read(100)
    except OSError:
        return False
    text = begun.decode("utf-8-sig", "replace")
    return text.lstrip().lower().startswith(_PUBLIC_HEAD)


def read_public(path: Path) -> tuple[Rows, bool]:
    """A stream of the public space-time recordings, and whether it is ground truth.

    Rows are `time, arclength, values`; poses are logarithms [rho, phi] of T_wb.

    Raises:
        RecordingError: The file is not one of those, with the line.
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
    """A stream with one header line of column names, in any order.

    Args:
        path: CSV file.
        kind: Kind of sensor.
        settings: Settings of the stream, SI units.
        length_unit: Metres of the file's unit of length.
        angle_unit: Radians of the file's unit of angle.
        journal: Whether rows may go back in time, be none, and end in an unfinished line.

    Raises:
        RecordingError: A column, a number or the file is missing or wrong, with the line.
    """
    lines = _lines(path, whole=journal)
    if not lines:
        raise RecordingError(f"{path.name} is empty; record some rows or leave the stream out.")
    sensor, settings = sensor_class(kind), settings or {}
    units = {"time": "s", "arclength": "m", **sensor.value_columns(settings)}
    header = [part.strip() for part in lines[0].split(",")]
    twice = [name for name in units if header.count(name) > 1]
    if twice:
        raise RecordingError(f"{path.name} line 1: column {twice[0]} stands there twice; keep one.")
    missing = [name for name in units if name not in header]
    if missing:
        other = '"' in lines[0] or ";" in lines[0] or "\t" in lines[0]
        why = (
            "the file quotes or parts them otherwise: bring it in with glissando import"
            if (other)
            else f"{', '.join(missing)} is missing"
        )
        raise RecordingError(
            f"{path.name} line 1: a {kind} stream needs the columns {','.join(units)}; {why}."
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
    """Write rows as one header line of column names and a line a row, SI units."""
    write_table(path, rows.columns, rows.table())


def clean(rows: Rows, clip: float | None = None, keep_repeats: bool = False) -> Rows:
    """Rows without a tracker's repeats and without clipped samples, which are counted.

    A tracker polled faster than it measures returns the same values again; counted twice they
    would be information twice, and at a sensor's next place they would be wrong as well. A value
    at the end of its sensor's range is only a bound.

    Args:
        rows: The rows.
        clip: Largest value that the sensor can report; None if any.
        keep_repeats: Whether a tracker's rows are left alone.
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
    """Rows at the times of a device that measures `rate` times a second, very nearly steadily.

    A host that polls faster than a tracker measures stamps a value up to one of its own periods
    late. Such rows are numbered by the device's period, found within 0.2 %, and a straight line
    through the stamps is their time; the mean of the stamps stays. Rows of which none was repeated
    keep their stamps. Where the host polls in step with the device (to 0.3 % a simple fraction of
    its period) the lateness drifts as slowly as a clock does and cannot be told from one: times
    are then off by up to the host's period.

    Raises:
        RecordingError: The stamps do not fit such a device.
    """
    if "repeated" not in rows.dropped or len(rows.time) < 3:
        return rows
    elapsed = rows.time - rows.time[0]
    count = int(np.ceil(8.0 * _OFF_RATE * rate * elapsed[-1])) + 2
    near = rate * np.linspace(1.0 - _OFF_RATE, 1.0 + _OFF_RATE, count)
    turns = np.array([np.mean(np.exp(2j * np.pi * f * elapsed)) for f in near])
    best = int(np.argmax(np.abs(turns)))
    number = np.round(near[best] * elapsed - np.angle(turns[best]) / (2.0 * np.pi))
    time = np.polyval(np.polyfit(number, rows.time, 1), number)
    late = float(np.abs(rows.time - time).max())
    if np.any(np.diff(number) < 1.0) or late > 1.0 / rate:
        raise RecordingError(
            f"A {rows.kind} stream's stamps are up to {1e3 * late:.3g} ms from those of a device "
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
    """The lines of a file, or only those that end."""
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
    """The rows from line `first` on as numbers (M, width); at least one with a column `clock`."""
    table = np.empty((max(len(lines) - first, 0), width))
    count, before = 0, -np.inf
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
        if clock is not None and table[count, clock] < before:
            raise RecordingError(
                f"{path.name} line {number}: time goes back from "
                f"{seconds(before, table[count, clock], decimals=6)} s; sort the rows or "
                f"correct the clock."
            )
        before = before if clock is None else table[count, clock]
        count += 1
    if count == 0 and clock is not None:
        raise RecordingError(f"{path.name} holds no rows; record some or leave the stream out.")
    return table[:count]
