"""Import of TSV files of Qualisys Track Manager, with header: markers (3D), rigid bodies (6D).

A file has lines of a name and a value, among them FREQUENCY, DATA_INCLUDED and the names of markers
or bodies; then, optionally, a line of column titles, in which case each row begins with its frame
and time; then a row a frame, in millimetres. Frame 1 is time 0; rows without titles are consecutive
frames. [inferred], to be verified on an export of one's own: a marker that is not visible has zeros
or empty cells, a body zeros or NaN; the nine elements of a body's rotation matrix are in
column-major order.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.io.foreign.delimited import Line, cells_of, samples
from glissando.io.foreign.tracks import Track, plain_name

_MM = 1e-3
_BODY, _TURN = 16, 7  # number of columns of a body, and the first of its rotation


def is_qualisys_header(cells: list[str]) -> bool:
    """Whether the cells of a first line begin the header of a Qualisys file."""
    return cells[0] in ("FILE_VERSION", "NO_OF_FRAMES")


def read_qualisys_tsv(path: Path, rate: float | None) -> list[Track]:
    """Read the markers or rigid bodies of a Qualisys TSV file.

    Args:
        path: TSV file.
        rate: Frames a second; None to take the header's FREQUENCY.

    Raises:
        RecordingError: The header is incomplete, or a row is invalid.
    """
    header, titles, rows = _parts(cells_of(path))
    hz = rate or _frequency(path, header)
    bodies = header.get("DATA_INCLUDED", ["3D"])[0].upper() == "6D"
    names = [n for n in header.get("BODY_NAMES" if bodies else "MARKER_NAMES", []) if n]
    if not names or not rows:
        raise RecordingError(
            f"{path.name} names no markers or bodies, or has no rows; export it anew."
        )
    counted = bool(titles) and titles[0].lower() == "frame"
    if not counted:
        rows = [(number, [str(k), *cells]) for k, (number, cells) in enumerate(rows, start=1)]
    first = 2 if counted else 1
    width = _BODY if bodies else 3
    tracks = []
    for k, name in enumerate(names):
        start = first + k * width
        turn = range(start + _TURN, start + _TURN + 9) if bodies else range(0)
        seen = samples(path, rows, 0, [*range(start, start + 3), *turn], 1.0)
        time = (seen.time - 1.0) / hz
        at = _MM * seen.values[:, :3]
        if not bodies:
            track = Track(plain_name(name), "position", time, at, seen.missing)
        else:
            matrix = seen.values[:, 3:].reshape(-1, 3, 3).swapaxes(1, 2)
            proper = np.abs(np.linalg.det(matrix) - 1.0) < 1e-2
            pose = se3.pose(_orthonormal(matrix[proper]), at[proper])
            lost = seen.missing + int(np.sum(~proper))
            track = Track(plain_name(name), "pose", time[proper], pose, lost)
        tracks.append(replace(track, dropped=seen.dropped))
    return tracks


def _parts(lines: list[Line]) -> tuple[dict[str, list[str]], list[str], list[Line]]:
    """Values of the header by name, the titles of the columns (empty without), and the rows."""
    header: dict[str, list[str]] = {}
    titles: list[str] = []
    rows: list[Line] = []
    for number, cells in lines:
        if not any(cells):
            continue
        if rows or _is_number(cells[0]):
            rows.append((number, cells))
        elif (cells[0].isupper() and "_" in cells[0]) or cells[0] in ("FREQUENCY", "DESCRIPTION"):
            header[cells[0]] = cells[1:]
        else:
            titles = cells
    return header, titles, rows


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _frequency(path: Path, header: dict[str, list[str]]) -> float:
    value = header.get("FREQUENCY", [""])[0]
    if not _is_number(value) or not 0.0 < float(value) < np.inf:
        raise RecordingError(
            f"{path.name}: FREQUENCY is {value!r}; give the frames a second with --rate HZ."
        )
    return float(value)


def _orthonormal(matrix: np.ndarray) -> np.ndarray:
    """Rotations nearest to matrices (M, 3, 3) with rounded elements."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)
