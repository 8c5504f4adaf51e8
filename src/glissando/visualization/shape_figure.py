"""Figure of a robot in space: its shapes over time with ellipsoids, forces and truth.

Lengths are in millimetres; ellipsoids contain 95 % of positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.estimation.confidence_tube import SIGMAS_95
from glissando.estimation.posterior import Posterior
from glissando.geometry.covariance import half_axes
from glissando.geometry.se3 import Array
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings
from glissando.visualization.arrows import Arrows, arrows_of
from glissando.visualization.canvas import (
    AXES,
    MM,
    NO_STYLE,
    Style,
    describe,
    legend_entries,
    panels_on,
)
from glissando.visualization.sampling import drawn_at
from glissando.visualization.sites import NEAR, seen_positions, sites_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TRUTH_DOT: dict[str, Any] = {"color": "black", "depthshade": False}
"""Style of a truth position."""


def shape_figure(
    posterior: Posterior,
    truth: Sequence[Readings],
    times: Sequence[float] | None = None,
    *,
    ax: Axes | None = None,
    size: tuple[float, float] = (8.0, 7.6),
    style: Style = NO_STYLE,
) -> Axes:
    """Draw the robot in space at several times, with 95 % ellipsoids and the truth.

    If the prior has loads, arrows show the estimated forces, with the ellipsoids of their tips.

    Args:
        posterior: Estimate to draw.
        truth: Truth, drawn at its nearest sample within 0.1 s: poses as triads, positions as dots.
        times: Times, s; None for five across the grid.
        ax: Axes to draw into, with projection="3d"; None for those of a new figure.
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
    sites, forces = sites_of(truth, grid), arrows_of(posterior, np.asarray(times, dtype=float))
    look = {"projection": "3d", "elev": 20, "azim": -60, "computed_zorder": False}
    with panels_on(ax, (1, 1), size, style, subplot_kw=look) as panels:
        from matplotlib import colormaps

        axes: Any = panels[0, 0]
        colours = colormaps["viridis"](np.linspace(0.0, 0.88, len(times)))
        reach = 0.06 * np.ptp(np.concatenate(lines), axis=0).max()
        corners = [*lines]
        for time, line, colour in zip(times, lines, colours, strict=True):
            at = posterior.at(few, time)
            corners += draw_ellipsoids(axes, at.position, at.cov_position_world, colour)
            axes.plot(*line.T, color=colour, linewidth=2.8, zorder=3, label=f"{seconds(time)} s")
        if forces:
            corners += _draw_forces(axes, forces, colours)
        corners += [draw_truth(axes, site, time, reach) for time in times for site in sites]
        base = np.stack([line[0] for line in lines]).T
        axes.scatter(*base, **TRUTH_DOT, s=90, marker="s", zorder=5, label="base")
        frame_axes(axes, np.concatenate(corners))
        _draw_legend(axes, ax is None, sites, forces.words if forces else "")
    return axes


def draw_ellipsoids(axes: Any, centre: Array, cov: Array, colour: Any) -> list[Array]:
    """Draw the 95 % ellipsoids of positions (M, 3) in m; returns bounding corners in mm."""
    around, down = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 15))
    ball = np.stack([np.cos(around) * np.sin(down), np.sin(around) * np.sin(down), np.cos(down)])
    stretch = SIGMAS_95 * MM * half_axes(cov)
    centre = centre * MM
    for place, axis in zip(centre, stretch, strict=True):
        x, y, z = place[:, None, None] + np.einsum("ij,jkl->ikl", axis, ball)
        axes.plot_surface(x, y, z, color=colour, alpha=0.12, linewidth=0, shade=False, zorder=2)
    half = np.linalg.norm(stretch, axis=-1)
    return [centre - half, centre + half]


def _draw_forces(axes: Any, forces: Arrows, colours: Array) -> list[Array]:
    """Draw arrows and their tips' ellipsoids, one colour a time; returns bounding corners in mm."""
    corners = []
    for k, (strokes, colour) in enumerate(zip(forces.strokes(), colours, strict=True)):
        axes.plot(*MM * strokes.reshape(-1, 3).T, color=colour, linewidth=1.6, zorder=4)
        corners += draw_ellipsoids(axes, forces.tip[k], forces.scale**2 * forces.cov[k], colour)
    return corners


def draw_truth(axes: Any, site: Readings, time: float, reach: float) -> Array:
    """Draw a site's nearest sample if it is within 0.1 s; returns the points (…, 3) in mm."""
    row = int(np.argmin(np.abs(site.time - time)))
    if abs(site.time[row] - time) > NEAR:
        return np.empty((0, 3))
    origin = seen_positions(site)[row] * MM
    if site.values.ndim == 2:
        axes.scatter(*origin[:, None], **TRUTH_DOT, s=24, zorder=4, label="truth: point")
        return origin[None]
    tips: Array = origin + reach * site.values[row, :3, :3].T  # one row per axis
    for tip, colour in zip(tips, AXES.values(), strict=True):
        axes.plot(*np.stack([origin, tip]).T, color=colour, linewidth=1.8, zorder=4)
    return tips


def _draw_legend(axes: Any, own: bool, sites: Sequence[Readings], forces: str) -> None:
    """Draw the legend: times, base, ellipsoids, forces and truth."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries = legend_entries(axes)
    entries["95 % of positions"] = Patch(color="0.5", alpha=0.35, linewidth=0)
    if forces:
        entries[forces] = Line2D([], [], color="0.3", lw=1.4, marker=">", markevery=(1, 1), ms=6)
    if any(site.values.ndim == 3 for site in sites):
        entries["truth: x, y, z"] = tuple(Line2D([], [], color=c) for c in AXES.values())
    describe(axes, own, entries, loc="outside right upper")


def frame_axes(axes: Any, points: Array, zoom: float = 1.06) -> None:
    """Set equal scales that contain all points (M, 3) in millimetres, and label the axes."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.53 * np.maximum(high - low, 0.4 * (high - low).max() + 1e-6)  # limits the flatness
    ends = np.stack([0.5 * (low + high) - half, 0.5 * (low + high) + half], axis=1)
    axes.set(xlim=ends[0], ylim=ends[1], zlim=ends[2])
    for i, axis in enumerate((axes.xaxis, axes.yaxis, axes.zaxis)):
        axis.get_major_locator().set_params(nbins=round(6 * half[i] / half.max()), prune="both")
        axis.set_label_text(f"{'xyz'[i]} (mm)")
        axis.labelpad = 16 if i == 2 else 10
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
    axes.tick_params(axis="z", pad=7)
    axes.set_box_aspect(half, zoom=zoom)
