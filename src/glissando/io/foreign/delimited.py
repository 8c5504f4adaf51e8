"""Text in columns, however it is delimited, with points or commas in its numbers."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from glissando.geometry.se3 import Array
from glissando.io.foreign.tracks import as_numbers, require_ahead, text_lines

_DELIMITERS = "\t;,"
_COMMA = re.compile(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*")
_LOOKED_AT = 200  # lines by which the delimiter is chosen
Line = tuple[int, list[str]]
"""The number of a line and its cells."""


def cells_of(path: Path) -> list[Line]:
    """The lines of a text as cells, whose decimal commas have become points.

    The delimiter is that of tab, semicolon and comma which most lines have, in this order where
    two are alike; without any, blanks part the cells.

    Raises:
        RecordingError: The file cannot be read.
    """
    lines = text_lines(path)
    some = [line for line in lines[:_LOOKED_AT] if line.strip()]
    most = max(_DELIMITERS, key=lambda d: sum(d in line for line in some))
    if not any(most in line for line in some):
        most = " "
    out = []
    for number, line in enumerate(lines, start=1):
        cells = line.split() if most == " " else [cell.strip() for cell in line.split(most)]
        if most != ",":
            cells = [c.replace(",", ".") if _COMMA.fullmatch(c) else c for c in cells]
        out.append((number, [cell.strip('"') for cell in cells]))
    return out


@dataclass(frozen=True)
class Samples:
    """Rows of one object that were seen.

    Attributes:
        time: Increasing times (M,), s.
        values: Numbers (M, C) as the file has them.
        missing: Number of rows in which it was not seen.
    """

    time: Array
    values: Array
    missing: int


def samples(
    path: Path,
    rows: list[Line],
    clock: int,
    columns: list[int],
    seconds: float,
    *,
    zeros: bool = False,
) -> Samples:
    """The rows of one object; a row that repeats the clock of the one before is left out.

    Args:
        path: The file, for messages.
        rows: The rows.
        clock: Column of the clock.
        columns: Columns of the object's numbers.
        seconds: Seconds of one unit of the clock.
        zeros: Whether nothing but zeros is a reading, where it else says that nothing was seen.

    Raises:
        RecordingError: A cell is no number, or the clock goes back, with the line.
    """
    times, values, missing, before = [], [], 0, -np.inf
    for line, cells in rows:
        cells = cells + [""] * (1 + max([clock, *columns]) - len(cells))
        tick = as_numbers(path, line, [cells[clock]])
        if tick is None or tick[0] == before:
            missing += tick is None
            continue
        require_ahead(path, line, before, tick[0])
        before = float(tick[0])
        numbers = as_numbers(path, line, [cells[c] for c in columns])
        if numbers is None or not (zeros or numbers.any()):
            missing += 1
            continue
        times.append(before * seconds)
        values.append(numbers)
    return Samples(np.array(times), np.array(values).reshape(-1, len(columns)), missing)
