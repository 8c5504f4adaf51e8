"""Figures of the standard deviation of position along the body, which is least near the coil.

Robots are drawn side by side in 3D at one scale. Gravity points along +z, so z is drawn downwards.
Lengths are in millimetres, times in seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.experiments.confidence import std_along
from glissando.experiments.scenes import Scene, Trial, bench, path
from glissando.geometry.se3 import Array
from glissando.visualization.canvas import AXES, MM, canvas, legend
from glissando.visualization.shape_figure import TRUTH_DOT, draw_ellipsoids, draw_truth
from glissando.visualization.sites import sites_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KINDS = {"tip": ("#332288", "coil at the tip"), "inside": ("#C2568F", "coil 60 mm inside")}
_INSTANTS = 6
_JUDGED = 0.25  # share of the length at the clamped base that is excluded
_COIL: dict[str, Any] = {
    "marker": "o", "color": "#FFD92F", "edgecolor": "black", "linewidth": 1.3,
}  # fmt: skip
_MINIMUM: dict[str, Any] = {
    "marker": "o", "mec": "black", "ms": 8.0, "ls": "none", "clip_on": False, "zorder": 5,
}  # fmt: skip
_DASHES: dict[str, Any] = {"lw": 1.5, "ls": (0, (3, 1.5))}
_VIEW: dict[str, Any] = {"elev": -24, "azim": -240, "roll": 180, "proj_type": "ortho"}
_THINNEST = 0.26  # least side of a box, as a share of its longest
_TRIAD = 26.0  # length of the axes of a pose, mm


def coil_figure(trials: Mapping[str, Trial], confidence: Mapping[str, Any]) -> Figure:
    """Draw straight, C and S robots with the coil at two arclengths, and their uncertainty.

    Half-way through each trial: bodies with 95 % ellipsoids and truth, and below them the standard
    deviation of position. `trials` and `confidence` are the results of `confidence_at_coil`.
    """
    from matplotlib.lines import Line2D

    shapes = list(dict.fromkeys(name.rsplit(" ", 1)[0] for name in trials))
    with canvas(8.4, 11.3) as figure:
        figure.set_layout_engine("none")
        bodies = _Bodies(figure, len(_KINDS), len(shapes))
        pitch = 7.5 / len(shapes)
        curves: Any = [
            _plane(figure, (0.8 + pitch * j, 1.05, pitch - 0.25, 1.75), label=shape)
            for j, shape in enumerate(shapes)
        ]
        for name, result in trials.items():
            shape, kind = name.rsplit(" ", 1)
            column, row, colour = shapes.index(shape), list(_KINDS).index(kind), _KINDS[kind][0]
            time, places = float(result.posterior.grid.time.mean()), confidence[name]
            bodies.draw(row, column, result, time, places["coil"], colour)
            arclength, std = std_along(result, time)
            curves[column].axvline(places["coil"] * MM, color=colour, **_DASHES, zorder=1)
            curves[column].plot(arclength * MM, std * MM, color=colour, lw=2.2)
            least = np.interp(places["minimum"], arclength, std) * MM
            curves[column].plot(places["minimum"] * MM, least, mfc=colour, **_MINIMUM)
        bodies.finish((0.8, 3.35, 7.5, 7.2), (0.2, 0.05))
        top = 1.08 * max(axes.get_ylim()[1] for axes in curves)
        for axes, shape in zip(curves, shapes, strict=True):
            axes.set(xlim=(0.0, 1.03 * bench().rod.length * MM), ylim=(0.0, top))
            axes.set_xlabel("arclength (mm)")
            axes.tick_params(labelleft=axes is curves[0])
            middle = axes.get_position().x0 + 0.5 * axes.get_position().width
            place = middle, 10.65 / 11.3
            figure.text(*place, shape, ha="center", fontweight="bold", fontsize=13)
        curves[0].set_ylabel("position std. dev. (mm)")
        for i, (colour, label) in enumerate(_KINDS.values()):
            look: dict[str, Any] = {"color": colour, "fontweight": "bold"}
            at = 0.12 / 8.4, (8.8 - 3.6 * i) / 11.3
            figure.text(*at, label, rotation=90, va="center", **look)
        _explain_bodies(figure)
        colours = [colour for colour, _ in _KINDS.values()]
        entries: dict[str, Any] = {n: Line2D([], [], color=c, lw=2.2) for c, n in _KINDS.values()}
        entries["coil"] = tuple(Line2D([], [], color=c, **_DASHES) for c in colours)
        lows = tuple(Line2D([], [], mfc=c, **_MINIMUM) for c in colours)
        entries["minimum nearest to it"] = lows
        legend(figure, entries, loc="lower center", ncols=4, columnspacing=1.5, handletextpad=0.5)
    return figure


def following_figure(result: Trial, scene: Scene, following: Mapping[str, Any]) -> Figure:
    """Draw a robot while its coil slides the whole length, and the minimum that follows the coil.

    Left: the body with 95 % ellipsoids at six time nodes, while the coil moves towards the base.
    Right: the standard deviation of position along the body, and the arclengths of coil and minimum
    over time. The arguments are the results of `confidence_follows`.
    """
    from matplotlib import colormaps

    with canvas(10.4, 7.4) as figure:
        figure.set_layout_engine("none")
        bodies = _Bodies(figure, 2, _INSTANTS // 2)
        curves = _plane(figure, (7.55, 4.05, 2.7, 2.55), label="std")
        colours = colormaps["viridis"](np.linspace(0.0, 0.8, _INSTANTS))
        for i, (time, coil) in enumerate(_way_in(scene, result)):
            row, column = divmod(i, _INSTANTS // 2)
            bodies.draw(row, column, result, time, coil, colours[i])
            place = (1.6 + 2.05 * column) / 10.4, (6.72 - 3.25 * row) / 7.4
            figure.text(*place, f"{time:.1f} s", color=colours[i], ha="center", fontweight="bold")
            arclength, std = std_along(result, time)
            height = np.interp(coil, arclength, std) * MM
            curves.plot(arclength * MM, std * MM, color=colours[i], lw=2.0)
            look = {**_DASHES, "lw": 1.4, "color": colours[i]}
            curves.plot([coil * MM] * 2, [1e-9, height], **look)
            curves.scatter(coil * MM, height, s=55, zorder=5, **_COIL)
        bodies.finish((0.6, 0.4, 6.15, 6.5), (0.1, 0.5))
        _finish_curves(curves)
        _draw_following(_plane(figure, (7.55, 0.65, 2.7, 2.5), label="way"), scene, following)
        _explain_bodies(figure)
    return figure


def _way_in(scene: Scene, result: Trial) -> list[tuple[float, float]]:
    """Time nodes, s, and arclengths, m, of the coil, evenly spaced on its way to the base."""
    time = result.posterior.grid.time
    slide = path(scene).at(time)
    slide = slide[: np.argmax(slide) + 1]
    wanted = np.linspace(0.0, 0.85 * slide[-1], _INSTANTS)
    rows = [int(np.argmin(np.abs(slide - place))) for place in wanted]
    return [(float(time[row]), float(bench().rod.length - slide[row])) for row in rows]


def _finish_curves(axes: Any) -> None:
    """Set a logarithmic scale that covers the standard deviations, and labels."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    std = np.concatenate([line.get_ydata() for line in axes.lines])
    std = std[std > 1e-6]
    axes.set(xlabel="arclength (mm)", ylabel="position std. dev. (mm)", yscale="log")
    axes.set(ylim=(0.7 * std.min(), 1.3 * std.max()), xlim=(0, 1.03 * bench().rod.length * MM))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_following(axes: Any, scene: Scene, following: Mapping[str, Any]) -> None:
    """Draw the arclengths of coil and minimum over time."""
    from matplotlib.ticker import MaxNLocator

    length, instants = bench().rod.length * MM, following["instants"]
    time = np.linspace(0.0, scene.duration, 701)
    axes.plot(time, length - path(scene).at(time) * MM, color="0.45", lw=2.0, label="coil")
    look = {**_MINIMUM, "mfc": "#CC79A7", "ms": 6.5}
    minima = [entry["minimum"] * MM for entry in instants.values()]
    axes.plot([float(t) for t in instants], minima, **look, label="minimum")
    axes.axhspan(0.0, _JUDGED * length, color="0.93", zorder=0)
    axes.text(0.25, 0.5 * _JUDGED * length, "clamped:\nnot judged", va="center", fontsize=9)
    axes.set(xlabel="time (s)", ylabel="arclength (mm)", xlim=(0.0, scene.duration))
    axes.set(ylim=(0.0, 1.03 * length))
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.set_title(f"≤ {following['worst'] * MM:.1f} mm apart at these instants", loc="left")
    axes.legend(loc="upper center", handlelength=1.2)


