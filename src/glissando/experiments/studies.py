"""Comparisons of the paper: their scenes, numbers of seeds, and results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.experiments.passes import driven_robot, passes_arms
from glissando.experiments.runner import cluster, run_trials
from glissando.experiments.scenes import PAPER_RATE, Scene, bench, path
from glissando.experiments.statistics import COLUMNS, summary
from glissando.geometry.se3 import Array

Progress = Callable[[int, int], None]
"""Called with the number of trials done and the total number."""

Arms = dict[str, Scene]
"""Scenes to compare, by name; the first is the fixed sensor."""

CAUSES: dict[str, dict[str, Any]] = {
    "as it is": {},
    "white noise × 10": {"flaws": (("jitter", 10.0), ("jitter_angle", 10.0))},
    "bias × 3": {"flaws": (("bias", 3.0), ("bias_angle", 3.0))},
    "registration error × 6": {"flaws": (("registration", 6.0), ("registration_angle", 6.0))},
    "set on a third of the length": {"flaws": (("set_length", 1.0 / 3.0),)},
    "tubes without set": {"flaws": (("set_curvature", 0.0),)},
    "judged at the frames of the base half": {"judged": 0.5 * bench().rod.length},
    "roll dropped as a small angle": {"published": ("roll",)},
    "published noise of the sensor": {"published": ("noise",)},
    "published prior and settings": {"published": ("prior",)},
}
"""Changes to a scene, one cause at a time: imperfections, truth that is compared, estimator."""

_QUICK_CAUSES = ("as it is", "tubes without set")

SEEDS = {"table": 100, "beyond": 12, "moving": 4, "causes": 5, "passes": 30}
QUICK_SEEDS = {"table": 8, "beyond": 8, "moving": 2, "causes": 2, "passes": 0}
"""Number of seeds of the table, its arms beyond the paper's, the moving robot, the causes, and the
robot with inertia, which a quick run leaves out."""

_CYCLES = 16.44  # s that three cycles of 60 mm at 24 mm/s take with the stage's acceleration
_LENGTH = bench().rod.length
_SHAPES = ("C", "S")
_FIXED = "fixed "
_QUICK_TABLE = ("fixed", "oscillating", "traverse fast")
_QUICK_MOVING = "60 mm at 24 mm/s"


def table_arms(shape: str) -> Arms:
    """Scenes of a fixed sensor, the paper's oscillation, and slides over the whole length.

    The prior of the 'still' arm is that of a robot that holds still.
    """
    fixed = Scene(shape, "hold", _CYCLES, time_rate=PAPER_RATE)
    slow = replace(fixed, slide="traverse", speed=0.1, stroke=_LENGTH, cycles=1)
    return {
        "fixed": fixed,
        "oscillating": replace(fixed, slide="oscillate"),
        "traverse": slow,
        "still traverse": replace(slow, still=True),
        "traverse fast": replace(slow, speed=0.4, cycles=4),
    }


def _moving_arms(duration: float) -> Arms:
    """Scenes of a robot that moves C → S in `duration` s, with the coil at several speeds."""
    fixed = Scene("C-to-S", "hold", duration, time_rate=PAPER_RATE)
    arms = {"fixed": fixed}
    for speed in (0.006, 0.012, 0.024):
        cycles = max(1, int(duration / (0.12 / speed + 0.5)))
        name = f"60 mm at {1e3 * speed:g} mm/s"
        arms[name] = replace(fixed, slide="oscillate", speed=speed, cycles=cycles)
    for speed in (0.1, 0.2, 0.4, 0.8):
        cycles = int(duration / (2.0 * _LENGTH / speed + 0.5))  # half a second to turn, twice
        if cycles:
            name = f"whole length at {1e3 * speed:g} mm/s"
            arms[name] = replace(
                fixed, slide="traverse", speed=speed, stroke=_LENGTH, cycles=cycles
            )
    return arms


def _cause_arms(changes: dict[str, Any]) -> Arms:
    arms: Arms = {}
    for shape in _SHAPES:
        fixed = replace(table_arms(shape)["fixed"], **changes)
        arms |= {_FIXED + shape: fixed, shape: replace(fixed, slide="oscillate")}
    return arms


class Studies:
    """Scenes of a run with their numbers of seeds; fewer of both for a quick run."""

    def __init__(self, *, quick: bool) -> None:
        self.seeds = QUICK_SEEDS if quick else SEEDS
        table = {shape: table_arms(shape) for shape in _SHAPES}
        moving = {f"{s:g} s": _moving_arms(s) for s in ((10.0,) if quick else (10.0, 20.0))}
        causes = _QUICK_CAUSES if quick else CAUSES
        if quick:
            table = {shape: {n: arms[n] for n in _QUICK_TABLE} for shape, arms in table.items()}
            for label, arms in moving.items():
                first, *_, last = arms
                moving[label] = {name: arms[name] for name in (first, _QUICK_MOVING, last)}
        self._arms = {
            "table": table,
            "moving": moving,
            "causes": {label: _cause_arms(CAUSES[label]) for label in causes},
            "passes": {},
        }
        if not quick:
            self._folder = TemporaryDirectory()  # holds the robot's file while this object exists
            self._arms["passes"] = {"": passes_arms(driven_robot(Path(self._folder.name)))}

    def run(self, progress: Progress | None = None) -> dict[str, Any]:
        """Run all trials on the cores of this machine and summarise them.

        Returns:
            Summaries in the sections table, moving, speed (fastest slide against the slowest, of a
            moving robot), causes, and passes (a robot with inertia; empty in a quick run).
        """
        plan = []
        for section, groups in self._arms.items():
            for arms in groups.values():
                for name, scene in arms.items():
                    beyond = section == "table" and name not in ("fixed", "oscillating")
                    plan.append((scene, self.seeds["beyond" if beyond else section]))
        errors = run_plan(plan, progress)
        table, moving = (
            {label: _against_fixed(errors, arms) for label, arms in self._arms[section].items()}
            for section in ("table", "moving")
        )
        speed = {}
        for label, arms in self._arms["moving"].items():
            speed[label] = summary(*(errors[list(arms.values())[k]] for k in (-1, 1)))
            for name, scene in arms.items():
                moving[label][name]["slide_speed"] = _mean_speed(scene)
                moving[label][name]["stroke"] = 0.0 if scene.slide == "hold" else scene.stroke
        few = slice(self.seeds["causes"])
        causes = {
            label: {
                s: _against(errors[arms[s]][few], errors[arms[_FIXED + s]][few]) for s in _SHAPES
            }
            for label, arms in self._arms["causes"].items()
        }
        passes: dict[str, Any] = {}
        for arms in self._arms["passes"].values():
            passes = _against_fixed(errors, arms)
        out = {"table": table, "moving": moving, "speed": speed, "causes": causes}
        return {**out, "passes": passes}


def run_plan(
    plan: Sequence[tuple[Scene, int]], progress: Progress | None = None
) -> dict[Scene, Array]:
    """Run scenes over seeds on all cores; results do not depend on the number of cores.

    Args:
        plan: Scenes, each with its number of seeds, which count from 0.
        progress: Called after every trial.

    Returns:
        Rows of COLUMNS (S, 5), one for each seed, by scene.

    Raises:
        GlissandoError: A trial failed, or Dask is not installed.
    """
    seeds = dict[Scene, int]()
    for scene, count in plan:
        seeds[scene] = max(count, seeds.get(scene, 0))
    # seed by seed: scenes of a seed share motions, and the last trials are short
    rounds = range(max(seeds.values(), default=0))
    trials = [(scene, seed) for seed in rounds for scene, count in seeds.items() if seed < count]
    out = {scene: np.empty((count, len(COLUMNS))) for scene, count in seeds.items()}
    with cluster() as client:
        for done, (index, row) in enumerate(run_trials(client, trials), start=1):
            scene, seed = trials[index]
            if row["error"] is not None:
                raise GlissandoError(f"Seed {seed} of {scene} failed: {row['error']}")
            out[scene][seed] = [row[name] for name in COLUMNS]
            if progress is not None:
                progress(done, len(trials))
    return out


def _against_fixed(errors: dict[Scene, Array], arms: Arms) -> dict[str, dict[str, Any]]:
    return {name: summary(errors[scene], errors[arms["fixed"]]) for name, scene in arms.items()}


def _against(sliding: Array, fixed: Array) -> dict[str, Any]:
    """Summary of a sliding sensor against a fixed one, with the errors of the fixed one."""
    alone = summary(fixed)
    return summary(sliding, fixed) | {f"fixed_{w}": alone[w] for w in ("position", "rotation")}


def _mean_speed(scene: Scene) -> float:
    """Mean absolute speed of the slide over a scene, m/s."""
    if scene.slide == "hold":
        return 0.0
    return float(np.mean(np.abs(path(scene).speed_at(np.linspace(0.0, scene.duration, 2001)))))
