"""Cells of delimited text files, with decimal points or decimal commas."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.foreign.tracks import (
    REPEATED,
    SAME_TIME,
    as_numbers,
    require_ahead,
    text_lines,
)

_DELIMITERS = "\t;,"
_COMMA = re.compile(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*")
_POINT = re.compile(r"[-+]?\d*\.\d+([eE][-+]?\d+)?")
_BLANKS = re.compile(r'"[^"]*"|\S+')
_LOOKED_AT = 200  # lines from which the delimiter is chosen
REMARKS = ("#", "%")
"""First characters of a comment line, which may be the line of titles."""
Line = tuple[int, list[str]]
"""Number of a line, from 1, and its cells."""


class CommaNumber(str):
    """A number whose decimal comma has become a point."""


def cells_of(path: Path) -> list[Line]:
    """Read the lines of a text as cells, with decimal commas replaced by points.

    The delimiter is the one of tab, semicolon and comma that occurs in most lines, and the first in
    this order in a tie; without any, or if commas occur as decimal commas only, it is white space.

    Raises:
        RecordingError: The file cannot be read.
    """
    lines = text_lines(path)
    delimiter = _delimiter(lines)
    out: list[Line] = []
    for number, line in enumerate(lines, start=1):
        cells = line.split(delimiter) if delimiter else _BLANKS.findall(line) or [""]
        cells = [cell.strip() for cell in cells]
        if delimiter != ",":
            cells = [CommaNumber(c.replace(",", ".")) if _COMMA.fullmatch(c) else c for c in cells]
        if out or any(cells):  # empty lines before the first do not count
            unquoted = [c if isinstance(c, CommaNumber) else c.strip('"') for c in cells]
            out.append((number, unquoted))
    return out


def _require_one_mark(path: Path, line: int, cells: list[str]) -> None:
    """Raise RecordingError if some numbers of a line have a comma and others a point."""
    commas = [cell for cell in cells if isinstance(cell, CommaNumber)]
    points = [
        cell for cell in cells if not isinstance(cell, CommaNumber) and _POINT.fullmatch(cell)
    ]
    if commas and points:
        comma = commas[0].replace(".", ",")
        raise RecordingError(
            f"{path.name} line {line} has {comma} with a comma and {points[0]} with a point, so "
            f"one of both parts thousands; write numbers without it."
        )


def _delimiter(lines: list[str]) -> str:
    """Delimiter that occurs in most lines other than comments; empty for white space."""
    sample = [line for line in lines[:_LOOKED_AT] if line.strip()]
    sample = [line for line in sample if not line.lstrip().startswith(REMARKS)] or sample
    commonest = max(_DELIMITERS, key=lambda d: sum(d in line for line in sample))
    containing = [line for line in sample if commonest in line]
    if commonest == "," and 2 * sum(map(_separated_by_blanks, containing)) > len(containing):
        return ""
    return commonest if containing else ""


def _separated_by_blanks(line: str) -> bool:
    """Whether a line's cells are separated by white space and its commas are decimal commas."""
    cells = line.split()
    return len(cells) > 1 and all("," not in c or _COMMA.fullmatch(c) for c in cells)


@dataclass(frozen=True)
class Samples:
    """Valid rows of one object.

    Attributes:
        time: Increasing times (M,), s.
        values: Numbers (M, C) in the file's units.
        missing: Number of rows without a measurement of the object.
        dropped: Number of rows left out, by reason.
    """

    time: Array
    values: Array
    missing: int
    dropped: dict[str, int]


def samples(
    path: Path,
    rows: list[Line],
    clock: int,
    columns: list[int],
    seconds: float,
    *,
    zeros: bool = False,
) -> Samples:
    """Valid rows of one object; rows with the time of the one before are left out and counted.

    Args:
        path: File, for messages.
        rows: Rows of the file.
        clock: Column of the clock, from 0.
        columns: Columns of the object's numbers, from 0.
        seconds: Seconds of one unit of the clock.
        zeros: Whether a row of zeros is a measurement; else it counts as missing.

    Raises:
        RecordingError: A cell is not a number, one has a comma and another a point, or the clock
            goes back, with the line; or the clock is so coarse that at least half of the rows have
            the time of the row before with other values.
    """
    times: list[float] = []
    values: list[Array] = []
    dropped: Counter[str] = Counter()
    missing, previous = 0, -np.inf
    for line, cells in rows:
        cells = cells + [""] * (1 + max([clock, *columns]) - len(cells))
        _require_one_mark(path, line, [cells[c] for c in (clock, *columns)])
        tick = as_numbers(path, line, [cells[clock]])
        if tick is None:
            missing += 1
            continue
        if tick[0] != previous:
            require_ahead(path, line, previous, tick[0])
        previous = float(tick[0])
        numbers = as_numbers(path, line, [cells[c] for c in columns])
        if numbers is None or not (zeros or numbers.any()):
            missing += 1
        elif times and times[-1] == previous:
            dropped[REPEATED if np.array_equal(numbers, values[-1]) else SAME_TIME] += 1
        else:
            times.append(previous)
            values.append(numbers)
    _require_fine_clock(path, len(times), dropped[SAME_TIME])
    table = np.array(values).reshape(-1, len(columns))
    return Samples(seconds * np.array(times), table, missing, {**dropped})


def _require_fine_clock(path: Path, distinct: int, other: int) -> None:
    if other and other >= distinct:
        raise RecordingError(
            f"{path.name}: {other} of {distinct + other} rows have the time of the row before but "
            f"other values; give a finer clock, or a column that counts rows with its --rate, and "
            f"a file of its own to each object."
        )