def _plane(figure: Any, rect: Sequence[float], **look: Any) -> Any:
    """Add 2D axes at (left, bottom, width, height), inches."""
    return figure.add_axes(np.array(rect) / np.tile(figure.get_size_inches(), 2), **look)


class _Bodies:
    """A table of robots in 3D at one scale; the box of each column fits its robots."""

    def __init__(self, figure: Any, rows: int, columns: int) -> None:
        self.figure = figure
        look = {"projection": "3d", "computed_zorder": False, **_VIEW}
        self.axes = [
            [figure.add_axes((0, 0, 1, 1), label=f"{i} {j}", **look) for j in range(columns)]
            for i in range(rows)
        ]
        self.points: list[list[Array]] = [[] for _ in range(columns)]

    def draw(
        self, row: int, column: int, result: Trial, time: float, coil: float, colour: Any
    ) -> None:
        """Draw the robot at a time, s, with the coil at an arclength, m."""
        axes, posterior = self.axes[row][column], result.posterior
        sites, ends = sites_of(result.truth, posterior.grid), posterior.grid.arclength
        line = posterior.at(np.linspace(ends[0], ends[-1], 141), time).position * MM
        at_sites = posterior.at([site.arclength[0] for site in sites], time)
        corners = draw_ellipsoids(axes, at_sites.position, at_sites.cov_position_world, colour)
        for ellipsoid in axes.collections:
            ellipsoid.set_alpha(0.4)
        axes.plot(*line.T, color=colour, linewidth=1.9, zorder=3)
        corners += [draw_truth(axes, site, time, _TRIAD) for site in sites]
        axes.scatter(*line[0], **TRUTH_DOT, s=50, marker="s", zorder=5)
        place = posterior.at(coil, time).position * MM
        axes.scatter(*place, s=75, zorder=6, depthshade=False, **_COIL)
        self.points[column] += [line, *corners]

    def finish(self, place: tuple[float, float, float, float], gap: tuple[float, float]) -> None:
        """Arrange the axes in (left, bottom, width, height), inches, with gaps for their ticks."""
        boxes = [_box(np.concatenate(points)) for points in self.points]
        ends = [min(box[2, 0] for box in boxes), max(box[2, 1] for box in boxes)]
        for box in boxes:
            box[2] = ends
        sizes = np.array([_size_on_paper(np.ptp(box, axis=1)) for box in boxes])
        rows, paper = len(self.axes), self.figure.get_size_inches()
        cell = np.array(place[2:]) / [len(boxes), rows]
        scale = float(((cell - gap) / sizes.max(axis=0)).min())  # inches a mm
        for i, line in enumerate(self.axes):
            for j, (axes, box) in enumerate(zip(line, boxes, strict=True)):
                middle = place[:2] + cell * [j + 0.5, rows - i - 0.5]
                side = 1.4 * cell[1] / paper
                axes.set_position((*(middle / paper - 0.5 * side), *side))
                axes.patch.set_visible(False)
                _set_box(axes, box, scale)
                _set_ticks(axes, i == rows - 1, j == 0)
            # beside a narrow box matplotlib places the axis's label too near
            left = place[0] + 0.5 * (cell[0] - scale * sizes[0, 0]) - 0.45
            look = {"rotation": 90, "fontsize": 9.5, "ha": "right", "va": "center"}
            self.figure.text(*(np.array([left, middle[1]]) / paper), "z (mm)", **look)


