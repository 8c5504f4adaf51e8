"""The studies: which scenes are compared, over how many seeds, and the numbers that come of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from glissando.experiments.scenes import Scene, bench, path
from glissando.experiments.trials import Progress, run_trials, summary

_CYCLES = 16.44  # s that three cycles of 60 mm at 24 mm/s take with the stage's acceleration
_LENGTH = bench().rod.length

Arms = dict[str, Scene]
Plan = list[tuple[Scene, int]]


def table_arms(shape: str) -> Arms:
    """The paper's comparison for one shape, and beyond it: the whole length, slowly and fast.

    In the 'still' arm the estimator knows that the robot holds still.
    """
    fixed = Scene(shape, "hold", _CYCLES)
    slow = replace(fixed, slide="traverse", speed=0.1, stroke=_LENGTH, cycles=1)
    return {
        "fixed": fixed,
        "oscillating": replace(fixed, slide="oscillate"),
        "traverse": slow,
        "still traverse": replace(slow, still=True),
        "traverse fast": replace(slow, speed=0.4, cycles=4),
    }


def moving_arms(duration: float) -> Arms:
    """A robot that moves C → S in `duration` seconds while the coil slides at several speeds."""
    fixed = Scene("C-to-S", "hold", duration)
    arms = {"fixed": fixed}
    for speed in (0.006, 0.012, 0.024):
        cycles = max(1, int(duration / (0.12 / speed + 0.5)))
        name = f"60 mm at {1e3 * speed:g} mm/s"
        arms[name] = replace(fixed, slide="oscillate", speed=speed, cycles=cycles)
    for speed in (0.1, 0.2, 0.4, 0.8):
        cycles = int(duration / (2.0 * _LENGTH / speed + 0.5))  # half a second to turn, twice
        if cycles == 0:
            continue
        arms[f"whole length at {1e3 * speed:g} mm/s"] = replace(
            fixed, slide="traverse", speed=speed, stroke=_LENGTH, cycles=cycles
        )
    return arms


_JITTER, _BIAS = ("jitter", "jitter_angle"), ("bias", "bias_angle")
_REGISTRATION = ("registration", "registration_angle")
CAUSES: dict[str, tuple[tuple[str, float], ...]] = {
    "as it is": (),
    "white noise × 10": tuple((name, 10.0) for name in _JITTER),
    "bias × 3": tuple((name, 3.0) for name in _BIAS),
    "registration error × 6": tuple((name, 6.0) for name in _REGISTRATION),
    "set on a third of the length": (("set_length", 1.0 / 3.0),),
    "tubes without set": (("set_curvature", 0.0),),
}
"""What is varied to see where the size of the effect comes from."""
_FIXED = "fixed "


class Studies:
    """Every scene of a run with its number of seeds; small for a quick run."""

    def __init__(self, *, quick: bool) -> None:
        self.seeds = {
            "table": 8 if quick else 100,
            "beyond": 4 if quick else 12,
            "moving": 2 if quick else 4,
            "causes": 2 if quick else 5,
        }
        shapes = ("C", "S")
        self.table = {shape: table_arms(shape) for shape in shapes}
        durations = (10.0,) if quick else (10.0, 20.0)
        self.moving = {f"{seconds:g} s": moving_arms(seconds) for seconds in durations}
        chosen = list(CAUSES)[::5] if quick else list(CAUSES)
        self.causes = {label: _cause_arms(CAUSES[label], shapes) for label in chosen}
        if quick:
            for arms in self.table.values():
                for name in list(arms):
                    if name not in ("fixed", "oscillating", "traverse fast"):
                        del arms[name]
            for arms in self.moving.values():
                for name in list(arms)[1:-1]:
                    if name != "60 mm at 24 mm/s":
                        del arms[name]

    def plan(self) -> Plan:
        """Scenes and their numbers of seeds."""
        seeds, plan = self.seeds, Plan()
        for arms in self.table.values():
            for name, scene in arms.items():
                main = name in ("fixed", "oscillating")
                plan.append((scene, seeds["table"] if main else seeds["beyond"]))
        for section in ("moving", "causes"):
            for arms in getattr(self, section).values():
                plan += [(scene, seeds[section]) for scene in arms.values()]
        return plan

    def run(self, progress: Progress | None = None) -> dict[str, Any]:
        """All trials, summarised: sections table, moving and causes of the results.

        Section speed compares the fastest slide of a moving robot with the slowest.
        """
        found = run_trials(self.plan(), progress)
        table = {
            shape: {
                name: summary(found[scene], found[arms["fixed"]]) for name, scene in arms.items()
            }
            for shape, arms in self.table.items()
        }
        moving = {
            label: {
                name: {
                    **summary(found[scene], found[arms["fixed"]]),
                    "slide_speed": _mean_speed(scene),
                    "stroke": 0.0 if scene.slide == "hold" else scene.stroke,
                }
                for name, scene in arms.items()
            }
            for label, arms in self.moving.items()
        }
        count = self.seeds["causes"]
        causes = {
            label: {
                shape: summary(found[arms[shape]][:count], found[arms[_FIXED + shape]][:count])
                for shape in ("C", "S")
            }
            for label, arms in self.causes.items()
        }
        speed = {
            label: summary(*(found[arms[list(arms)[k]]] for k in (-1, 1)))
            for label, arms in self.moving.items()
        }
        return {"table": table, "moving": moving, "speed": speed, "causes": causes}


def _cause_arms(scaled: tuple[tuple[str, float], ...], shapes: tuple[str, ...]) -> Arms:
    arms = {}
    for shape in shapes:
        fixed = replace(table_arms(shape)["fixed"], flaws=scaled)
        arms[_FIXED + shape] = fixed
        arms[shape] = replace(fixed, slide="oscillate")
    return arms


def _mean_speed(scene: Scene) -> float:
    """Mean of the slide's |speed| over a scene, m/s."""
    if scene.slide == "hold":
        return 0.0
    return float(np.mean(np.abs(path(scene).speed_at(np.linspace(0.0, scene.duration, 2001)))))
