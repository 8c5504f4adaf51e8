"""Figures of a posterior: its position uncertainty and its errors, or all of them in a folder.

Lengths are in millimetres and confidence at 95 %: ellipsoids and tubes contain 95 % of positions,
bands 95 % of a component. Every function accepts axes to draw into and a style (rcParams), and
returns the axes. matplotlib is imported only when a figure is drawn; figures have their own Agg
canvas, so no window opens and no global plotting state changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings
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
    legend_entries,
    panels_on,
    save_figure,
    shown_name,
)
from glissando.visualization.sampling import drawn_at
from glissando.visualization.shape_figure import shape_figure
from glissando.visualization.sites import seen_positions, sites_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST = 301  # times or arclengths of a map of standard deviations
_SAMPLES = 1000  # truth samples drawn for each site


def confidence_figure(
    posterior: Posterior,
    readings: Sequence[Readings],
    *,
    ax: Axes | None = None,
    size: tuple[float, float] = (10.0, 5.2),
    style: Style = NO_STYLE,
) -> Axes:
    """Draw the standard deviation of position over arclength and time, and the sensors' paths.

    Colour is the square root of the total position variance, at nodes and between them.

    Args:
        posterior: Estimate to draw.
        readings: Streams that the estimate used.
        ax: Axes to draw into; None for those of a new figure.
        size: Width and height of a new figure, inches.
        style: rcParams to draw with.

    Returns:
        The axes, in millimetres and seconds; `.figure` is their figure.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    grid = posterior.grid
    time, time_drawn = _sample_points(grid.time, 120)
    arclength, arclength_drawn = _sample_points(grid.arclength, 40)
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
        entries = legend_entries(axes)
        if used:
            describe(axes, ax is None, entries, loc="outside upper center", ncols=min(len(used), 5))
    return axes


def _sample_points(nodes: Array, steps: int) -> tuple[Array, Array]:
    """Points to query, and their coordinates in the figure; a single node is drawn 1 wide."""
    if nodes.size == 1:
        return nodes[[0, 0]], nodes[0] + np.array([-0.5, 0.5])
    at = drawn_at(nodes, steps, _MOST)
    return at, at


def _draw_path(axes: Any, stream: Readings, order: int, count: int) -> None:
    """Draw a sensor's path over time and arclength; markers of coincident sensors alternate."""
    stream = stream.select(np.argsort(stream.time, kind="stable"))
    time, arclength = stream.time, stream.arclength * MM
    wanted = time[0] + (time[-1] - time[0]) * (np.arange(16) + (order + 0.5) / count) / 16
    at = np.unique(np.searchsorted(time, wanted).clip(0, time.size - 1))
    thin = slice(None, None, -(-time.size // 2000))
    colour, marker = SENSORS[order % len(SENSORS)], MARKERS[order % len(MARKERS)]
    look = {"mfc": colour, "mec": "black", "mew": 0.8, "ms": 7.5, "clip_on": False, "zorder": 5}
    axes.plot(time[thin], arclength[thin], color="white", lw=1.0, alpha=0.7)
    axes.plot(time[at], arclength[at], marker, **look, label=shown_name(stream.label))


def error_figure(
    posterior: Posterior,
    truth: Sequence[Readings],
    *,
    ax: Any = None,
    size: tuple[float, float] | None = None,
    style: Style = NO_STYLE,
) -> Any:
    """Draw position errors at every truth site over time, each component with its 95 % band.

    Args:
        posterior: The estimate.
        truth: Streams that the estimate is compared with.
        ax: Axes (S, 3) to draw into, one row a site; None for those of a new figure.
        size: Width and height of a new figure, inches.
        style: rcParams to draw with.

    Returns:
        The axes (S, 3): estimate minus truth in the world frame, mm; the band includes the
        uncertainty of both.

    Raises:
        GlissandoError: No truth position lies on the grid, the number of axes is wrong, or
            matplotlib is not installed.
    """
    sites = sites_of(truth, posterior.grid)
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
            heading = f"{name}\n"  # above the site's title, which may be long
            top.set_title(heading, loc="right", fontweight="bold", fontsize=13)
            bottom.set_xlabel("time (s)")
        drawn = [axes.get_legend_handles_labels()[0] for axes in table[0]]
        entries = {"95 %": drawn[0][0], "estimate − truth": tuple(keys[1] for keys in drawn)}
        describe(table[0, 0], ax is None, entries, loc="outside upper right", ncols=2)
    return table


def _draw_errors(row: Sequence[Any], posterior: Posterior, site: Readings) -> None:
    """Draw three components at one site, with its name, arclength and RMSE as the title."""
    drawn = site.select(slice(None, None, -(-len(site) // _SAMPLES)))
    estimate = posterior.at(drawn.arclength, drawn.time)
    at = estimate.pose @ drawn.mount
    error = (at[:, :3, 3] - seen_positions(drawn)) * MM
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
    where = f"{shown_name(site.label)}, {' to '.join(ends)} mm"
    row[0].set_title(f"{where}: RMSE {rmse:.2f} mm{few}", loc="left")
    row[0].set_ylabel("error (mm)")


def save_figures(
    posterior: Posterior, readings: Sequence[Readings], truth: Sequence[Readings], folder: Path
) -> list[Path]:
    """Write shape.png, confidence.png and, if there is truth, error.png; returns their paths.

    The folder is created if it is missing. Raises GlissandoError without matplotlib.
    """
    figures = {"shape": shape_figure(posterior, truth)}
    figures["confidence"] = confidence_figure(posterior, readings)
    if sites_of(truth, posterior.grid):
        figures["error"] = error_figure(posterior, truth)
    return [save_figure(figure, folder / f"{name}.png") for name, figure in figures.items()]
