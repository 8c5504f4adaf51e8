"""The calibration plot: how many errors lie inside an ellipsoid, against how many should."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from glissando.evaluation.consistency import Consistency
from glissando.visualization.figures import _SENSORS, _canvas

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def calibration_figure(found: Sequence[Consistency]) -> Figure:
    """Actual against nominal coverage in %, position and rotation, a line a site.

    The grey band holds a consistent estimate's line over all sites at each level with probability
    95 %. Below the diagonal an estimate is overconfident. Raises GlissandoError without matplotlib.
    """
    quantities = [q for q in ("position", "rotation") if any(c.quantity == q for c in found)]
    with _canvas(5.2 * len(quantities), 5.0) as figure:
        panels: Any = figure.subplots(1, len(quantities), squeeze=False)
        for axes, quantity in zip(panels[0], quantities, strict=True):
            _draw(axes, [c for c in found if c.quantity == quantity])
            axes.set_title(quantity, loc="left", fontweight="bold")
            axes.set(xlabel="nominal coverage (%)", xlim=(0, 100), ylim=(0, 101), aspect="equal")
        panels[0][0].set_ylabel("errors inside (%)")
        handles, labels = panels[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure


def _draw(axes: Any, found: Sequence[Consistency]) -> None:
    level = np.linspace(0.01, 0.99, 99)
    whole = found[-1]
    low, high = np.array([whole.coverage_bounds(p) for p in level]).T
    axes.fill_between(100 * level, 100 * low, 100 * high, color="0.88", label="honest, 95 %")
    axes.plot([0, 100], [0, 100], color="0.5", linewidth=0.9)
    for order, c in enumerate(found):
        inside = np.mean(c.nees[:, None] <= chi2.ppf(level, c.dof), axis=0)
        last = c is whole and len(found) > 1
        colour = "black" if last else _SENSORS[(0, 1, 3, 4, 6, 7)[order % 6]]
        width = 2.8 if last else 1.3
        axes.plot(100 * level, 100 * inside, color=colour, linewidth=width, label=c.site)
