"""Three figures of a posterior: the robot in space, its confidence everywhere, its errors.

Lengths are drawn in millimetres, confidence at 95 %: ellipsoids and tubes hold 95 % of positions,
bands 95 % of a component. Every function takes axes to draw into and a style, rcParams that it
draws with, and returns the axes. matplotlib is imported when a figure is asked for, not before;
figures carry their own Agg canvas, so no window opens and no global plotting state changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.confidence_tube import SIGMAS_95
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import CoilReadings, PoseReadings, PositionReadings
from glissando.visualization.arrows import Arrows, arrows_of
from glissando.visualization.canvas import (
    AXES,
    BAND,
    INCH,
    MARKERS,
    MM,
    NO_STYLE,
    SENSORS,
    SIDES,
    Style,
    describe,
    panels_on,
    save_figure,
)
from glissando.visualization.sampling import drawn_at

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NEAR = 0.1  # s: a truth sample this close to a drawn time is drawn with it
_FIXED_SITES = 12  # a stream at more arclengths than this slides and is one row of errors
_MOST = 301  # times or arclengths of a map of confidence
_SAMPLES = 1000  # truth samples drawn a site
_POSITIONED = PoseReadings | CoilReadings | PositionReadings  # streams that see a position
_DOT: dict[str, Any] = {"color": "black", "depthshade": False}


def _places(streams: Sequence[Readings], grid: Grid, kind: Any = _POSITIONED) -> list[Readings]:
    """The streams of a kind, inside the grid and in time order, one batch a site.

    A stream at a few fixed arclengths is split into them; one that slides stays whole.
    """
    out: list[Readings] = []
    for stream in (s for s in streams if isinstance(s, kind)):
        kept: Readings = stream.inside(grid)
        kept = kept.select(np.argsort(kept.time, kind="stable"))
        near = kept.arclength.round(6)
        if np.unique(near).size > _FIXED_SITES:
            near[:] = 0.0
        out.extend(kept.select(near == site) for site in np.unique(near))
    return out


def _seen(readings: Readings) -> Array:
    """Positions (M, 3) in the world that a batch of `_places` reports, metres."""
    return readings.values[:, :3, 3] if readings.values.ndim == 3 else readings.values


def shape_figure(
    posterior: Posterior,
    truth: Sequence[Readings],
    times: Sequence[float] | None = None,
    *,
    ax: Axes | None = None,
    size: tuple[float, float] = (8.0, 7.6),
    style: Style = NO_STYLE,
) -> Axes:
    """The robot in space at several times, with 95 % ellipsoids and the truth.

    Where the prior knows loads, arrows show the unknown forces, with the ellipsoids of their tips.

    Args:
        posterior: What is drawn.
        truth: Streams of poses become triads and of positions points, at their sample within 0.1 s.
        times: Seconds; five across the grid unless given.
        ax: Axes to draw into, with projection="3d"; those of a new figure unless given.
        size: Width and height of a new figure, inches.
        style: rcParams to draw with.

    Returns:
        The axes, in the world frame and millimetres; `.figure` is their figure.

    Raises:
        OutsideGridError: A time is off the grid.
        GlissandoError: matplotlib is not installed.
    """
    grid = posterior.grid
    if times is None:
        times = np.unique(np.linspace(grid.time[0], grid.time[-1], 5)).tolist()
    dense, few = drawn_at(grid.arclength, 99), np.linspace(grid.arclength[0], grid.arclength[-1], 6)
    lines = [posterior.at(dense, time).position * MM for time in times]
    sites, forces = _places(truth, grid), arrows_of(posterior, np.asarray(times, dtype=float))
    look = {"projection": "3d", "elev": 20, "azim": -60, "computed_zorder": False}
    with panels_on(ax, (1, 1), size, style, subplot_kw=look) as panels:
        from matplotlib import colormaps

        axes: Any = panels[0, 0]
        colours = colormaps["viridis"](np.linspace(0.0, 0.88, len(times)))
        reach = 0.06 * np.ptp(np.concatenate(lines), axis=0).max()
        corners = [*lines]
        for time, line, colour in zip(times, lines, colours, strict=True):
            at = posterior.at(few, time)
            corners += _draw_ellipsoids(axes, at.position, at.cov_position_world, colour)
            axes.plot(*line.T, color=colour, linewidth=2.8, zorder=3, label=f"{seconds(time)} s")
        if forces:
            corners += _draw_forces(axes, forces, colours)
        corners += [_draw_truth(axes, site, time, reach) for time in times for site in sites]
        base = np.stack([line[0] for line in lines]).T
        axes.scatter(*base, **_DOT, s=90, marker="s", zorder=5, label="base")
        _frame(axes, np.concatenate(corners))
        _explain(axes, ax is None, sites, forces.words if forces else "")
    return axes


def _draw_ellipsoids(axes: Any, centre: Array, cov: Array, colour: Any) -> list[Array]:
    """Draw the 95 % ellipsoids of points (M, 3) in metres; their bounding corners in mm."""
    around, down = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 15))
    ball = np.stack([np.cos(around) * np.sin(down), np.sin(around) * np.sin(down), np.cos(down)])
    variance, directions = np.linalg.eigh(cov)
    stretch = SIGMAS_95 * MM * np.sqrt(np.maximum(variance, 0.0))[:, None, :] * directions
    centre = centre * MM
    for place, axis in zip(centre, stretch, strict=True):
        x, y, z = place[:, None, None] + np.einsum("ij,jkl->ikl", axis, ball)
        axes.plot_surface(x, y, z, color=colour, alpha=0.12, linewidth=0, shade=False, zorder=2)
    half = np.linalg.norm(stretch, axis=-1)
    return [centre - half, centre + half]


def _draw_forces(axes: Any, forces: Arrows, colours: Array) -> list[Array]:
    """Draw arrows and the ellipsoids of their tips, a colour a time; bounding corners in mm."""
    corners = []
    for k, (strokes, colour) in enumerate(zip(forces.strokes(), colours, strict=True)):
        axes.plot(*MM * strokes.reshape(-1, 3).T, color=colour, linewidth=1.6, zorder=4)
        corners += _draw_ellipsoids(axes, forces.tip[k], forces.scale**2 * forces.cov[k], colour)
    return corners


def _draw_truth(axes: Any, site: Readings, time: float, reach: float) -> Array:
    """Draw a site's sample nearest in time, if near; the points drawn (…, 3) in mm."""
    row = int(np.argmin(np.abs(site.time - time)))
    if abs(site.time[row] - time) > _NEAR:
        return np.empty((0, 3))
    origin = _seen(site)[row] * MM
    if site.values.ndim == 2:
        axes.scatter(*origin[:, None], **_DOT, s=24, zorder=4, label="truth: point")
        return origin[None]
    tips: Array = origin + reach * site.values[row, :3, :3].T  # a row an axis
    for tip, colour in zip(tips, AXES.values(), strict=True):
        axes.plot(*np.stack([origin, tip]).T, color=colour, linewidth=1.8, zorder=4)
    return tips


