"""Figures of RMSE over many trials, by the motion of the coil, its speed, and causes of error."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.visualization.canvas import MM, canvas, legend

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KINDS = {"position": ("position RMSE (cm)", 1e2), "rotation": ("orientation RMSE (rad)", 1.0)}
_COLOURS = {"C": "#0072B2", "S": "#D55E00"}
_OTHERS = ("#332288", "#009E73", "#C2568F", "#E69F00", "#56B4E9", "#000000")
_ARMS = {
    "fixed": "fixed at the tip",
    "oscillating": "oscillating",
    "traverse": "whole length",
    "traverse fast": "whole length, fast",
}
_STILL = "still "
_PAPER: dict[str, dict[str, dict[str, float]]] = {
    "position": {
        "C": {"fixed": 0.0164, "oscillating": 0.0154},
        "S": {"fixed": 0.0178, "oscillating": 0.0163},
    },
    "rotation": {
        "C": {"fixed": 0.0779, "oscillating": 0.0754},
        "S": {"fixed": 0.2381, "oscillating": 0.2291},
    },
}
_PAPER_CHANGES = {"position": {"C": -6.1, "S": -8.4}, "rotation": {"C": -3.2, "S": -3.8}}
_PAPER_LOOK: dict[str, Any] = {"marker": "D", "mfc": "white", "mew": 1.6, "ms": 7, "ls": "none"}
_EDGE: dict[str, Any] = {"mec": "black", "mew": 0.8}
_DASHES = (0, (4, 2))


def _colour(shape: str) -> str:
    return _COLOURS.get(shape, "0.4")


def _ends(entry: Mapping[str, Any], unit: float) -> Array:
    """Value and ends of its interval (3,), times `unit`; the ends are NaN without an interval."""
    ends = np.array([entry[key] for key in ("value", "low", "high")], dtype=float)
    return unit * ends


def _draw_row(axes: Any, entry: Mapping[str, Any], row: float, unit: float, **look: Any) -> None:
    """Draw a value with its horizontal interval at the height `row`."""
    value, low, high = _ends(entry, unit)
    axes.plot([low, high], [row, row], color=look["color"], lw=2.0, solid_capstyle="butt")
    axes.plot(value, row, ls="none", **{"marker": "o", "ms": 7.5, "zorder": 4, **_EDGE, **look})


def table_figure(table: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw RMSE of a robot at rest by the motion of its coil, with 95 % intervals and the paper's.

    Args:
        table: Summaries of trials (m, rad) by shape and arm; an arm 'still …' has the prior of a
            robot that holds still.

    Returns:
        The figure, in cm and rad.
    """
    from matplotlib.lines import Line2D

    rows = _table_rows({arm for arms in table.values() for arm in arms})
    with canvas(10.0, 1.7 + 2 * max(1.0, 0.31 * len(rows))) as figure:
        cells: Any = figure.subplots(2, len(table), sharey=True, squeeze=False)
        for line, kind in zip(cells, _KINDS, strict=True):
            for axes, (shape, arms) in zip(line, table.items(), strict=True):
                _draw_table_cell(axes, arms, shape, kind, rows)
            line[0].set_yticks(range(len(rows)), [*rows.values()])
            for text, arm in zip(line[0].get_yticklabels(), rows, strict=True):
                text.set_fontweight("normal" if arm.strip() else "bold")
        cells[0, 0].set_ylim(len(rows) - 0.4, -0.6)
        for axes in cells.flat:
            axes.tick_params(axis="y", length=0)
        dots = [Line2D([], [], color=_colour(s), marker="o", ms=7.5, mec="black") for s in table]
        hollow = [Line2D([], [], color=_colour(s), **_PAPER_LOOK) for s in table]
        entries = {"ours, with 95 % interval": tuple(dots), "paper": tuple(hollow)}
        legend(figure, entries, loc="outside upper center", ncols=2)
    return figure


