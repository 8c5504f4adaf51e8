"""Figures A and B: confidence along the body is highest where the coil is, and follows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.experiments.confidence import std_along
from glissando.experiments.figures_space import COIL, Bodies, explain_bodies
from glissando.experiments.scenes import Scene, Trial, bench, path
from glissando.visualization.figures import _MM, _canvas, _legend

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COILS = {"tip": ("#332288", "coil at the tip"), "inside": ("#C2568F", "coil 60 mm inside")}
_INSTANTS = 6
_JUDGED = 0.25  # share of the length at the clamped base where no minimum is looked for
_MINIMUM: dict[str, Any] = {
    "marker": "o",
    "mec": "black",
    "ms": 8.0,
    "ls": "none",
    "clip_on": False,
    "zorder": 5,
}


def _plane(figure: Any, rect: Sequence[float], **look: Any) -> Any:
    """Flat axes at (left, bottom, width, height) inches."""
    wide, high = figure.get_size_inches()
    return figure.add_axes(np.array(rect) / [wide, high, wide, high], **look)


def figure_a(trials: Mapping[str, Trial], confidence: Mapping[str, Any]) -> Figure:
    """Confidence is highest at the coil, wherever it is: straight, C and S robots.

    `trials` and `confidence` as of `confidence.figure_a`: named by shape and 'tip' or 'inside',
    with arclengths of coil and minimum in metres. Drawn half-way through each trial: bodies with
    3σ ellipsoids and truth, and below the standard deviation of position, all in millimetres.
    """
    shapes = list(dict.fromkeys(name.rsplit(" ", 1)[0] for name in trials))
    with _canvas(8.4, 11.3) as figure:
        figure.set_layout_engine("none")
        bodies = Bodies(figure, len(_COILS), len(shapes))
        pitch = 7.5 / len(shapes)
        curves: Any = [
            _plane(figure, (0.8 + pitch * j, 1.05, pitch - 0.25, 1.75), label=shape)
            for j, shape in enumerate(shapes)
        ]
        for name, found in trials.items():
            shape, kind = name.rsplit(" ", 1)
            column, row = shapes.index(shape), list(_COILS).index(kind)
            time, coil = float(found.posterior.grid.time.mean()), confidence[name]["coil"]
            bodies.draw(row, column, found, time, coil, _COILS[kind][0])
            _draw_std(curves[column], found, time, confidence[name], kind)
        bodies.finish((0.8, 3.35, 7.5, 7.2), (0.2, 0.05))
        _finish_a(figure, curves, shapes)
    return figure


def _draw_std(axes: Any, found: Trial, time: float, told: Any, kind: str) -> None:
    """One curve of figure A, with its coil and its minimum."""
    colour, _ = _COILS[kind]
    arclength, std = std_along(found, time)
    axes.axvline(told["coil"] * _MM, color=colour, lw=1.5, ls=(0, (3, 1.5)), zorder=1)
    axes.plot(arclength * _MM, std * _MM, color=colour, lw=2.2)
    low = np.interp(told["minimum"], arclength, std)
    axes.plot(told["minimum"] * _MM, low * _MM, mfc=colour, **_MINIMUM)


def _finish_a(figure: Any, curves: Sequence[Any], shapes: Sequence[str]) -> None:
    """Names of columns and rows, limits, and the legends of figure A."""
    from matplotlib.lines import Line2D

    wide, high = figure.get_size_inches()
    top = 1.08 * max(axes.get_ylim()[1] for axes in curves)
    for axes, shape in zip(curves, shapes, strict=True):
        axes.set(xlim=(0.0, 1.03 * bench().rod.length * _MM), ylim=(0.0, top))
        axes.set_xlabel("arclength (mm)")
        axes.tick_params(labelleft=axes is curves[0])
        middle = axes.get_position().x0 + 0.5 * axes.get_position().width
        figure.text(middle, 10.65 / high, shape, ha="center", fontweight="bold", fontsize=13)
    curves[0].set_ylabel("position std. dev. (mm)")
    for i, (colour, label) in enumerate(_COILS.values()):
        height = (8.8 - 3.6 * i) / high
        look = {"color": colour, "fontweight": "bold", "rotation": 90, "va": "center"}
        figure.text(0.12 / wide, height, label, **look)
    explain_bodies(figure, loc="upper center")
    entries: dict[str, Any] = {
        label: Line2D([], [], color=colour, lw=2.2) for colour, label in _COILS.values()
    }
    entries["coil"] = tuple(
        Line2D([], [], color=colour, lw=1.5, ls=(0, (3, 1.5))) for colour, _ in _COILS.values()
    )
    entries["minimum nearest to it"] = tuple(
        Line2D([], [], mfc=colour, **_MINIMUM) for colour, _ in _COILS.values()
    )
    _legend(figure, entries, loc="lower center", ncols=4, columnspacing=1.5, handletextpad=0.5)


def figure_b(trial: Trial, scene: Scene, following: Mapping[str, Any]) -> Figure:
    """The place of highest confidence follows the coil through the whole length of the body.

    `trial`, `scene` and `following` as of `confidence.figure_b`: an estimate, the scene with the
    coil's path, and distances by instant. Left the body with 3σ ellipsoids at six of the estimate's
    nodes in time, on the way in; right the standard deviation of position along it, and the
    arclengths of coil and minimum over time. Lengths in millimetres, times in seconds.
    """
    from matplotlib import colormaps

    with _canvas(10.4, 7.4) as figure:
        figure.set_layout_engine("none")
        bodies = Bodies(figure, 2, _INSTANTS // 2)
        curves = _plane(figure, (7.55, 4.05, 2.7, 2.55), label="std")
        colours = colormaps["viridis"](np.linspace(0.0, 0.8, _INSTANTS))
        for i, (time, coil) in enumerate(_way_in(scene, trial)):
            row, column = divmod(i, _INSTANTS // 2)
            bodies.draw(row, column, trial, time, coil, colours[i])
            place = (1.6 + 2.05 * column) / 10.4, (6.72 - 3.25 * row) / 7.4
            figure.text(*place, f"{time:.1f} s", color=colours[i], ha="center", fontweight="bold")
            _draw_instant(curves, trial, time, coil, colours[i])
        bodies.finish((0.6, 0.4, 6.15, 6.5), (0.1, 0.5))
        _finish_curves(curves)
        _draw_following(_plane(figure, (7.55, 0.65, 2.7, 2.5), label="way"), scene, following)
        explain_bodies(figure, loc="upper center")
    return figure


def _way_in(scene: Scene, trial: Trial) -> list[tuple[float, float]]:
    """Times in s and arclengths in m of the coil, evenly along its way in, at nodes in time."""
    time = trial.posterior.grid.time
    slid = path(scene).at(time)
    slid = slid[: np.argmax(slid) + 1]
    wanted = np.linspace(0.0, 0.85 * slid[-1], _INSTANTS)
    rows = [int(np.argmin(np.abs(slid - place))) for place in wanted]
    return [(float(time[row]), float(bench().rod.length - slid[row])) for row in rows]


def _draw_instant(axes: Any, found: Trial, time: float, coil: float, colour: Any) -> None:
    """The confidence along the body at one instant of figure B, and where the coil is."""
    arclength, std = std_along(found, time)
    low = np.interp(coil, arclength, std) * _MM
    axes.plot(arclength * _MM, std * _MM, color=colour, lw=2.0)
    axes.plot([coil * _MM] * 2, [1e-9, low], color=colour, lw=1.4, ls=(0, (3, 1.5)))
    axes.scatter(coil * _MM, low, s=55, zorder=5, **COIL)


def _finish_curves(axes: Any) -> None:
    """A logarithmic scale that covers the confidence, and names."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    shown = np.concatenate([line.get_ydata() for line in axes.lines])
    shown = shown[shown > 1e-6]
    axes.set(xlabel="arclength (mm)", ylabel="position std. dev. (mm)", yscale="log")
    axes.set(ylim=(0.7 * shown.min(), 1.3 * shown.max()), xlim=(0, 1.03 * bench().rod.length * _MM))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_following(axes: Any, scene: Scene, following: Mapping[str, Any]) -> None:
    """Coil and minimum over time."""
    from matplotlib.ticker import MaxNLocator

    length = bench().rod.length * _MM
    time = np.linspace(0.0, scene.duration, 701)
    told = following["instants"]
    minima = [row["minimum"] * _MM for row in told.values()]
    axes.plot(time, length - path(scene).at(time) * _MM, color="0.45", lw=2.0, label="coil")
    look = {**_MINIMUM, "mfc": "#CC79A7", "ms": 6.5}
    axes.plot([float(t) for t in told], minima, **look, label="minimum")
    axes.axhspan(0.0, _JUDGED * length, color="0.93", zorder=0)
    axes.text(0.25, 0.5 * _JUDGED * length, "clamped:\nnot judged", va="center", fontsize=9)
    axes.set(xlabel="time (s)", ylabel="arclength (mm)", xlim=(0.0, scene.duration))
    axes.set(ylim=(0.0, 1.03 * length))
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.set_title(f"≤ {following['worst'] * _MM:.1f} mm apart at these instants", loc="left")
    axes.legend(loc="upper center", handlelength=1.2)
