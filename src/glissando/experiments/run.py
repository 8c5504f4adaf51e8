"""Everything the paper claims, computed, judged and drawn into a folder."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from glissando import __version__
from glissando.experiments.claims import Claim, Verdict, judge
from glissando.experiments.confidence import figure_a, figure_b
from glissando.experiments.figures import save_experiment_figures
from glissando.experiments.page import page
from glissando.experiments.scenes import ROBOT, Scene, trial
from glissando.experiments.studies import Studies

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and how much there is."""


def reproduce(
    claims: Sequence[Claim], folder: Path, *, quick: bool, progress: Progress
) -> tuple[list[Verdict], list[Path]]:
    """Compute and judge the claims; write results.json, a page, figures and an animation.

    The same numbers on any number of cores. Raises ClaimsError for a claim whose number nothing
    computes.
    """
    began = time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    progress("confidence along the body", 0, 2)
    confidence, trials = figure_a(quick)
    progress("confidence along the body", 1, 2)
    following, sliding, scene = figure_b(quick)
    studies = Studies(quick=quick)
    numbers = studies.run(lambda done, whole: progress("trials", done, whole))
    results = {"confidence": confidence, "following": following, **numbers}
    file = folder / "results.json"
    verdicts: list[Verdict] = []
    try:
        verdicts = judge(claims, results)
    finally:  # a mistake in the claims does not cost the numbers
        record = _record(results, verdicts, studies, quick=quick)
        record["seconds"] = round(time.monotonic() - began, 1)
        file.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    text = folder / "reproduction.md"
    text.write_text(page(record), encoding="utf-8")
    progress("figures", 0, 1)
    written = [file, text, *save_experiment_figures(results, trials, sliding, scene, folder)]
    written.append(_animate(folder, quick, progress))
    return verdicts, written


def _record(
    results: dict[str, Any], verdicts: Sequence[Verdict], studies: Studies, *, quick: bool
) -> dict[str, Any]:
    packages = ("numpy", "scipy", "matplotlib")
    return {
        "robot": ROBOT,
        "quick": quick,
        "versions": {
            "glissando": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in packages},
        },
        "seeds": {"first": 0, **studies.seeds},
        "claims": [
            {
                "id": v.claim.id,
                "says": v.claim.says,
                "paper": v.claim.paper,
                "ours": v.ours,
                "value": v.value,
                "verdict": v.verdict,
            }
            for v in verdicts
        ],
        "results": results,
    }


def _animate(folder: Path, quick: bool, progress: Progress) -> Path:
    """The robot moves C → S while the coil slides its whole length, with its confidence tube."""
    from glissando.visualization.film import save_animation

    scene = Scene("C-to-S", "traverse", 12.0, speed=0.4, stroke=0.7, cycles=3)
    found = trial(scene, seed=0)
    return save_animation(
        found.posterior,
        found.readings,
        found.truth,
        folder / "sliding.gif",
        seconds=2.0 if quick else None,
        progress=lambda done, whole: progress("animation", done, whole),
    )
