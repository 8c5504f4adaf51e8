"""How an online run went: errors of its newest states, their confidence, and its latency."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.evaluation.replay import Replay
from glissando.visualization.figures import _SENSORS, _canvas

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def replay_figure(found: Replay) -> Figure:
    """Errors of the newest states and their confidence over time, and latencies by frequency.

    Raises GlissandoError without matplotlib.
    """
    with _canvas(9.0, 5.6) as figure:
        upper, lower = figure.subplots(2, 1)
        _draw_confidence(upper, found)
        latency = 1e3 * np.sort(found.latency)
        lower.plot(latency, 100.0 * (np.arange(latency.size) + 1) / latency.size, color="black")
        lower.set(xlabel="latency (ms)", ylabel="updates done (%)", ylim=(0, 101), xlim=(0, None))
        for share in (50, 99):
            value = float(np.percentile(latency, share))
            lower.axvline(value, color="0.6", linewidth=0.9)
            lower.text(value, 5, f" {share} %: {value:.1f} ms", color="0.35")
    return figure


def _draw_confidence(axes: Any, found: Replay) -> None:
    length = found.robot.length
    std = np.array([s.std_position for s in found.states])
    for order, share in enumerate((0.5, 1.0)):
        at = int(np.argmin(np.abs(found.robot.arclength_nodes - share * length)))
        label = f"one σ at {1e3 * found.robot.arclength_nodes[at]:.0f} mm"
        axes.plot(found.time, 1e3 * std[:, at], color=_SENSORS[order], label=label)
    for order, errors in enumerate(found.newest):
        axes.plot(
            errors.time, 1e3 * errors.position, ".", markersize=3, alpha=0.6,
            color=_SENSORS[(3, 4, 6, 7)[order % 4]], label=errors.name,
        )  # fmt: skip
    axes.set(xlabel="time (s)", ylabel="position error (mm)", ylim=(0, None))
    axes.legend(ncols=4, fontsize="small", loc="upper left")
