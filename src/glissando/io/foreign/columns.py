"""Import of any delimited text, by a mapping from quantities to columns.

The mapping is a line, time=t,x=px,…,length=mm, or a TOML file with a table for each object. A
column is given by its title, or by its number from 1. The columns of an object determine its kind:
x, y, z are a position, and with a rotation a pose; columns of another kind of sensor, such as
wx, wy, wz of a gyroscope, are readings of that kind. A rotation is qw, qx, qy, qz, a rotation
vector rx, ry, rz, or Euler angles a1, a2, a3 about the axes in `euler`: capitals for intrinsic
rotations, small letters for extrinsic ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.csv_stream import scale_of
from glissando.io.foreign.delimited import Line, cells_of, samples
from glissando.io.foreign.titles import dated, find, titled
from glissando.io.foreign.tracks import (
    LENGTHS,
    Track,
    plain_name,
    require_no_rate,
    unit_rotations,
)
from glissando.io.toml_table import read_toml
from glissando.model.sensors.readings import SENSORS
from glissando.model.table import Table

_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_ANGLES = {"rad": 1.0, "deg": np.pi / 180.0}
_PLACE, _QUATERNION = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
_VECTOR, _TURNS = ("rx", "ry", "rz"), ("a1", "a2", "a3")
EPOCH = 1e8
"""Times, s, larger than this are taken to count from 1970."""


def read_path(path: Path, columns: str) -> tuple[Array, Array]:
    """Read the path of a sliding sensor from a delimited text.

    Args:
        path: Text file.
        columns: Mapping with time and arclength, or with time, travel, zero, the arclength at
            travel zero, and optionally direction=1 if arclength grows with travel. Empty for
            time=time,arclength=arclength.

    Returns:
        Times (M,), s, and arclengths (M,), m.

    Raises:
        RecordingError: A column is missing, a row is invalid, or time does not increase.
    """
    table = Table(_entries(columns or "time=time,arclength=arclength"), "--columns", RecordingError)
    clock, seconds = table.text("time"), _TIMES[table.text("clock", "s", choices=_TIMES)]
    length = LENGTHS[table.text("length", "m", choices=LENGTHS)]
    zero, slope, place = 0.0, 1.0, "arclength"
    if table.peek("travel") is not None:
        zero, place = _number(table, "zero", None), "travel"
        slope = _number(table, "direction", -1.0)
    wanted = [clock, table.text(place)]
    table.close()
    if slope not in (1.0, -1.0):
        raise table.fail("direction", f"is {slope:g}; give 1 or -1.")
    lines = [(number, cells) for number, cells in cells_of(path) if any(cells)]
    titles, rows = titled(path, lines, wanted)
    at = [find(path, titles, column) for column in wanted]
    seen = samples(path, rows, at[0], at[1:], seconds, zeros=True)
    if seen.time.size < 2:
        raise RecordingError(f"{path.name} holds fewer than two rows; a path needs them.")
    return seen.time, zero + slope * length * seen.values[:, 0]


def _number(table: Table, key: str, default: float | None) -> float:
    """Number of a mapping's key, which may be given as text."""
    value = table.text(key, None if default is None else repr(default))
    try:
        return float(value)
    except ValueError:
        raise table.fail(key, f"is {value!r}; give a number.") from None


@dataclass(frozen=True)
class Mapping:
    """Columns of a file by the quantities in them.

    Attributes:
        clock: Column of the time, or of the frame number if `counts`.
        objects: For each object, by name, its columns by the quantities in them.
        counts: Whether the clock counts frames.
        seconds: Seconds of the clock's unit.
        length: Metres of the file's unit of length.
        angle: Radians of the file's unit of angle.
        euler: Axes of the angles a1, a2, a3 in their order; capitals for intrinsic rotations.
        frame: Name of the frame of the values.
    """

    clock: str
    objects: dict[str, dict[str, str]]
    counts: bool = False
    seconds: float = 1.0
    length: float = 1.0
    angle: float = 1.0
    euler: str = ""
    frame: str = "world"


def parse_mapping(text: str, name: str) -> Mapping:
    """Parse a mapping: a line `time=…,x=…` for one object, or a TOML file.

    Args:
        text: The line, or a path that ends in .toml.
        name: Name of the object that a line describes.

    Raises:
        RecordingError: A key is missing, unknown or has an invalid value.
    """
    if text.endswith(".toml"):
        return _mapping(read_toml(Path(text), RecordingError))
    entries = _entries(text)
    general = {key: entries.pop(key) for key in _GENERAL if key in entries}
    return _mapping(Table({**general, "objects": {name: entries}}, "--columns", RecordingError))


