"""One CSV file, one stream of rows: read, checked row by row, and cleaned of what repeats.

Two dialects: the public space-time files (two header lines, pose rows as se(3) logarithms) and our
own (one header line of named columns). Problems are reported with the file and the line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array

COLUMNS = {
    "pose": ["x", "y", "z", "qw", "qx", "qy", "qz"],
    "coil": ["x", "y", "z", "qw", "qx", "qy", "qz"],
    "position": ["x", "y", "z"],
    "orientation": ["qw", "qx", "qy", "qz"],
    "gyro": ["wx", "wy", "wz"],
    "strain": ["nu_x", "nu_y", "nu_z", "u_x", "u_y", "u_z"],
    "fbg": [],
}
"""Value columns of each kind of stream, after time and arclength; fbg has one a core."""

_PUBLIC_KINDS = {"aurora": ("pose", False), "vicon": ("pose", True), "gyro": ("gyro", False)}
TRUTH_KINDS = _TRACKERS = ("pose", "coil", "position", "orientation")
_NEAR_CLIP = 0.99  # a gyro within 1 % of its range is taken as clipped
_OFF_RATE = 2e-3  # share by which two clocks may differ


@dataclass(frozen=True)
class Rows:
    """What a file holds: `time` (M,) s, `arclength` (M,) m, `values` (M, …) in SI units.

    Poses are (M, 4, 4), orientations (M, 3, 3). `dropped` counts rows left out, by reason.
    """

    kind: str
    time: Array
    arclength: Array
    values: Array
    dropped: dict[str, int]


def read_public(path: Path) -> tuple[Rows, bool]:
    """A stream of the public space-time recordings, and whether it is ground truth.

    Rows are `time, arclength, values`; poses are logarithms [rho, phi] of T_wb.
    """
    lines = _lines(path)
    head = [part.strip() for part in lines[0].split(",")] if lines else []
    if len(head) < 2 or not head[0].lower().startswith("sensor type"):
        raise RecordingError(
            f"{path.name} line 1: the header has no sensor type; begin the file with "
            f"'sensor type:,aurora' (or gyro, vicon), or describe it in a recording.toml."
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
    cores: int,
    length_unit: float,
    angle_unit: float,
    *,
    journal: bool = False,
) -> Rows:
    """A stream with one header line of column names, in any order; units as factors to SI.

    Rows of a `journal` may go back in time and end in a line that was not finished; they are
    sorted, and there may be none.
    """
    lines = _lines(path, whole=journal)
    if not lines:
        raise RecordingError(f"{path.name} is empty; record some rows or leave the stream out.")
    wanted = ["time", "arclength", *columns_of(kind, cores)]
    found = [part.strip() for part in lines[0].split(",")]
    twice = [name for name in wanted if found.count(name) > 1]
    if twice:
        raise RecordingError(f"{path.name} line 1: column {twice[0]} stands there twice; keep one.")
    missing = [name for name in wanted if name not in found]
    if missing:
        raise RecordingError(
            f"{path.name} line 1: a {kind} stream needs the columns {', '.join(wanted)}; "
            f"{', '.join(missing)} is missing."
        )
    clock = found.index("time")
    table = _numbers(path, lines, 1, len(found), None if journal else clock)
    if journal:
        table = table[np.argsort(table[:, clock], kind="stable")]
    table = table[:, [found.index(name) for name in wanted]]
    time, arclength, values = table[:, 0], table[:, 1] * length_unit, table[:, 2:]
    if kind in ("pose", "coil", "position"):
        values[:, :3] *= length_unit
    if kind == "gyro":
        values = values * angle_unit
    if kind == "strain":
        values[:, 3:] *= angle_unit / length_unit
    if kind in ("pose", "coil", "orientation"):
        values = _oriented(path, values, first=1)
    return Rows(kind, time, arclength, values, {})


def columns_of(kind: str, cores: int) -> list[str]:
    """Value columns of a kind of stream; `cores` counts those of a fibre."""
    return COLUMNS[kind] or [f"strain_{i}" for i in range(cores)]


def table_of(rows: Rows) -> Array:
    """Rows as numbers (M, 2 + columns) in the order of their columns, SI units."""
    values = rows.values.reshape(len(rows.time), -1)
    if rows.kind in ("pose", "coil"):
        quaternion = se3.quaternion(rows.values[:, :3, :3])
        values = np.hstack([rows.values[:, :3, 3], quaternion])
    elif rows.kind == "orientation":
        values = se3.quaternion(rows.values)
    return np.column_stack([rows.time, rows.arclength, values])


def write_named(path: Path, rows: Rows) -> None:
    """Write rows as one header line of column names and a line a row, SI units."""
    table = table_of(rows)
    header = ",".join(["time", "arclength", *columns_of(rows.kind, table.shape[1] - 2)])
    np.savetxt(path, table, "%.12g", ",", header=header, comments="")


def clean(rows: Rows, clip: float | None = None, keep_repeats: bool = False) -> Rows:
    """Rows without a tracker's repeats and a gyro's clipped samples, which are counted.

    A tracker polled faster than it measures returns the same values again; counted twice they
    would be information twice, and at a sensor's next place they would be wrong as well. A gyro at
    the end of its range only gives a bound. `keep_repeats` leaves a tracker's rows alone.
    """
    if len(rows.time) == 0 or (rows.kind in _TRACKERS and keep_repeats):
        return rows
    flat = rows.values.reshape(len(rows.time), -1)
    if rows.kind in _TRACKERS:
        same = np.all(np.diff(flat, axis=0) == 0.0, axis=1)
        if rows.kind == "orientation":  # a straight robot has one orientation at many places
            same &= np.diff(rows.arclength) == 0.0
        reason, bad = "repeated", np.append(False, same)[: len(flat)]
    elif rows.kind == "gyro" and clip is not None:
        reason, bad = "clipped", np.any(np.abs(flat) >= _NEAR_CLIP * clip, axis=1)
    else:
        return rows
    dropped = {**rows.dropped, **({reason: int(bad.sum())} if bad.any() else {})}
    return Rows(rows.kind, rows.time[~bad], rows.arclength[~bad], rows.values[~bad], dropped)


def steady(rows: Rows, rate: float) -> Rows:
    """Rows at the times of a device that measures `rate` times a second, very nearly steadily.

    A host that asks faster than a tracker measures stamps a value when it is picked up, up to one
    of its own periods after it was there. Such rows are numbered by the device's period, found
    within 0.2 %, and a straight line through the stamps is their time; on average no stamp moves.
    Rows none of which was repeated were not asked for too fast, and are left alone. Where the host
    asks in step with the device (to 0.3 % a simple fraction of its period) how late it is drifts as
    slowly as a clock does and passes for one: times are then off by up to the host's period. Raises
    RecordingError when the stamps do not fit such a device.
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