def _box(points: Array) -> Array:
    """Limits (3, 2) of a box around points (M, 3), none of whose sides is too thin."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * np.maximum(1.04 * (high - low), _THINNEST * np.ptp(points, axis=0).max())
    middle = 0.5 * (low + high)
    return np.stack([middle - half, middle + half], axis=1)


def _size_on_paper(span: Array) -> Array:
    """Width and height (2,) of the projection of a box with sides (3,), in the same units."""
    turn, tilt = np.radians(_VIEW["azim"]), np.radians(_VIEW["elev"])
    flat = np.abs([[np.sin(turn), np.cos(turn)], [np.cos(turn), np.sin(turn)]]) @ span[:2]
    return np.array([flat[0], abs(np.sin(tilt)) * flat[1] + np.cos(tilt) * span[2]])


def _set_box(axes: Any, box: Array, scale: float) -> None:
    """Set the limits (3, 2), mm, of 3D axes, drawn at a scale in inches a mm."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    span = tuple(np.ptp(box, axis=1))  # matplotlib would scale an array in place
    axes.set(xlim=box[0], ylim=box[1], zlim=box[2])
    axes.set_box_aspect(span)
    corners = np.stack(np.meshgrid(*box), axis=-1).reshape(-1, 3)
    flat = proj_transform(*corners.T, axes.get_proj())[:2]
    drawn = np.ptp(axes.transData.transform(np.stack(flat, axis=1)), axis=0) / axes.figure.dpi
    axes.set_box_aspect(span, zoom=scale * _size_on_paper(np.array(span))[1] / drawn[1])


