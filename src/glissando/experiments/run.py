"""Computation of all claims of the paper, with verdicts, a page and figures in a folder."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from glissando import __version__
from glissando.experiments.claims import Claim, Verdict, judge
from glissando.experiments.confidence import confidence_at_coil, confidence_follows
from glissando.experiments.figures_bodies import coil_figure, following_figure
from glissando.experiments.figures_numbers import causes_figure, moving_figure, table_figure
from glissando.experiments.page import page
from glissando.experiments.runner import ignoring_interrupts
from glissando.experiments.scenes import PAPER_RATE, ROBOT, Scene, Trial, trial
from glissando.experiments.studies import Studies
from glissando.io.atomic import write_text
from glissando.visualization.canvas import save_figure
from glissando.visualization.film import save_animation

Progress = Callable[[str, int, int], None]
"""Called with the name of the present step, the amount done and the total amount of it."""


def reproduce(
    claims: Sequence[Claim], folder: Path, *, quick: bool, progress: Progress
) -> tuple[list[Verdict], list[Path]]:
    """Compute and judge the claims; write results.json, a page, figures and an animation.

    The numbers are the same on any number of cores.

    Args:
        claims: Claims to judge.
        folder: Folder to write into; created if it is missing.
        quick: Whether to run few seeds and scenes.
        progress: Called during the run.

    Returns:
        Verdicts, and paths of the files written.

    Raises:
        ClaimsError: A claim needs a number that is not computed.
        GlissandoError: A trial failed, or Dask or matplotlib is not installed.
    """
    began = time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    film = get_context("spawn").Process(target=_animate, args=(folder, quick), daemon=True)
    with ignoring_interrupts():
        film.start()  # in parallel with the trials, as one core draws its frames
    progress("confidence along the body", 0, 2)
    confidence, trials = confidence_at_coil(quick)
    progress("confidence along the body", 1, 2)
    following, sliding, scene = confidence_follows()
    studies = Studies(quick=quick)
    numbers = studies.run(lambda done, whole: progress("trials", done, whole))
    results = {"confidence": confidence, "following": following, **numbers}
    file, text = folder / "results.json", folder / "reproduction.md"
    verdicts: list[Verdict] = []
    try:
        verdicts = judge([c for c in claims if not (quick and c.full)], results)
    finally:  # a mistake in the claims does not cost the numbers
        record = _record(results, verdicts, studies, quick=quick)
        record["seconds"] = round(time.monotonic() - began, 1)
        write_text(file, json.dumps(record, indent=1) + "\n")
    write_text(text, page(record))
    progress("figures", 0, 1)
    written = [file, text, *save_experiment_figures(results, trials, sliding, scene, folder)]
    progress("animation", 0, 1)
    film.join()
    # if the process failed, draw again here, where the exception is raised
    written.append(folder / _FILM if film.exitcode == 0 else _animate(folder, quick))
    progress("animation", 1, 1)
    return verdicts, written


def _record(
    results: dict[str, Any], verdicts: Sequence[Verdict], studies: Studies, *, quick: bool
) -> dict[str, Any]:
    versions = {name: version(name) for name in ("numpy", "scipy", "matplotlib")}
    claims = []
    for verdict in verdicts:
        claim = {key: value for key, value in asdict(verdict.claim).items() if key in _QUOTED}
        entry = {key: getattr(verdict, key) for key in ("ours", "value", "verdict", "size")}
        claims.append(claim | entry)
    return {
        "robot": ROBOT,
        "quick": quick,
        "versions": {"glissando": __version__, "python": platform.python_version(), **versions},
        "seeds": {"first": 0, **studies.seeds},
        "claims": claims,
        "results": results,
    }


_FILM = "sliding.gif"
_QUOTED = ("id", "says", "paper")


def save_experiment_figures(
    results: Mapping[str, Any],
    trials: Mapping[str, Trial],
    sliding: Trial,
    scene: Scene,
    folder: Path,
) -> list[Path]:
    """Write a PNG for each section of the results that has a figure and is not empty.

    Args:
        results: Sections 'confidence', 'following', 'table', 'moving' and 'causes'.
        trials: Trials of `confidence_at_coil`.
        sliding: Trial of `confidence_follows`.
        scene: Scene of that trial.
        folder: Folder to write into; created if it is missing.

    Returns:
        Paths of the files written.
    """
    draw: dict[str, Callable[[Any], Any]] = {
        "confidence": lambda section: coil_figure(trials, section),
        "following": lambda section: following_figure(sliding, scene, section),
        "table": table_figure,
        "moving": moving_figure,
        "causes": causes_figure,
    }
    paths = []
    for name, figure in draw.items():
        if results.get(name):
            paths.append(save_figure(figure(results[name]), folder / f"{name}.png"))
    return paths


def _animate(folder: Path, quick: bool) -> Path:
    """Write a film of a robot that moves C → S while its coil slides the whole length."""
    scene = Scene("C-to-S", "traverse", 12.0, 0.4, stroke=0.7, cycles=3, time_rate=PAPER_RATE)
    result = trial(scene, seed=0)
    return save_animation(
        result.posterior,
        result.readings,
        result.truth,
        folder / _FILM,
        seconds=2.0 if quick else None,
    )