def _frame(axes: Any, points: Array) -> None:
    """Equal scales around all points (M, 3) in millimetres, and labels."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.53 * np.maximum(high - low, 0.4 * (high - low).max() + 1e-6)  # never a thin slab
    ends = np.stack([0.5 * (low + high) - half, 0.5 * (low + high) + half], axis=1)
    axes.set(xlim=ends[0], ylim=ends[1], zlim=ends[2])
    for i, axis in enumerate((axes.xaxis, axes.yaxis, axes.zaxis)):
        axis.get_major_locator().set_params(nbins=round(6 * half[i] / half.max()), prune="both")
        axis.set_label_text(f"{'xyz'[i]} (mm)")
        axis.labelpad = 16 if i == 2 else 10
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
    axes.tick_params(axis="z", pad=7)
    axes.set_box_aspect(half, zoom=1.06)


def _explain(axes: Any, own: bool, sites: Sequence[Readings], forces: str) -> None:
    """The legend of the shape: a line a time, base, ellipsoids, and what forces and truth are."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    entries["95 % of positions"] = Patch(color="0.5", alpha=0.35, linewidth=0)
    if forces:
        entries[forces] = Line2D([], [], color="0.3", lw=1.4, marker=">", markevery=(1, 1), ms=6)
    if any(site.values.ndim == 3 for site in sites):
        entries["truth: x, y, z"] = tuple(Line2D([], [], color=c) for c in AXES.values())
    describe(axes, own, entries, loc="outside right upper")


