"""Import of CSV files of NDI's Track and ToolBox, and of programs that write the same columns.

Each tool has a block of columns: Port …, Frame, Time [sec], Face, State, Q0 Qx Qy Qz, Tx Ty Tz
(mm), Error, and for optical tools the markers; a file without a Port has one block. Rz Ry Rx in
place of the quaternion are Euler angles in degrees, R = Rz Ry Rx [inferred from NDI's guides]. A
tool that is not visible has a State other than OK, empty cells, or the device's huge negative
number. [inferred]: State is OK for a valid row, and a row with an empty or absent State counts as
valid; a tool with one coil measures only its direction, so rows are read as a 'coil', which ignores
roll, unless the user gives another kind.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.io.foreign.delimited import cells_of
from glissando.io.foreign.tracks import (
    REPEATED,
    Track,
    as_numbers,
    plain_name,
    require_ahead,
    require_no_rate,
)

_PLACE = ["tx", "ty", "tz"]
_VALUES, _EULER = ["q0", "qx", "qy", "qz", *_PLACE], ["rz", "ry", "rx", *_PLACE]
_FRAMES, _STATES = ("frame#", "frame"), ("state", "transformstatus", "status")
_TIMES = ("time [sec]", "time")
_VALID = ("", "OK", "ENABLED", "VALID")  # [inferred] beyond OK


def is_ndi_header(cells: list[str]) -> bool:
    """Whether the cells of a first line name the columns of an NDI file."""
    return bool(_columns([cell.lower() for cell in cells]))


def _columns(labels: list[str]) -> list[str]:
    """Names of the columns of quaternions, else of Euler angles, else none."""
    return next((names for names in (_VALUES, _EULER) if set(names) <= set(labels)), [])


def read_ndi_csv(path: Path, rate: float | None) -> list[Track]:
    """Read the tools of an NDI CSV file, in the tracker's frame.

    Args:
        path: CSV file.
        rate: Frames a second, to compute times from frame numbers since the first; None to take
            the column of times.

    Raises:
        RecordingError: There are no times, or a row or a column is invalid.
    """
    lines = cells_of(path)
    heads = lines[0][1]
    starts = [c for c, head in enumerate(heads) if head.lower().startswith("port")] or [0]
    rows = [(number, cells) for number, cells in lines[1:] if any(cells)]
    if not rows:
        raise RecordingError(f"{path.name} holds no rows; record some.")
    return [_tool(path, heads, *span, rows, rate) for span in pairwise([*starts, len(heads)])]


def _tool(
    path: Path,
    heads: list[str],
    start: int,
    end: int,
    rows: list[tuple[int, list[str]]],
    rate: float | None,
) -> Track:
    labels = [head.lower() for head in heads[start:end]]
    columns = _columns(labels)
    if not columns:
        lacking = [name for name in _VALUES if name not in labels]
        raise RecordingError(
            f"{path.name}: {heads[start]!r} lacks the columns {', '.join(lacking)}; export "
            f"quaternions and positions."
        )
    at = [start + labels.index(name) for name in columns]
    clock, absolute = _clock(path, labels, rate)
    state = next((start + labels.index(s) for s in _STATES if s in labels), None)
    times, values, missing, repeated = [], [], 0, 0
    first = before = -np.inf
    for line, cells in rows:
        cells += [""] * (len(heads) - len(cells))
        tick = as_numbers(path, line, [cells[start + clock]])
        if tick is None or tick[0] == before:  # missing, or polled faster than it measures
            missing, repeated = missing + (tick is None), repeated + (tick is not None)
            continue
        require_ahead(path, line, before, tick[0])
        before, first = tick[0], tick[0] if first == -np.inf else first
        numbers = as_numbers(path, line, [cells[c] for c in at])
        valid = state is None or cells[state].upper() in _VALID
        if numbers is None or not valid or not numbers[: 4 if columns == _VALUES else 6].any():
            missing += 1
            continue
        times.append(tick[0] if absolute else (tick[0] - first) / (rate or 1.0))
        values.append(numbers)
    name = _tool_name(heads[start], rows[0][1][start], path)
    table = np.array(values).reshape(-1, len(columns))
    if columns == _VALUES:
        turn = se3.rotation_from_quaternion(table[:, :4])
    else:
        turn = Rotation.from_euler("ZYX", table[:, :3], degrees=True).as_matrix()
    pose = se3.pose(turn, 1e-3 * table[:, -3:])
    track = Track(name, "coil", np.array(times), pose, missing, "tracker", absolute=absolute)
    return replace(track, dropped={REPEATED: repeated})


def _clock(path: Path, labels: list[str], rate: float | None) -> tuple[int, bool]:
    """Column of the clock within a block, and whether it holds times, s, rather than frames."""
    frame = next((labels.index(name) for name in _FRAMES if name in labels), None)
    if rate is not None and frame is not None:
        return frame, False
    clock = next((labels.index(name) for name in _TIMES if name in labels), None)
    if clock is None:
        raise RecordingError(
            f"{path.name} has no times; give the rate at which its frames count with --rate HZ (an "
            f"Aurora's is 40)."
        )
    require_no_rate(path, rate)
    return clock, True


def _tool_name(head: str, cell: str, path: Path) -> str:
    """Name of a tool: 'Port 0x01: Tip coil  s/n:3E' gives Tip_coil, 'Port 1' gives Port_1."""
    if not head.lower().startswith("port"):
        return plain_name(path.stem)
    label = cell if cell.lower().startswith("port") else head
    name = label.partition(":")[2].partition("s/n:")[0].strip()
    return plain_name(name or label)
