"""One cell of a study: simulate, estimate, check; its numbers, or the sentence of its error."""

from __future__ import annotations

import warnings

from glissando import __version__
from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError, NotConvergedWarning
from glissando.evaluation.metrics import pool
from glissando.experiments.scenes import Scene, trial
from glissando.simulation import NoShapeError

Row = dict[str, str | float | int | bool | None]
"""What a cell leaves: every name of METRICS, and `error`; those that it lacks are None."""

METRICS = {
    "position_rmse": "over all truth sites and times, m",
    "rotation_rmse": "the same, rad",
    "nees_position": "squared error in units of its covariance, 1 a degree of freedom if true",
    "nees_rotation": "the same of rotation",
    "coverage95_position": "share of errors inside their 95 % ellipsoid",
    "converged": "1, or 0 for an estimate that stopped early",
    "iterations": "of the estimate",
}
"""Numbers of a row, and what they are."""


def outcome(scene: Scene, seed: int) -> Row:
    """What comes of a scene with a seed; never raises but for an interrupt."""
    try:
        with one_thread(), warnings.catch_warnings():
            warnings.simplefilter("ignore", NotConvergedWarning)  # told by a column
            return measured(scene, seed)
    except (GlissandoError, NoShapeError) as problem:
        return failure(str(problem))
    except Exception as problem:  # a study outlives whatever one of its cells does
        return failure(f"{type(problem).__name__}: {problem}")


def measured(scene: Scene, seed: int) -> Row:
    """The metrics of one trial. Raises what the trial raises."""
    found = trial(scene, seed)
    told = pool(found.errors).summary()
    solve = found.posterior.solve
    row: Row = {name: told[name] for name in METRICS if name in told}
    row |= {"converged": float(solve.converged), "iterations": float(solve.iterations)}
    return {**row, "error": None}


def failure(sentence: str) -> Row:
    """The row of a cell that has no numbers."""
    return {**dict.fromkeys(METRICS), "error": sentence or "it failed without a word"}


def version() -> str:
    """The version of glissando where this runs."""
    return __version__
