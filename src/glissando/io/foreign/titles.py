"""Finding columns of a delimited text by their titles, or by their numbers from 1."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path

from glissando.errors import RecordingError
from glissando.io.foreign.delimited import REMARKS, Line


def titled(path: Path, lines: list[Line], wanted: Sequence[str]) -> tuple[list[str], list[Line]]:
    """Titles of the columns, empty for columns without a title, and the rows below them.

    If all wanted columns are given by number, all titles are empty. The line of titles may be
    marked as a comment.

    Args:
        path: File, for messages.
        lines: Lines of the file.
        wanted: Columns by title or by number, that of the clock first.

    Raises:
        RecordingError: No line has these titles, or it has more titles than the rows have cells.
    """
    named = [column for column in wanted if not column.isdecimal()]
    if not named:
        first = next(
            (k for k, (_, cells) in enumerate(lines) if _is_row(cells, wanted)), len(lines)
        )
        return _padded([], lines[first:]), lines[first:]
    for k, (number, cells) in enumerate(lines):
        rows = lines[k + 1 :]
        for titles in (_uncommented(cells, rows), cells):
            if all(name in titles for name in named):
                _require_width(path, number, titles, rows)
                return _padded(titles, rows), rows
    shown = ", ".join(repr(c) for c in (lines[0][1] if lines else []))[:200]
    raise RecordingError(
        f"{path.name} has no line with the titles {', '.join(named)}; it begins with {shown}. Name "
        f"columns as the file does, or by number from 1."
    )


def _padded(titles: list[str], rows: list[Line]) -> list[str]:
    """Titles, with empty ones for further columns of the rows."""
    return titles + [""] * (_width(rows) - len(titles))


def _uncommented(titles: list[str], rows: list[Line]) -> list[str]:
    """Titles without the comment character, which may be a cell of its own."""
    if titles[0] in REMARKS and _width(rows) < len(titles):
        return titles[1:]
    return [titles[0].lstrip("".join(REMARKS)).lstrip(), *titles[1:]]


def _require_width(path: Path, number: int, titles: list[str], rows: list[Line]) -> None:
    last = max(k for k, title in enumerate(titles, start=1) if title)
    if 0 < _width(rows) < last:
        raise RecordingError(
            f"{path.name} line {number} has {last} titles, and the rows below it up to "
            f"{_width(rows)} cells: which column each names is not clear; give columns by number "
            f"from 1."
        )


def _width(rows: list[Line]) -> int:
    return max((len(cells) for _, cells in rows), default=0)


def _is_row(cells: list[str], wanted: Sequence[str]) -> bool:
    """Whether the clock's cell of a line is a number or a date."""
    at = int(wanted[0]) - 1
    try:
        float(dated(cells, at)[at])
    except (IndexError, ValueError):
        return False
    return True


def find(path: Path, titles: list[str], column: str) -> int:
    """Index of a column, from 0, given by its title or its number from 1.

    Raises:
        RecordingError: There is no such column, or several have the title.
    """
    if titles.count(column) > 1:
        raise RecordingError(
            f"{path.name} has {titles.count(column)} columns {column!r}; give the number of "
            f"the one that is meant, from 1."
        )
    if column in titles:
        return titles.index(column)
    if column.isdecimal() and 0 < int(column) <= len(titles):
        return int(column) - 1
    named = ", ".join(filter(None, titles))
    has = f"it has {named or f'{len(titles)} columns, numbered from 1'}"
    raise RecordingError(f"{path.name} has no column {column!r}; {has}.")


def dated(cells: list[str], clock: int) -> list[str]:
    """Cells in which an ISO 8601 date in the column `clock` is replaced by seconds since 1970."""
    if clock < len(cells) and cells[clock][4:5] == "-":
        try:
            stamp = datetime.datetime.fromisoformat(cells[clock])
        except ValueError:
            return cells
        stamp = stamp if stamp.tzinfo else stamp.replace(tzinfo=datetime.UTC)
        cells = [*cells]
        cells[clock] = repr(stamp.timestamp())
    return cells
