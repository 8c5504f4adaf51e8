"""The figure of a study: error and coverage against each axis."""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando.visualization.canvas import panels_on, shown_name

_UNITS = {"at": "m", "stroke": "m", "speed": "m/s", "duration": "s", "time_rate": "1/s"}
_COLOUR = "#0072B2"


def study_figure(summary: dict[str, Any]) -> Any:
    """Draw position RMSE, mm, and the share inside the 95 % ellipsoid, over each axis of a study.

    Args:
        summary: Result of `summarise`, whose 95 % intervals are drawn as bars.

    Returns:
        Axes (2, C) of matplotlib: RMSE above, share below, a column for each axis of the study.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    axes: dict[str, Any] = summary["axes"]
    size = 1.2 + 3.2 * len(axes), 5.6
    with panels_on(None, (2, len(axes)), size, sharex="col", sharey="row") as panels:
        panels[0, 0].figure.suptitle(
            shown_name(summary["name"]), x=0.02, ha="left", fontweight="bold"
        )
        for column, (name, points) in enumerate(axes.items()):
            upper, lower = panels[:, column]
            succeeded = [p for p in points if "position_rmse" in p]
            place = _places(upper, [p["value"] for p in points])
            at = [x for x, p in zip(place, points, strict=True) if "position_rmse" in p]
            _draw(upper, at, [p["position_rmse"] for p in succeeded], 1e3)
            _draw(lower, at, [p["coverage95_position"] for p in succeeded], 1e2)
            lower.axhline(95.0, color="0.5", linewidth=0.9, linestyle="--")
            lower.set_xlabel(f"{name} ({_UNITS[name]})" if name in _UNITS else name)
        panels[0, 0].set(ylabel="position RMSE (mm)", ylim=(0.0, None))
        panels[1, 0].set(ylabel="inside 95 % (%)", ylim=(0.0, 101.0))
    return panels


def _places(axes: Any, values: list[Any]) -> list[float]:
    """Abscissas of values: numbers as they are, others side by side with ticks of their names."""
    if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values):
        return [float(v) for v in values]
    axes.set_xticks(range(len(values)), [shown_name(str(v)) for v in values])
    axes.set_xlim(-0.5, len(values) - 0.5)
    return [float(i) for i in range(len(values))]


def _draw(axes: Any, place: list[float], entries: list[dict[str, Any]], scale: float) -> None:
    table = [[e[k] for k in ("value", "low", "high")] for e in entries]
    value, low, high = scale * np.reshape(np.array(table, dtype=float), (-1, 3)).T  # None is NaN
    # a resampled interval need not hold the value itself
    bars = np.maximum([value - low, high - value], 0.0)
    axes.errorbar(place, value, bars, color=_COLOUR, marker="o", capsize=4, linewidth=1.5)
    axes.grid(axis="y")
