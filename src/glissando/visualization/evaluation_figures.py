"""Figures of an evaluation: coverage, ranks of the truth, and errors of an online run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.evaluation.consistency import Consistency
from glissando.evaluation.replay import Replay
from glissando.evaluation.simulation_based import SimulationCheck, bands, rank_points
from glissando.geometry.se3 import Array
from glissando.model.quantiles import chi_square_quantile
from glissando.visualization.canvas import (
    SENSORS,
    legend,
    legend_entries,
    line_colours,
    panels_on,
    shown_name,
)


def calibration_figure(checks: Sequence[Consistency]) -> Any:
    """Draw actual against nominal coverage in % of position and rotation, one line a site.

    The grey band contains, at each level, the line over all sites of a consistent estimate with
    probability 95 %. Below the diagonal an estimate is overconfident.

    Args:
        checks: Results of `check`.

    Returns:
        The axes (1, Q), one for each quantity.

    Raises:
        GlissandoError: matplotlib is not installed, or no position or rotation was checked.
    """
    quantities = calibrated_quantities(checks)
    if not quantities:
        raise GlissandoError("No position or rotation was checked; give truth of either.")
    shape, size = (1, len(quantities)), (5.2 * len(quantities), 5.0)
    with panels_on(None, shape, size) as panels:
        for axes, quantity in zip(panels[0], quantities, strict=True):
            _draw(axes, [c for c in checks if c.quantity == quantity])
            axes.set_title(quantity, loc="left", fontweight="bold")
            axes.set(xlabel="nominal coverage (%)", xlim=(0, 100), ylim=(0, 101), aspect="equal")
        panels[0][0].set_ylabel("errors inside (%)")
        entries = legend_entries(panels[0][0])
        legend(panels[0][0].figure, entries, loc="outside upper center", ncols=4)
    return panels


def calibrated_quantities(checks: Sequence[Consistency]) -> list[str]:
    """Quantities among those checked that `calibration_figure` draws, one axes each."""
    return [q for q in ("position", "rotation") if any(c.quantity == q for c in checks)]


def _draw(axes: Any, checks: Sequence[Consistency]) -> None:
    level = np.linspace(0.01, 0.99, 99)
    whole = checks[-1]
    low, high = np.array([whole.coverage_bounds(p) for p in level]).T
    axes.fill_between(100 * level, 100 * low, 100 * high, color="0.88", label="consistent, 95 %")
    axes.plot([0, 100], [0, 100], color="0.5", linewidth=0.9)
    for c, own in zip(checks, line_colours(len(checks)), strict=True):
        inside = np.mean(c.nees[:, None] <= chi_square_quantile(level, c.dof), axis=0)
        last = c is whole and len(checks) > 1
        colour = "black" if last else own
        width = 2.8 if last else 1.3
        axes.plot(
            100 * level, 100 * inside, color=colour, linewidth=width, label=shown_name(c.site)
        )


def ecdf_figure(checks: Sequence[SimulationCheck]) -> Any:
    """Draw the empirical distribution functions of ranks minus uniform, one panel an estimator.

    If the covariances are correct, the grey band contains the lines of all quantities at once with
    probability `level` of the check. A line above it on the left and below on the right shows an
    overconfident estimate, the reverse an underconfident one; above or below throughout, a bias.

    Args:
        checks: Results of simulation-based calibration.

    Returns:
        The axes (1, E), one for each estimator.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    points = rank_points()
    shape, size = (1, len(checks)), (5.2 * len(checks), 4.2)
    with panels_on(None, shape, size, sharey=True) as panels:
        for axes, check in zip(panels[0], checks, strict=True):
            low, high = bands(check.checks[0].ranks.size, check.p_limit)
            axes.fill_between(points, low, high, color="0.88", label=f"uniform, {check.level:.0%}")
            axes.axhline(0.0, color="0.5", linewidth=0.9)
            for c in check.checks:
                outside = c.p_value < check.p_limit
                look = {"color": SENSORS[6], "linewidth": 1.8, "label": c.name}
                plain = {"color": "0.35", "linewidth": 0.8}
                axes.plot(points, c.ecdf_difference, **(look if outside else plain))
            axes.set_title(check.estimator, loc="left", fontweight="bold")
            axes.set(xlabel="rank of the truth", xlim=(0, 1))
            axes.legend(fontsize="small", loc="upper right")
        panels[0][0].set_ylabel("ECDF − uniform")
    return panels


def replay_figure(run: Replay) -> Any:
    """Draw errors of the newest states with their confidence over time, and the latencies.

    Args:
        run: Result of `replay`.

    Returns:
        The axes (2, 1).

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    with panels_on(None, (2, 1), (9.0, 5.6)) as panels:
        upper, lower = panels[:, 0]
        _draw_newest(upper, run)
        latency = 1e3 * np.sort(run.latency)
        lower.plot(latency, 100.0 * (np.arange(latency.size) + 1) / latency.size, color="black")
        lower.set(xlabel="latency (ms)", ylabel="updates done (%)", ylim=(0, 101), xlim=(0, None))
        for share in (50, 99):
            value = float(np.percentile(latency, share))
            lower.axvline(value, color="0.6", linewidth=0.9)
            lower.text(value, 5, f" {share} %: {value:.1f} ms", color="0.35")
    return panels


def _draw_newest(axes: Any, run: Replay) -> None:
    length = run.robot.length
    radius = 1e3 * np.array([radius95(s.position_covariance()) for s in run.states])
    shown = [radius]
    for share, line in ((0.5, "--"), (1.0, "-")):
        at = int(np.argmin(np.abs(run.robot.arclength_nodes - share * length)))
        label = f"95 % at {1e3 * run.robot.arclength_nodes[at]:.0f} mm"
        axes.plot(run.time, radius[:, at], line, color="black", linewidth=1.0, label=label)
    colours = line_colours(len(run.newest))
    for errors, colour in zip(run.newest, colours, strict=True):
        look = {"color": colour, "markersize": 3, "alpha": 0.6}
        axes.plot(errors.time, 1e3 * errors.position, ".", **look, label=shown_name(errors.name))
        shown.append(1e3 * errors.position)
    top = 1.1 * float(np.nanquantile(np.concatenate([s.ravel() for s in shown]), 0.99))
    axes.set(xlabel="time (s)", ylabel="position error (mm)", ylim=(0, top or None))
    legend(axes.figure, legend_entries(axes), loc="outside upper center", ncols=4)


def radius95(cov: Array) -> Array:
    """Radius (…) that contains 95 % of errors with covariances (…, 3, 3).

    The squared distance is approximated by a scaled chi-square of the same mean and variance.
    """
    mean = np.einsum("...ii->...", cov)
    square = np.einsum("...ij,...ji->...", cov, cov)
    dof = mean**2 / square
    return np.asarray(np.sqrt(square / mean * chi_square_quantile(0.95, dof)))