def _table_rows(arms: set[str]) -> dict[str, str]:
    """Labels of rows from the top, by arm; headings have blank keys."""
    known = [*_ARMS]

    def rank(arm: str) -> tuple[int, str]:
        name = arm.removeprefix(_STILL)
        return known.index(name) if name in known else len(known), arm

    names = {arm: _ARMS.get(arm.removeprefix(_STILL), arm) for arm in sorted(arms, key=rank)}
    still = {arm: name for arm, name in names.items() if arm.startswith(_STILL)}
    if not still:
        return names
    free = {arm: name for arm, name in names.items() if arm not in still}
    return {"": "robot may move", **free, " ": "known to hold still", **still}


def _draw_table_cell(
    axes: Any, arms: Mapping[str, Any], shape: str, kind: str, rows: Mapping[str, str]
) -> None:
    label, unit = _KINDS[kind]
    for row, arm in enumerate(rows):
        if arm in arms:
            marker = "s" if arm.startswith(_STILL) else "o"
            _draw_row(axes, arms[arm][kind], row, unit, marker=marker, color=_colour(shape))
        if arm in _PAPER[kind].get(shape, {}):
            value = unit * _PAPER[kind][shape][arm]
            axes.plot(value, row - 0.3, color=_colour(shape), **_PAPER_LOOK)
    axes.margins(x=0.1)
    axes.set_xlim(left=0.0)
    axes.locator_params(axis="x", nbins=5, steps=[1, 2, 5, 10])
    axes.grid(axis="x", zorder=0)
    axes.set_axisbelow(True)
    axes.set_title(shape, loc="left", fontweight="bold", color=_colour(shape))
    axes.set_xlabel(label)


