"""Tracks, the result of every reader of foreign files, and functions that the readers share."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.plain_file import plain_text

_NO_NUMBER = 1e20  # NDI's devices write -3.697314e28 for a missing value
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Metres of each unit of length, by its name in files."""
REPEATED, SAME_TIME = "that repeat another row", "with the time of another row but other values"
"""Reasons for which rows are left out."""


@dataclass(frozen=True)
class Track:
    """Measurements of one object of a foreign file, whose arclength the file does not state.

    Attributes:
        name: Name of the object.
        kind: Kind of sensor, such as pose, coil, position or tendon.
        time: Increasing times (M,), s.
        values: Values (M, …) of the kind, SI units: poses (M, 4, 4), positions (M, 3),
            displacements (M, T), …
        missing: Number of rows without a measurement of the object.
        frame: Name of the frame of the values.
        absolute: Whether times are those of a clock, which may count from 1970, not of frames.
        numbered: Whether rows have frame numbers, so that repeated values are new measurements.
        dropped: Number of other rows left out, by reason.
        columns: Names of the columns of values; empty if the file does not name them.
    """

    name: str
    kind: str
    time: Array
    values: Array
    missing: int = 0
    frame: str = "world"
    absolute: bool = False
    numbered: bool = True
    dropped: Mapping[str, int] = field(default_factory=dict)
    columns: tuple[str, ...] = ()


def plain_name(text: str) -> str:
    """Name that is safe in file names: other characters than letters, digits, _ . - become _.

    >>> plain_name("Snake:Tip marker")
    'Snake_Tip_marker'
    """
    return re.sub(r"[^\w.-]+", "_", text).strip("_.") or "unnamed"


def text_lines(path: Path) -> list[str]:
    """Lines of a text file in UTF-8, in UTF-16 with a byte order mark, or in Windows-1252.

    Raises:
        RecordingError: The file cannot be read.
    """
    try:
        return plain_text(path, otherwise="cp1252").splitlines()
    except OSError as problem:
        raise RecordingError(f"{path} cannot be read ({problem.strerror}).") from None


def as_numbers(path: Path, line: int, cells: Sequence[str]) -> Array | None:
    """Numbers in the cells of a line; None if one is empty, NaN or huge: a missing measurement.

    Raises:
        RecordingError: A cell is not a number; the message names the line.
    """
    if any(not cell.strip() for cell in cells):
        return None
    try:
        values = np.array([float(cell) for cell in cells])
    except ValueError:
        shown = ",".join(cells)[:60]
        raise RecordingError(
            f"{path.name} line {line}: {shown!r} is not all numbers; correct or delete that line."
        ) from None
    return values if np.all(np.abs(values) < _NO_NUMBER) else None


def require_ahead(path: Path, line: int, before: float, frame: float) -> None:
    """Raise RecordingError unless a frame number, or time, is larger than the one before."""
    if not frame > before:
        raise RecordingError(
            f"{path.name} line {line}: frame or time {frame:.15g} follows {before:.15g}; sort the "
            f"rows, or make it two files if the device was started again there."
        )


def require_no_rate(path: Path, rate: float | None) -> None:
    """Raise RecordingError if a rate is given, which has no effect on a file with times."""
    if rate is not None:
        raise RecordingError(
            f"{path.name} states the times of its rows, so --rate {rate:g} has no effect; "
            f"leave it out, or name the files that need one, --rate FILE=HZ."
        )


def unit_rotations(path: Path, quaternion: Array) -> Array:
    """Rotations (M, 3, 3) of quaternions w, x, y, z (M, 4) of a file.

    Raises:
        RecordingError: The norm of one of them is not 1.
    """
    norm = np.linalg.norm(quaternion, axis=1)
    if np.any(np.abs(norm - 1.0) > 0.01):
        raise RecordingError(
            f"{path.name}: a quaternion has norm {norm[np.argmax(np.abs(norm - 1))]:.3g}; check "
            f"which columns are qw, qx, qy and qz."
        )
    return se3.rotation_from_quaternion(quaternion)
