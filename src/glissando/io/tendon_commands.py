"""CSV files of tendon commands: a column of times and one for each tendon."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.foreign.tracks import as_numbers, text_lines
from glissando.model.seconds import seconds


def read_tendon_commands(path: Path, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Read times and displacements of tendons; other columns are ignored.

    Args:
        path: CSV file with the column time, or timestamp, in seconds and one for each tendon: its
            name, in metres, or its name and _mm, in millimetres; or tendon_0, tendon_1, … in the
            order of the names, as in a stream of a recording.
        names: Names of the tendons.

    Returns:
        Times (M,), s, and displacements (M, T), m.

    Raises:
        RecordingError: A column is missing or ambiguous, a cell is not a number, or times do not
            increase.
    """
    lines = text_lines(path)
    head = [cell.strip() for cell in lines[0].split(",")] if lines else []
    columns, scales = _columns(path, head, names)
    rows: list[Array] = []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        values, cells = None, line.split(",")
        if len(cells) == len(head):
            values = as_numbers(path, number, [cells[c] for c in columns])
        if values is None or not np.all(np.isfinite(values)):
            raise RecordingError(
                f"{path.name} line {number}: give a number in each of the {len(head)} columns."
            )
        if rows and values[0] <= rows[-1][0]:
            again = values[0] == rows[-1][0]
            raise RecordingError(
                f"{path.name} line {number}: time {seconds(values[0], decimals=6)} s does not "
                f"follow {seconds(rows[-1][0], decimals=6)} s; "
                f"{'keep one row of a time' if again else 'sort the rows'}."
            )
        rows.append(values)
    if not rows:
        raise RecordingError(f"{path.name} holds no commands; give a row for each time.")
    table = np.array(rows)
    return table[:, 0], table[:, 1:] * scales


def _columns(path: Path, head: list[str], names: tuple[str, ...]) -> tuple[list[int], list[float]]:
    """Columns of the time and of each tendon, and metres for a unit of each tendon's."""
    numbered = tuple(f"tendon_{j}" for j in range(len(names)))
    if set(numbered) <= set(head):
        named = [n for n in head if n.removesuffix("_mm") in set(names) - set(numbered)]
        _require_one(path, "the tendons", [numbered[0], *named[:1]])
        names = numbered
    clocks: tuple[str, ...] = ("time", "timestamp")
    given = [[name for name in clocks if name in head][:1]]
    given += [[n for n in head if n in (name, f"{name}_mm")] for name in names]
    for name, found in zip(["time", *names], given, strict=True):
        if not found:
            raise RecordingError(
                f"{path.name} line 1 has {len(head)} columns and no {name}; give time and a column "
                f"for each of the {len(names)} tendons: {', '.join(names)}."
            )
        _require_one(path, "one tendon", found)
    chosen = [found[0] for found in given]
    scales = [
        1.0 if column == name else 1e-3 for column, name in zip(chosen[1:], names, strict=True)
    ]
    return [head.index(column) for column in chosen], scales


def _require_one(path: Path, what: str, columns: list[str]) -> None:
    """Raise RecordingError if there are several columns for the same quantity."""
    if len(columns) > 1:
        raise RecordingError(
            f"{path.name} line 1 has columns {' and '.join(columns)} for {what}; keep one."
        )
