"""Import of CSV files of tendon-driven robots: displacements of servos, position of a marker.

The layout is that of `data/sysid` of the OpenCR project: timestamp (s since 1970), pattern_label,
servo_<id>_mm for each tendon, tip_x, tip_y, tip_z (mm). Displacements are positive when a tendon is
pulled: the robot bends towards the tendon whose displacement increases.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.foreign.tracks import Track, as_numbers, text_lines

_SERVO = re.compile(r"servo_\w+_mm")
MARKER = "tip"
_TIP = ("tip_x", "tip_y", "tip_z")


@dataclass(frozen=True)
class ServoLog:
    """Rows of a file of servos and a marker.

    Attributes:
        names: Names of the servos, in the order of the tendons.
        time: Times (M,), s since 1970.
        displacement: Displacements (M, T), positive when pulled, m.
        tip: Positions (M, 3) of the marker, m.
        pattern: Label of the motion pattern of each row (M,); empty if there is none.
        missing: Number of rows left out because the marker is missing.
    """

    names: tuple[str, ...]
    time: Array
    displacement: Array
    tip: Array
    pattern: list[str]
    missing: int = 0


def is_servo_header(cells: list[str]) -> bool:
    """Whether the cells of a first line are the titles of this layout."""
    return cells[0] == "timestamp" and any(_SERVO.fullmatch(cell) for cell in cells)


def read_servo_csv(path: Path) -> ServoLog:
    """Read the rows of a file, sorted by time; rows without a marker are left out.

    Raises:
        RecordingError: A column is missing, or a cell is not a number.
    """
    lines = text_lines(path)
    head = [cell.strip() for cell in lines[0].split(",")] if lines else []
    servos = [name for name in head if _SERVO.fullmatch(name)]
    missing = [name for name in ("timestamp", *_TIP) if name not in head]
    if missing or not servos:
        raise RecordingError(
            f"{path.name} line 1: {', '.join(missing) or 'servo_<id>_mm'} is missing; give the "
            f"columns timestamp, servo_<id>_mm for each tendon, tip_x, tip_y and tip_z."
        )
    wanted = [head.index(name) for name in ("timestamp", *servos, *_TIP)]
    label = head.index("pattern_label") if "pattern_label" in head else None
    rows, patterns, unseen = [], [], 0
    for number, line in enumerate(lines[1:], start=2):
        cells = line.split(",")
        if len(cells) != len(head):
            if line.strip():
                raise RecordingError(
                    f"{path.name} line {number}: {len(cells)} columns where {len(head)} are "
                    f"expected; correct or delete that line."
                )
            continue
        values = as_numbers(path, number, [cells[c] for c in wanted])
        if values is not None:
            rows.append(values)
            patterns.append("" if label is None else cells[label].strip())
        else:
            unseen += 1
    if not rows:
        raise RecordingError(f"{path.name} holds no rows with a marker; record some.")
    table = np.array(rows)
    order = np.argsort(table[:, 0], kind="stable")
    table = table[order] * np.r_[1.0, np.full(len(wanted) - 1, 1e-3)]
    names = tuple(name.removesuffix("_mm") for name in servos)
    log = table[:, 0], table[:, 1:-3], table[:, -3:], [patterns[i] for i in order]
    return ServoLog(names, *log, unseen)


def servo_tracks(path: Path) -> list[Track]:
    """Read the displacements as a track of kind tendon, and the marker as one of kind position."""
    log = read_servo_csv(path)
    pulled, missing = log.displacement, log.missing
    return [
        Track("tendons", "tendon", log.time, pulled, missing, absolute=True, columns=log.names),
        Track(MARKER, "position", log.time, log.tip, missing, absolute=True),
    ]