def confidence_figure(
    posterior: Posterior,
    readings: Sequence[Readings],
    *,
    ax: Axes | None = None,
    size: tuple[float, float] = (10.0, 5.2),
    style: Style = NO_STYLE,
) -> Axes:
    """The std of position at every arclength and time, and where each sensor was.

    Colour is the root of the total position variance, at nodes and between them.

    Args:
        posterior: What is drawn.
        readings: Streams that were used.
        ax: Axes to draw into; those of a new figure unless given.
        size: Width and height of a new figure, inches.
        style: rcParams to draw with.

    Returns:
        The axes, in millimetres and seconds; `.figure` is their figure.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    grid = posterior.grid
    time, time_drawn = _drawn(grid.time, 120)
    arclength, arclength_drawn = _drawn(grid.arclength, 80)
    std = posterior.at(arclength[:, None], time).std_position * MM
    top = float(np.quantile(std, 0.99))
    over: Any = "max" if std.max() > 1.02 * top else "neither"
    used = [stream for stream in (r.inside(grid) for r in readings) if len(stream)]
    with panels_on(ax, (1, 1), size, style) as panels:
        axes: Any = panels[0, 0]
        at = time_drawn, arclength_drawn * MM
        look = {"cmap": "viridis", "shading": "gouraud", "rasterized": True}
        shade = axes.pcolormesh(*at, std, vmin=0.0, vmax=top, **look)
        label = "position standard deviation (mm)"
        axes.figure.colorbar(shade, ax=axes, label=label, pad=0.015, extend=over)
        for order, stream in enumerate(used):
            _draw_path(axes, stream, order, len(used))
        axes.set(xlabel="time (s)", ylabel="arclength (mm)")
        axes.margins(0.0)
        entries = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
        if used:
            describe(axes, ax is None, entries, loc="outside upper center", ncols=min(len(used), 5))
    return axes


def _drawn(nodes: Array, steps: int) -> tuple[Array, Array]:
    """Where to query and draw; a single node is drawn with a width of 1."""
    if nodes.size == 1:
        return nodes[[0, 0]], nodes[0] + np.array([-0.5, 0.5])
    at = drawn_at(nodes, steps, _MOST)
    return at, at


def _draw_path(axes: Any, stream: Readings, order: int, count: int) -> None:
    """One sensor's path over time and arclength; markers of sensors in one place alternate."""
    stream = stream.select(np.argsort(stream.time, kind="stable"))
    time, arclength = stream.time, stream.arclength * MM
    wanted = time[0] + (time[-1] - time[0]) * (np.arange(16) + (order + 0.5) / count) / 16
    at = np.unique(np.searchsorted(time, wanted).clip(0, time.size - 1))
    thin = slice(None, None, -(-time.size // 2000))
    colour, marker = SENSORS[order % len(SENSORS)], MARKERS[order % len(MARKERS)]
    look = {"mfc": colour, "mec": "black", "mew": 0.8, "ms": 7.5, "clip_on": False, "zorder": 5}
    axes.plot(time[thin], arclength[thin], color="white", lw=1.0, alpha=0.7)
    axes.plot(time[at], arclength[at], marker, **look, label=stream.label)


def error_figure(
    posterior: Posterior,
    truth: Sequence[Readings],
    *,
    ax: Any = None,
    size: tuple[float, float] | None = None,
    style: Style = NO_STYLE,
) -> Any:
    """Position errors at every truth site over time, each component in its 95 % band.

    Args:
        posterior: The estimate.
        truth: Streams it is compared with.
        ax: Axes (S, 3) to draw into, a row a site; those of a new figure unless given.
        size: Width and height of a new figure, inches.
        style: rcParams to draw with.

    Returns:
        The axes (S, 3): estimate minus truth in the world frame, mm; the band is of both together.

    Raises:
        GlissandoError: No truth position lies on the grid, the axes are not as many, or matplotlib
            is not installed.
    """
    sites = _places(truth, posterior.grid)
    if not sites:
        raise GlissandoError("No truth position lies on the grid: give a stream that overlaps it.")
    size, shares = (
        size or (11.0, min(0.9 + 1.75 * len(sites), SIDES[1] / INCH)),
        {"sharex": True, "sharey": "row"},
    )
    with panels_on(ax, (len(sites), 3), size, style, **shares) as table:
        for row, site in zip(table, sites, strict=True):
            _draw_errors(row, posterior, site)
        for name, top, bottom in zip(AXES, table[0], table[-1], strict=True):
            top.set_title(name, loc="right", fontweight="bold", fontsize=13)
            bottom.set_xlabel("time (s)")
        drawn = [axes.get_legend_handles_labels()[0] for axes in table[0]]
        entries = {"95 %": drawn[0][0], "estimate − truth": tuple(keys[1] for keys in drawn)}
        describe(table[0, 0], ax is None, entries, loc="outside upper right", ncols=2)
    return table


def _draw_errors(row: Sequence[Any], posterior: Posterior, site: Readings) -> None:
    """One site's three components, with its name, arclength and RMSE as the title."""
    drawn = site.select(slice(None, None, -(-len(site) // _SAMPLES)))
    estimate = posterior.at(drawn.arclength, drawn.time)
    at = estimate.pose @ drawn.mount
    error = (at[:, :3, 3] - _seen(drawn)) * MM
    cov = drawn.cov[..., :3, :3]
    if drawn.values.ndim == 3:
        cov = at[:, :3, :3] @ cov @ np.swapaxes(at[:, :3, :3], -1, -2)
    turn = at[:, :3, :3]
    cov = cov + turn @ estimate.position_covariance(drawn.mount) @ np.swapaxes(turn, -1, -2)
    band = BAND * MM * np.sqrt(np.einsum("mii->mi", cov))
    steps = np.diff(drawn.time, prepend=drawn.time[0])
    gaps = np.flatnonzero(steps > 8.0 * np.median(steps))
    time = np.insert(drawn.time, gaps, np.nan)
    line, wide = (np.insert(values, gaps, np.nan, axis=0) for values in (error, band))
    if time.size == 1:  # drawn 1 s wide
        time, line, wide = time + np.array([-0.5, 0.5]), line.repeat(2, 0), wide.repeat(2, 0)
    for i, (axes, colour) in enumerate(zip(row, AXES.values(), strict=True)):
        axes.fill_between(time, -wide[:, i], wide[:, i], color="0.87", linewidth=0, label="95 %")
        axes.axhline(0.0, color="0.55", linewidth=0.8)
        axes.plot(time, line[:, i], color=colour, linewidth=1.5, label="estimate − truth")
        axes.margins(x=0.0)
        axes.locator_params(axis="y", nbins=5)
    few = "" if len(drawn) == len(site) else f" ({len(drawn)} of {len(site)} samples)"
    rmse = np.sqrt(np.mean(np.sum(error**2, axis=1)))
    ends = dict.fromkeys(f"{s:.4g}" for s in MM * np.sort(site.arclength)[[0, -1]])
    row[0].set_title(f"{site.label}, {' to '.join(ends)} mm: RMSE {rmse:.2f} mm{few}", loc="left")
    row[0].set_ylabel("error (mm)")


def save_figures(
    posterior: Posterior, readings: Sequence[Readings], truth: Sequence[Readings], folder: Path
) -> list[Path]:
    """Write shape.png, confidence.png and, given truth positions, error.png; their paths.

    The folder is made if it is missing. Raises GlissandoError without matplotlib.
    """
    figures = {"shape": shape_figure(posterior, truth)}
    figures["confidence"] = confidence_figure(posterior, readings)
    if _places(truth, posterior.grid):
        figures["error"] = error_figure(posterior, truth)
    return [save_figure(figure, folder / f"{name}.png") for name, figure in figures.items()]
