"""The five figures of the experiments, and the files they are written to."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from glissando.experiments.figures_bodies import figure_a, figure_b
from glissando.experiments.figures_numbers import figure_causes, figure_moving, figure_table
from glissando.experiments.scenes import Scene, Trial

__all__ = [
    "figure_a",
    "figure_b",
    "figure_causes",
    "figure_moving",
    "figure_table",
    "save_experiment_figures",
]


def save_experiment_figures(
    results: Mapping[str, Any],
    trials_a: Mapping[str, Trial],
    trial_b: Trial,
    scene_b: Scene,
    folder: Path,
) -> list[Path]:
    """Write a PNG a figure whose results are there; their paths. `folder` is made if missing.

    `results` has keys 'confidence', 'following', 'table', 'moving' and 'causes'. Raises
    GlissandoError without matplotlib.
    """
    folder.mkdir(parents=True, exist_ok=True)
    draw = {
        "confidence": lambda told: figure_a(trials_a, told),
        "following": lambda told: figure_b(trial_b, scene_b, told),
        "table": figure_table,
        "moving": figure_moving,
        "causes": figure_causes,
    }
    paths = []
    for name, figure in draw.items():
        if results.get(name):
            paths.append(folder / f"{name}.png")
            figure(results[name]).savefig(paths[-1], dpi=150)
    return paths
