"""Robots in space, hanging side by side at one scale, on which figures A and B are built.

Lengths are drawn in millimetres. Gravity points along +z, so z is drawn downwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando.experiments.scenes import Trial
from glissando.geometry.se3 import Array
from glissando.visualization.figures import (
    _AXES,
    _DOT,
    _MM,
    _draw_ellipsoids,
    _draw_truth,
    _legend,
    _places,
)

COIL: dict[str, Any] = {"marker": "o", "color": "#FFD92F", "edgecolor": "black", "linewidth": 1.3}
"""How a scatter draws the coil, in space and on curves."""
_VIEW: dict[str, Any] = {"elev": -24, "azim": -240, "roll": 180, "proj_type": "ortho"}
_STRONGER = 0.4  # opacity of the ellipsoids
_THINNEST = 0.26  # of its longest side, a box
_TRIAD = 26.0  # mm


class Bodies:
    """A table of robots in space, at one scale; columns may differ in what they cover."""

    def __init__(self, figure: Any, rows: int, columns: int) -> None:
        self.figure = figure
        look = {"projection": "3d", "computed_zorder": False, **_VIEW}
        self.axes = [
            [figure.add_axes((0, 0, 1, 1), label=f"{i} {j}", **look) for j in range(columns)]
            for i in range(rows)
        ]
        self.points: list[list[Array]] = [[] for _ in range(columns)]

    def draw(
        self, row: int, column: int, found: Trial, time: float, coil: float, look: Any
    ) -> None:
        """Draw the robot at a time in s in a colour, with the coil at an arclength in m."""
        axes, ask = self.axes[row][column], found.posterior
        sites = _places(found.truth, ask.grid)
        body = np.linspace(ask.grid.arclength[0], ask.grid.arclength[-1], 141)
        line = ask.at(body, time).position * _MM
        corners = _draw_ellipsoids(axes, ask.at([s.arclength[0] for s in sites], time), look)
        for ball in axes.collections:
            ball.set_alpha(_STRONGER)
        axes.plot(*line.T, color=look, linewidth=1.9, zorder=3)
        corners += [_draw_truth(axes, site, time, _TRIAD) for site in sites]
        axes.scatter(*line[0], **_DOT, s=50, marker="s", zorder=5)
        axes.scatter(*ask.at(coil, time).position * _MM, s=75, zorder=6, depthshade=False, **COIL)
        self.points[column] += [line, *corners]

    def finish(self, place: tuple[float, float, float, float], gap: tuple[float, float]) -> None:
        """Arrange all in (left, bottom, width, height) inches, with gaps in a cell for ticks."""
        boxes = [_box(np.concatenate(points)) for points in self.points]
        ends = [min(box[2, 0] for box in boxes), max(box[2, 1] for box in boxes)]
        for box in boxes:
            box[2] = ends
        sizes = np.array([_seen_size(np.ptp(box, axis=1)) for box in boxes])
        rows, columns = len(self.axes), len(boxes)
        cell = np.array(place[2:]) / [columns, rows]
        scale = float(((cell - gap) / sizes.max(axis=0)).min())  # inches a mm
        for i, line in enumerate(self.axes):
            for j, (axes, box) in enumerate(zip(line, boxes, strict=True)):
                middle = place[:2] + cell * [j + 0.5, rows - i - 0.5]
                _put(axes, middle, 1.4 * float(cell[1]))
                _set_box(axes, box, scale)
                _set_ticks(axes, i == rows - 1, j == 0)
            side = place[0] + 0.5 * (cell[0] - scale * sizes[0, 0]) - 0.45
            at = np.array([side, middle[1]]) / self.figure.get_size_inches()
            self.figure.text(*at, "z (mm)", rotation=90, fontsize=9.5, ha="right", va="center")


def _box(points: Array) -> Array:
    """Ends (3, 2) of a box around points (M, 3), never a thin slab."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * np.maximum(1.04 * (high - low), _THINNEST * np.ptp(points, axis=0).max())
    middle = 0.5 * (low + high)
    return np.stack([middle - half, middle + half], axis=1)


def _seen_size(span: Array) -> Array:
    """Width and height (2,) that a box with sides (3,) takes in our view, in its units."""
    turn, tilt = np.radians(_VIEW["azim"]), np.radians(_VIEW["elev"])
    flat = np.abs([[np.sin(turn), np.cos(turn)], [np.cos(turn), np.sin(turn)]]) @ span[:2]
    return np.array([flat[0], abs(np.sin(tilt)) * flat[1] + np.cos(tilt) * span[2]])


def _put(axes: Any, middle: Array, side: float) -> None:
    """Place axes as a square around a point, all in inches."""
    wide, high = axes.figure.get_size_inches()
    corner = (middle[0] - 0.5 * side) / wide, (middle[1] - 0.5 * side) / high
    axes.set_position((*corner, side / wide, side / high))
    axes.patch.set_visible(False)


def _set_box(axes: Any, box: Array, scale: float) -> None:
    """Limits (3, 2) in mm, drawn at a scale in inches a mm."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    axes.set(xlim=box[0], ylim=box[1], zlim=box[2])
    axes.set_box_aspect(np.ptp(box, axis=1))
    corners = np.stack(np.meshgrid(*box), axis=-1).reshape(-1, 3)
    flat = proj_transform(*corners.T, axes.get_proj())[:2]
    shown = np.ptp(axes.transData.transform(np.stack(flat, axis=1)), axis=0) / axes.figure.dpi
    wanted = scale * _seen_size(np.ptp(box, axis=1))
    axes.set_box_aspect(np.ptp(box, axis=1), zoom=wanted[1] / shown[1])


def _set_ticks(axes: Any, below: bool, left: bool) -> None:
    """Ticks of 100 or 200 mm; labels in the last row and the first column, as the rest agree.

    The name of z is written by `Bodies.finish`: beside a narrow box its own place is too near.
    """
    from matplotlib.ticker import MultipleLocator

    three = axes.xaxis, axes.yaxis, axes.zaxis
    wide = 100 if np.ptp(axes.get_xlim()) < 330.0 else 200
    for axis, labelled, step in zip(three, (below, below, left), (wide, 100, 200), strict=True):
        axis.set_major_locator(MultipleLocator(step))
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
        axis.line.set_color("0.6")
        axis.set_tick_params(labelsize=8.5, pad=4 if axis is axes.zaxis else -1)
        axis.labelpad = 0
        if labelled and axis is not axes.zaxis:
            axis.set_label_text(f"{axis.axis_name} (mm)", fontsize=9.5)
        if not labelled:
            axis.set_ticklabels([])


def explain_bodies(figure: Any, **place: Any) -> None:
    """The legend of bodies in space."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    dot = {"marker": "o", "mfc": COIL["color"], "mec": "black", "ms": 9, "ls": "none"}
    entries: dict[str, Any] = {
        "base": Line2D([], [], color="black", marker="s", ms=7, ls="none"),
        "coil": Line2D([], [], **dot),
        "estimate": Line2D([], [], color="0.3", lw=1.9),
        "3σ of position": Patch(color="0.5", alpha=0.45, linewidth=0),
        "motion capture: x, y, z": tuple(Line2D([], [], lw=2, c=c) for c in _AXES.values()),
    }
    _legend(figure, entries, ncols=len(entries), columnspacing=1.5, handletextpad=0.5, **place)