def _set_ticks(axes: Any, below: bool, left: bool) -> None:
    """Set ticks every 100 or 200 mm, with labels only in the last row and the first column."""
    from matplotlib.ticker import MultipleLocator

    wide = 100 if np.ptp(axes.get_xlim()) < 330.0 else 200
    three = zip((axes.xaxis, axes.yaxis, axes.zaxis), (wide, 100, 200), strict=True)
    for axis, step in three:
        upright = axis is axes.zaxis
        axis.set_major_locator(MultipleLocator(step))
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
        axis.line.set_color("0.6")
        axis.set_tick_params(labelsize=8.5, pad=4 if upright else -1)
        axis.labelpad = 0
        if not (left if upright else below):
            axis.set_ticklabels([])
        elif not upright:
            axis.set_label_text(f"{axis.axis_name} (mm)", fontsize=9.5)


def _explain_bodies(figure: Any) -> None:
    """Draw the legend of the robots in 3D."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    dot = {"marker": "o", "mfc": _COIL["color"], "mec": "black", "ms": 9, "ls": "none"}
    entries: dict[str, Any] = {
        "base": Line2D([], [], color="black", marker="s", ms=7, ls="none"),
        "coil": Line2D([], [], **dot),
        "estimate": Line2D([], [], color="0.3", lw=1.9),
        "95 % of positions": Patch(color="0.5", alpha=0.45, linewidth=0),
        "motion capture: x, y, z": tuple(Line2D([], [], lw=2, c=c) for c in AXES.values()),
    }
    look: dict[str, Any] = {"ncols": len(entries), "columnspacing": 1.5, "handletextpad": 0.5}
    legend(figure, entries, loc="upper center", **look)