def moving_figure(moving: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw RMSE of a robot that moves from C to S, over the speed of its coil; 95 % intervals.

    Args:
        moving: Summaries of trials (m, rad) by duration and arm, with `slide_speed` (m/s) and
            `stroke` (m), both 0 for a fixed coil.

    Returns:
        The figure, in cm, rad and mm/s: a column for each duration, a marker for each stroke, and a
        band for the fixed coil.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    strokes = sorted({arm["stroke"] for arms in moving.values() for arm in arms.values()} - {0.0})
    markers = dict(zip(strokes, cycle("ov^sDP"), strict=False))
    with canvas(10.0 if len(moving) > 1 else 7.0, 6.2) as figure:
        table: Any = figure.subplots(
            2, len(moving), sharex=True, sharey="row", squeeze=False, gridspec_kw={"hspace": 0.06}
        )
        for j, (label, arms) in enumerate(moving.items()):
            for axes, kind in zip(table[:, j], _KINDS, strict=True):
                _draw_moving(axes, arms, kind, _OTHERS[j % len(_OTHERS)], markers)
                _set_log(axes, (1.0, 2.0, 5.0) if len(moving) < 4 else (1.0, 3.0))
            table[0, j].set_title(f"C to S in {label}", fontweight="bold", loc="left")
            table[1, j].set_xlabel("mean slide speed (mm/s)")
        for axes, (name, _) in zip(table[:, 0], _KINDS.values(), strict=True):
            axes.set_ylabel(name)
        line = Line2D([], [], color="0.35", lw=1.4, ls=_DASHES)
        entries: dict[str, Any] = {"fixed at the tip": (Patch(color="0.82"), line)}
        look: dict[str, Any] = {"color": "0.6", "mec": "black", "ms": 8, "ls": "none"}
        for stroke, marker in markers.items():
            entries[f"sliding by {stroke * MM:.0f} mm"] = Line2D([], [], marker=marker, **look)
        legend(figure, entries, loc="outside upper center", ncols=len(entries))
    return figure


def _draw_moving(
    axes: Any, arms: Mapping[str, Any], kind: str, colour: str, markers: Mapping[float, str]
) -> None:
    """Draw one duration: a band for the fixed coil, and intervals by speed and stroke."""
    unit = _KINDS[kind][1]
    for arm in arms.values():
        if arm["stroke"] == 0.0:
            value, low, high = _ends(arm[kind], unit)
            axes.axhspan(low, high, color=colour, alpha=0.18)
            axes.axhline(value, color=colour, lw=1.4, ls=_DASHES)
    for stroke, marker in markers.items():
        sliding = [arm for arm in arms.values() if arm["stroke"] == stroke]
        sliding.sort(key=lambda arm: arm["slide_speed"])
        if sliding:
            speed = [arm["slide_speed"] * MM for arm in sliding]
            value, low, high = np.transpose([_ends(arm[kind], unit) for arm in sliding])
            look = {"color": colour, "marker": marker, "ms": 8, "lw": 1.4, "elinewidth": 2.0}
            axes.errorbar(speed, value, [value - low, high - value], **look, **_EDGE)


def _set_log(axes: Any, ticks: tuple[float, ...]) -> None:
    """Set a logarithmic x axis with plain numbers at these ticks of every decade."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=ticks))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="x", which="minor", length=0)
    axes.margins(x=0.15)
    axes.grid(axis="y")
    axes.set_axisbelow(True)


def causes_figure(causes: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw the change of RMSE by an oscillating coil, for each cause of error.

    Args:
        causes: Summaries of trials with `position_change` and `rotation_change` (% against a fixed
            coil) by cause and shape.

    Returns:
        The figure: a row for each cause with 95 % intervals, the paper's changes as thin lines.
    """
    from matplotlib.lines import Line2D

    shapes = list(dict.fromkeys(shape for cause in causes.values() for shape in cause))
    with canvas(10.0, 1.5 + 0.42 * len(causes)) as figure:
        pair: Any = figure.subplots(1, 2, sharey=True)
        for axes, kind, name in zip(pair, _KINDS, ("position", "orientation"), strict=True):
            axes.axvline(0.0, color="0.35", lw=1.2, zorder=1)
            for order, shape in enumerate(shapes):
                _draw_causes(axes, causes, shape, kind, 0.3 * (order - 0.5 * (len(shapes) - 1)))
            axes.set_title(name, loc="left", fontweight="bold")
            axes.set_xlabel("change of RMSE by oscillating (%)")
            axes.locator_params(axis="x", nbins=6, steps=[1, 2, 5, 10])
            axes.grid(axis="x")
            axes.set_axisbelow(True)
            axes.tick_params(axis="y", length=0)
            for row in range(1, len(causes), 2):
                axes.axhspan(row - 0.5, row + 0.5, color="0.965", zorder=0)
        pair[0].set_yticks(range(len(causes)), list(causes))
        pair[0].set_ylim(len(causes) - 0.5, -0.5)
        entries: dict[str, Any] = {}
        for s in shapes:
            look = {"c": _colour(s), "marker": _marker(s), "ms": 7.5, "lw": 2.0, **_EDGE}
            entries[f"{s}, with 95 % interval"] = Line2D([], [], **look)
        lines = (Line2D([], [], c=_colour(s), lw=1.2, ls=_DASHES) for s in shapes)
        entries["paper"] = tuple(lines)
        legend(figure, entries, loc="outside upper center", ncols=len(entries))
    return figure


def _marker(shape: str) -> str:
    return "s" if shape == "S" else "o"


def _draw_causes(
    axes: Any, causes: Mapping[str, Any], shape: str, kind: str, offset: float
) -> None:
    look: dict[str, Any] = {"color": _colour(shape)}
    if shape in _PAPER_CHANGES[kind]:
        axes.axvline(_PAPER_CHANGES[kind][shape], lw=1.2, ls=_DASHES, zorder=1, **look)
    for row, cause in enumerate(causes.values()):
        change = cause.get(shape, {}).get(f"{kind}_change")
        if change is not None:
            _draw_row(axes, change, row + offset, 1.0, marker=_marker(shape), **look)
