"""Figure of contact evidence over arclength and time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.estimation.contact import ContactScan
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.evenly import evenly_chosen
from glissando.visualization.canvas import MM, NO_STYLE, Style, legend, legend_entries, panels_on

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST = 200  # times of a map
_LEAST = 10.0  # smallest upper end of the colour scale, log evidence


def mapped_times(posterior: Posterior) -> Array:
    """Time nodes (K,) of a posterior that a map shows: all, or as many as are distinguishable."""
    time = posterior.grid.time
    rows = evenly_chosen(time.size, _MOST)
    return np.asarray(time[rows])


def contact_figure(
    scan: ContactScan,
    *,
    size: tuple[float, float] = (10.0, 5.6),
    style: Style = NO_STYLE,
) -> np.ndarray[Any, Any]:
    """Draw the evidence of a contact at every arclength and time, and of a contact anywhere.

    Colour is the log evidence of a force at a point against none, clipped below zero. Dots are the
    likeliest arclengths at times at which a contact is detected.

    Args:
        scan: Scans of K times, from `scan_contacts` or, online, `ContactScan.over`.
        size: Width and height, inches.
        style: rcParams to draw with.

    Returns:
        The axes (2,), in millimetres and seconds: the map, and the evidence with its threshold.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    shares = {"sharex": True, "height_ratios": [2.2, 1.0]}
    with panels_on(None, (2, 1), size, style, **shares) as panels:
        upper, lower = panels.ravel()
        _draw_map(upper, scan)
        _draw_evidence(lower, scan)
        entries = legend_entries(lower)
        entries |= legend_entries(upper)
        legend(upper.figure, entries, loc="outside upper center", ncols=len(entries))
    return np.array([upper, lower], dtype=object)


def _draw_map(axes: Axes, scan: ContactScan) -> None:
    """Draw log evidence over time and arclength, one cell for each pair."""
    top = max(float(scan.log_ratio.max()), _LEAST)
    edges = _edges(scan.time), MM * np.maximum(_edges(scan.arclength), 0.0)
    look: dict[str, Any] = {"cmap": "viridis", "vmin": 0.0, "vmax": top, "rasterized": True}
    shade = axes.pcolormesh(*edges, scan.log_ratio.T, **look)
    label = "log evidence of a force there"
    axes.figure.colorbar(shade, ax=axes, label=label, pad=0.015, extend="min")
    touched = scan.detected
    if touched.any():
        at = scan.time[touched], MM * scan.arclength[scan.best[touched]]
        axes.plot(*at, "o", mfc="white", mec="black", ms=4.0, ls="none", label="likeliest place")
    axes.set_ylabel("arclength (mm)")


def _draw_evidence(axes: Axes, scan: ContactScan) -> None:
    """Draw the log evidence of a force anywhere, and the threshold of detection."""
    label = f"threshold: one false alarm in {1.0 / scan.false_alarms:.3g}"
    axes.plot(scan.time, scan.evidence, ".-", color="#0072B2", label="evidence anywhere")
    axes.plot(scan.time, scan.threshold, "--", color="#D55E00", label=label)
    axes.set(xlabel="time (s)", ylabel="log evidence")
    axes.grid(True, axis="y")


def _edges(middle: Array) -> Array:
    """Edges (K + 1,) of cells around their centres (K,); a single cell has width 1."""
    if middle.size == 1:
        return middle[0] + np.array([-0.5, 0.5])
    between = 0.5 * (middle[1:] + middle[:-1])
    first, last = 2.0 * middle[0] - between[0], 2.0 * middle[-1] - between[-1]
    return np.concatenate([[first], between, [last]])