def _entries(text: str) -> dict[str, str]:
    """Columns of a line KEY=COLUMN,… by key."""
    entries = {}
    for part in text.split(","):
        key, equals, value = part.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise RecordingError(
                f"--columns: {part!r} is not KEY=COLUMN; write time=1,x=2,… or name a .toml file."
            )
        entries[key.strip()] = value.strip()
    return entries


_LIKE = 0.75  # similarity from which a key is taken for a misspelling of another
_GENERAL = ("time", "count", "clock", "length", "angle", "euler", "frame")


def _mapping(table: Table) -> Mapping:
    counts = table.peek("count") is not None
    given = {key: table.peek(key) is not None for key in ("euler", "angle")}
    clock = _column(table, "count" if counts else "time")
    if counts and table.peek("clock") is not None:
        raise table.fail("clock", "has no effect on count; leave it out, and give --rate HZ.")
    seconds = _TIMES[table.text("clock", "s", choices=_TIMES)]
    length = LENGTHS[table.text("length", "m", choices=LENGTHS)]
    angle = _ANGLES[table.text("angle", "rad", choices=_ANGLES)]
    euler, frame = table.text("euler", ""), table.text("frame", "world")
    if euler and (
        sorted(euler.lower()) != ["x", "y", "z"] or not (euler.isupper() or euler.islower())
    ):
        raise table.fail("euler", f"is {euler!r}; give three axes such as ZYX, or zyx for fixed.")
    objects = {}
    for name, entries in table.named_tables("objects"):
        objects[name] = {key: _column(entries, key) for key in entries.names()}
        if clock in objects[name].values():
            key = next(k for k, column in objects[name].items() if column == clock)
            raise entries.fail(key, f"is the column of the time, {clock}; give it its own.")
    table.close()
    if not objects or not all(objects.values()):
        raise table.fail("objects", "name no column; give x, y, z or those of another sensor.")
    used = {key for columns in objects.values() for key in columns}
    if given["euler"] and not used & set(_TURNS):
        raise table.fail("euler", "has no effect on columns without a1, a2, a3; leave it out.")
    if given["angle"] and not used & _angles():
        raise table.fail("angle", "has no effect on columns without angles; leave it out.")
    return Mapping(clock, objects, counts, seconds, length, angle, euler, frame)


def _angles() -> set[str]:
    """Keys of columns whose numbers are in the unit of angle."""
    sensors = [sensor.value_columns({}) for sensor in SENSORS.values() if not sensor.settings]
    units = [pair for columns in sensors for pair in columns.items()]
    return {*_VECTOR, *_TURNS, *(key for key, unit in units if "rad" in unit)}


def _column(table: Table, key: str) -> str:
    """Title of a column, or its number as text."""
    value = table.peek(key)
    return str(int(table.number(key))) if isinstance(value, int) else table.text(key)


def read_columns(path: Path, mapping: Mapping, rate: float | None) -> list[Track]:
    """Read the objects of a delimited text.

    Args:
        path: Text file.
        mapping: Columns of the file.
        rate: Frames a second, if the clock counts frames; else None.

    Raises:
        RecordingError: A column is missing, or a row is invalid; the message names the line.
    """
    if mapping.counts and rate is None:
        raise RecordingError(f"{path.name} counts frames; give their rate with --rate HZ.")
    if not mapping.counts:
        require_no_rate(path, rate)
    kinds = {name: _kind(path, mapping, name, c) for name, c in mapping.objects.items()}
    lines = [(number, cells) for number, cells in cells_of(path) if any(cells)]
    wanted = [mapping.clock, *(c for columns in mapping.objects.values() for c in columns.values())]
    titles, read = titled(path, lines, wanted)
    clock = find(path, titles, mapping.clock)
    rows = [(number, dated(cells, clock)) for number, cells in read]
    if mapping.seconds != 1.0 and any(
        cells != was for (_, cells), (_, was) in zip(rows, read, strict=True)
    ):
        raise RecordingError(f"{path.name} has dates for times; leave out clock=, of numbers.")
    seconds = 1.0 / rate if mapping.counts and rate else mapping.seconds
    return [
        _track(path, mapping, name, kinds[name], (titles, rows, clock, seconds))
        for name in mapping.objects
    ]


