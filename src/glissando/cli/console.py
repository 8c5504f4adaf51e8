"""Console output of commands: tables, errors against truth, and sensor parameters."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console as RichConsole
from rich.markup import escape
from rich.table import Table

_WIDE = 10_000  # columns of a file or a pipe, so that no line is cut
_PARAMETER_UNITS = {
    "frame": (("mm", 1e3, 3), ("mrad", 1e3, 3)),
    "mount": (("mm", 1e3, 3), ("mrad", 1e3, 3)),
    **dict.fromkeys(("arclength_offset", "slide_play"), (("mm", 1e3, 1),)),
    **dict.fromkeys(("time_offset", "slide_lag"), (("ms", 1e3, 1),)),
}
_OF_TRUTH = {  # heading, scale and format by the key of a summary
    "position_rmse": ("position (mm)", 1e3, "{:.2f}"),
    "rotation_rmse": ("rotation (deg)", math.degrees(1.0), "{:.2f}"),
    "nees_position": ("NEES / dof", 1.0, "{:.2f}"),
    "coverage95_position": ("inside 95 %", 100.0, "{:.1f} %"),
}
TRUTH_HEADINGS = tuple(heading for heading, *_ in _OF_TRUTH.values())
"""Headings of the columns of `truth_cells`."""


class Console(RichConsole):
    """A console that leaves a broken pipe to `main`, and does not wrap output to files.

    Output that is not a terminal gets whole lines, unless the environment sets COLUMNS.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        if not self.is_terminal and "COLUMNS" not in os.environ:
            self.width = _WIDE

    def on_broken_pipe(self) -> None:
        """Raise BrokenPipeError, where Rich would exit."""
        raise BrokenPipeError


def number_table(title: str, numbers: Sequence[str], *, left: Sequence[str] = ()) -> Table:
    """A table with left-aligned columns `left`, then right-aligned columns of numbers."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    for heading in left:
        table.add_column(heading, overflow="fold")
    for heading in numbers:
        table.add_column(heading, justify="right")
    return table


def print_rows_dropped(dropped: Mapping[str, Mapping[str, int]], console: Console) -> None:
    """Print how many rows of a recording were dropped, by stream and reason."""
    for name, reasons in dropped.items():
        counted = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
        console.print(f"  {escape(name)}: {counted} rows dropped in the whole recording")


def site_table(title: str, headings: Sequence[str]) -> Table:
    """A table with a row for each site, for 80 columns; long names are wrapped, numbers not."""
    table = Table(
        title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True
    )
    table.add_column("site", overflow="fold")
    for heading in headings:
        table.add_column(heading, justify="right")
    return table


def truth_cells(
    summary: Mapping[str, float | None], keys: Sequence[str] = tuple(_OF_TRUTH)
) -> list[str]:
    """Cells for the errors of an `Errors.summary`; – for errors that truth does not determine.

    >>> truth_cells({"position_rmse": 0.00123, "rotation_rmse": None}, ("position_rmse",))
    ['1.23']
    """
    known = [(summary.get(key), *_OF_TRUTH[key][1:]) for key in keys]
    return ["–" if value is None else form.format(size * value) for value, size, form in known]


def parameter_text(kind: str, value: Sequence[float], std: Sequence[float]) -> str:
    """Values of a sensor parameter with standard deviations, unless these are 0, and units.

    >>> parameter_text("time_offset", [0.012], [0.0003])
    '12 ± 0.3 ms'
    """
    parts = _PARAMETER_UNITS.get(kind, (("", 1.0, len(value)),))
    out, at = [], 0
    for unit, size, count in parts:
        pairs = zip(value[at : at + count], std[at : at + count], strict=True)
        numbers = [f"{size * v:.4g}" + (f" ± {size * s:.2g}" if s else "") for v, s in pairs]
        out.append(f"{', '.join(numbers)} {unit}".rstrip())
        at += count
    return "; ".join(out)
