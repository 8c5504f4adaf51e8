"""Figures of an evaluation: nominal against actual coverage, and how an online run went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.evaluation.consistency import Consistency
from glissando.evaluation.replay import Replay
from glissando.evaluation.simulation_based import SimulationCheck, bands, rank_points
from glissando.model.quantiles import chi_square_quantile
from glissando.visualization.figures import _SENSORS, _canvas

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def calibration_figure(checks: Sequence[Consistency]) -> Figure:
    """Actual against nominal coverage in %, position and rotation, a line a site.

    The grey band holds a consistent estimate's line over all sites at each level with probability
    95 %. Below the diagonal an estimate is overconfident. Raises GlissandoError without matplotlib.
    """
    quantities = [q for q in ("position", "rotation") if any(c.quantity == q for c in checks)]
    with _canvas(5.2 * len(quantities), 5.0) as figure:
        panels: Any = figure.subplots(1, len(quantities), squeeze=False)
        for axes, quantity in zip(panels[0], quantities, strict=True):
            _draw(axes, [c for c in checks if c.quantity == quantity])
            axes.set_title(quantity, loc="left", fontweight="bold")
            axes.set(xlabel="nominal coverage (%)", xlim=(0, 100), ylim=(0, 101), aspect="equal")
        panels[0][0].set_ylabel("errors inside (%)")
        handles, labels = panels[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure


def _draw(axes: Any, checks: Sequence[Consistency]) -> None:
    level = np.linspace(0.01, 0.99, 99)
    whole = checks[-1]
    low, high = np.array([whole.coverage_bounds(p) for p in level]).T
    axes.fill_between(100 * level, 100 * low, 100 * high, color="0.88", label="consistent, 95 %")
    axes.plot([0, 100], [0, 100], color="0.5", linewidth=0.9)
    for order, c in enumerate(checks):
        inside = np.mean(c.nees[:, None] <= chi_square_quantile(level, c.dof), axis=0)
        last = c is whole and len(checks) > 1
        colour = "black" if last else _SENSORS[(0, 1, 3, 4, 6, 7)[order % 6]]
        width = 2.8 if last else 1.3
        axes.plot(100 * level, 100 * inside, color=colour, linewidth=width, label=c.site)


def ecdf_figure(checks: Sequence[SimulationCheck]) -> Figure:
    """Distribution functions of ranks less that of uniform ones, a panel an estimator.

    The grey band holds the lines of all quantities at once with the check's level if confidence is
    true. A line above it on the left and below on the right is that of an overconfident estimate,
    the other way round an underconfident one; above or below throughout, a biased one. Raises
    GlissandoError without matplotlib.
    """
    points = rank_points()
    with _canvas(5.2 * len(checks), 4.2) as figure:
        panels: Any = figure.subplots(1, len(checks), squeeze=False, sharey=True)
        for axes, check in zip(panels[0], checks, strict=True):
            low, high = bands(check.checks[0].ranks.size, check.p_limit)
            axes.fill_between(points, low, high, color="0.88", label=f"uniform, {check.level:.0%}")
            axes.axhline(0.0, color="0.5", linewidth=0.9)
            for c in check.checks:
                outside = c.p_value < check.p_limit
                look = {"color": _SENSORS[6], "linewidth": 1.8, "label": c.name}
                plain = {"color": "0.35", "linewidth": 0.8}
                axes.plot(points, c.ecdf_difference, **(look if outside else plain))
            axes.set_title(check.estimator, loc="left", fontweight="bold")
            axes.set(xlabel="rank of the truth", xlim=(0, 1))
            axes.legend(fontsize="small", loc="upper right")
        panels[0][0].set_ylabel("ECDF − uniform")
    return figure


def replay_figure(run: Replay) -> Figure:
    """Errors of the newest states and their confidence over time, and latencies by frequency.

    Raises GlissandoError without matplotlib.
    """
    with _canvas(9.0, 5.6) as figure:
        upper, lower = figure.subplots(2, 1)
        _draw_newest(upper, run)
        latency = 1e3 * np.sort(run.latency)
        lower.plot(latency, 100.0 * (np.arange(latency.size) + 1) / latency.size, color="black")
        lower.set(xlabel="latency (ms)", ylabel="updates done (%)", ylim=(0, 101), xlim=(0, None))
        for share in (50, 99):
            value = float(np.percentile(latency, share))
            lower.axvline(value, color="0.6", linewidth=0.9)
            lower.text(value, 5, f" {share} %: {value:.1f} ms", color="0.35")
    return figure


def _draw_newest(axes: Any, run: Replay) -> None:
    length = run.robot.length
    std = np.array([s.std_position for s in run.states])
    for order, share in enumerate((0.5, 1.0)):
        at = int(np.argmin(np.abs(run.robot.arclength_nodes - share * length)))
        label = f"one σ at {1e3 * run.robot.arclength_nodes[at]:.0f} mm"
        axes.plot(run.time, 1e3 * std[:, at], color=_SENSORS[order], label=label)
    for order, errors in enumerate(run.newest):
        look = {"color": _SENSORS[(3, 4, 6, 7)[order % 4]], "markersize": 3, "alpha": 0.6}
        axes.plot(errors.time, 1e3 * errors.position, ".", **look, label=errors.name)
    axes.set(xlabel="time (s)", ylabel="position error (mm)", ylim=(0, None))
    axes.legend(ncols=4, fontsize="small", loc="upper left")