def _track(
    path: Path,
    mapping: Mapping,
    name: str,
    read_as: tuple[str, tuple[str, ...]],
    parts: tuple[list[str], list[Line], int, float],
) -> Track:
    (kind, keys), (titles, rows, clock, seconds) = read_as, parts
    columns = mapping.objects[name]
    at = [find(path, titles, columns[key]) for key in keys]
    for key, column in zip(keys, at, strict=True):
        if at.count(column) > 1:
            others = [k for k, c in zip(keys, at, strict=True) if c == column and k != key]
            raise RecordingError(
                f"--columns of {name}: {key} and {others[0]} are one column of {path.name}; give "
                f"each its own."
            )
    zeros = "x" not in keys  # trackers write zeros for an object that is not visible
    seen = samples(path, rows, clock, at, seconds, zeros=zeros)
    if keys[-4:] == _QUATERNION:  # all zeros: trackers write that for an object that is not visible
        invisible = ~np.any(seen.values[:, -4:], axis=1)
        seen = replace(
            seen, time=seen.time[~invisible], values=seen.values[~invisible],
            missing=seen.missing + int(invisible.sum()),
        )  # fmt: skip
    values = _values(path, mapping, kind, keys, seen.values)
    absolute = bool(seen.time.size and seen.time[0] > EPOCH)
    return Track(
        plain_name(name),
        kind,
        seen.time,
        values,
        seen.missing,
        mapping.frame,
        absolute=absolute,
        dropped=seen.dropped,
    )


def _kind(
    path: Path, mapping: Mapping, name: str, columns: dict[str, str]
) -> tuple[str, tuple[str, ...]]:
    """Kind of an object by the keys of its columns, and the keys in the kind's order."""
    given = set(columns)
    for turn in (_QUATERNION, _VECTOR, _TURNS):
        if given == {*_PLACE, *turn}:
            if turn == _TURNS and not mapping.euler:
                raise RecordingError(f"--columns of {name}: say the axes of a1, a2, a3, euler=ZYX.")
            return "pose", (*_PLACE, *turn)
    kinds = {k: tuple(s.value_columns({})) for k, s in SENSORS.items() if not s.settings}
    for kind, keys in kinds.items():
        if given == set(keys):
            return kind, keys
    for key in sorted(given.difference(*kinds.values())):
        similar = get_close_matches(key, _GENERAL, 1, _LIKE)
        if similar:
            raise RecordingError(
                f"--columns of {name}: {key} is not a column; is {similar[0]} meant?"
            )
    known = "; ".join(f"{kind}: {','.join(keys)}" for kind, keys in kinds.items())
    raise RecordingError(
        f"{path.name}: the columns {','.join(sorted(given))} of {name!r} make no sensor; give all "
        f"of one of {known}; a pose may have rx,ry,rz or a1,a2,a3 for its rotation."
    )


def _values(path: Path, mapping: Mapping, kind: str, keys: tuple[str, ...], table: Array) -> Array:
    """Values of a kind of sensor, SI units, from numbers (M, C) of the file in order of `keys`."""
    if kind == "pose":
        turn = table[:, 3:]
        if keys[3:] == _QUATERNION:
            return se3.pose(unit_rotations(path, turn), mapping.length * table[:, :3])
        _require_radians(path, mapping, turn)
        if keys[3:] == _VECTOR:
            rotation = se3.so3_exp(mapping.angle * turn)
        else:
            rotation = Rotation.from_euler(mapping.euler, mapping.angle * turn).as_matrix()
        return se3.pose(rotation, mapping.length * table[:, :3])
    if keys[-4:] == _QUATERNION:
        unit_rotations(path, table[:, -4:])  # or raises
    sensor = SENSORS[kind]
    units = sensor.value_columns({})
    scale = [scale_of(units[key], mapping.length, mapping.angle) for key in keys]
    return sensor.from_columns(table * scale)


def _require_radians(path: Path, mapping: Mapping, turn: Array) -> None:
    """Raise RecordingError for angles (M, 3) beyond a whole turn, given as radians: degrees."""
    size = np.nan_to_num(np.abs(turn)).max(axis=1, initial=0.0)  # NaN: not visible
    if mapping.angle == 1.0 and size.max(initial=0.0) > 2.0 * np.pi:
        row = int(size.argmax())
        raise RecordingError(
            f"{path.name}: row {row} turns by {size[row]:.3g} rad, more than a whole turn; if "
            f"these are degrees, say angle=deg in --columns."
        )
