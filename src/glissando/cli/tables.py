"""Tables and numbers as several commands print them."""

from __future__ import annotations

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table

_PARAMETER_UNITS = {
    "frame": (("mm", 1e3, 3), ("mrad", 1e3, 3)),
    "mount": (("mm", 1e3, 3), ("mrad", 1e3, 3)),
    **dict.fromkeys(("arclength_offset", "slide_play"), (("mm", 1e3, 1),)),
    **dict.fromkeys(("time_offset", "slide_lag"), (("ms", 1e3, 1),)),
}


def number_table(title: str, numbers: Sequence[str], *, left: Sequence[str] = ()) -> Table:
    """A table whose columns of numbers stand to the right, after those that stand `left`."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    for heading in left:
        table.add_column(heading, overflow="fold")
    for heading in numbers:
        table.add_column(heading, justify="right")
    return table


def site_table(title: str, headings: Sequence[str]) -> Table:
    """A table with a row a site, which 80 columns hold; a long name folds, numbers do not."""
    table = Table(
        title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True
    )
    table.add_column("site", overflow="fold")
    for heading in headings:
        table.add_column(heading, justify="right")
    return table


def parameter_text(kind: str, value: Sequence[float], std: Sequence[float]) -> str:
    """Values of a sensor parameter with their deviations and units; known ones have none.

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