def _oriented(path: Path, values: Array, first: int) -> Array:
    """Poses (M, 4, 4) or rotations (M, 3, 3) from rows that end in a quaternion [w, x, y, z]."""
    norm = np.linalg.norm(values[:, -4:], axis=1)
    if np.any(np.abs(norm - 1.0) > 0.01):
        row = int(np.argmax(np.abs(norm - 1.0)))
        raise RecordingError(
            f"{path.name} line {row + first + 1}: the quaternion has norm {norm[row]:.3g}; give a "
            f"unit quaternion qw, qx, qy, qz."
        )
    rotation = se3.rotation_from_quaternion(values[:, -4:])
    if values.shape[1] == 4:
        return rotation
    pose = np.tile(np.eye(4), (len(values), 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = rotation, values[:, :3]
    return pose


def _lines(path: Path, *, whole: bool = False) -> list[str]:
    """The lines of a file; only whole ones if asked."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        return (text[: text.rfind("\n") + 1] if whole else text).splitlines()
    except OSError as problem:
        raise RecordingError(
            f"Stream file {path} cannot be read ({problem.strerror}); check the name."
        ) from None
    except UnicodeDecodeError:
        raise RecordingError(f"{path.name} is not a text file; give CSV in UTF-8.") from None


def _numbers(
    path: Path, lines: list[str], first: int, width: int, clock: int | None = None
) -> Array:
    """The rows from line `first` on as numbers (M, width).

    With a column `clock`, which must not go backwards, there must be some.
    """
    table = np.empty((len(lines) - min(first, len(lines)), width))
    count = 0
    before = -np.inf
    for number, line in enumerate(lines[first:], start=first + 1):
        if not line.strip():
            continue
        parts = line.split(",")
        if len(parts) != width:
            raise RecordingError(
                f"{path.name} line {number}: {len(parts)} columns where {width} are expected; "
                f"correct or delete that line."
            )
        try:
            table[count] = parts
        except ValueError:
            bad = next(part for part in parts if not _is_float(part))
            raise RecordingError(
                f"{path.name} line {number}: {bad.strip()!r} is not a number; correct or delete "
                f"that line."
            ) from None
        if not np.all(np.isfinite(table[count])):
            raise RecordingError(
                f"{path.name} line {number}: a value is not finite ({line.strip()[:60]}); delete "
                f"that line, gaps are normal."
            )
        if clock is not None:
            if table[count, clock] < before:
                raise RecordingError(
                    f"{path.name} line {number}: time goes back from {before:g} s to "
                    f"{table[count, clock]:g} s; sort the rows or correct the clock."
                )
            before = table[count, clock]
        count += 1
    if count == 0 and clock is not None:
        raise RecordingError(f"{path.name} holds no rows; record some or leave the stream out.")
    return table[:count]


def _is_float(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
