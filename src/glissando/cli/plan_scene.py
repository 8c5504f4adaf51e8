"""`glissando plan --scene`: joint planning of robot and sensors among obstacles."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence

import numpy as np

from glissando.cli.outputs import stated
from glissando.cli.progress import working
from glissando.cli.say import say
from glissando.io.atomic import renewed_folder, write_table, write_text
from glissando.io.provenance import write_report
from glissando.io.robot_file import load_robot
from glissando.planning.scene.plan_motion import (
    MotionPlan,
    correction_speed,
    motion_problem,
    plan_motion,
)
from glissando.planning.scene.scene_checks import idle_obstacles
from glissando.planning.scene.scene_file import read_scene
from glissando.visualization.canvas import save_figure
from glissando.visualization.page import page
from glissando.visualization.scene_figure import save_scene_film, scene_figure, scene_page

_WRITTEN = (
    "tendons.csv",
    "slides.csv",
    "plan.json",
    "plan.png",
    "plan.pdf",
    "plan.svg",
    "plan.gif",
    "view.html",
)


def plan_scene(options: argparse.Namespace) -> int:
    """Plan the motion of --scene, print its risk and accuracy, and write it to --out; returns 0."""
    robot = load_robot(options.robot)
    scene = read_scene(options.scene, robot)
    problem = motion_problem(scene, robot)
    for sentence in idle_obstacles(scene, robot):
        say(f"glissando: warning: {sentence}")
    with working("planning") as work:
        plan = plan_motion(problem, seed=options.seed, progress=work.update)
    report = _report(plan)
    if options.out:
        with working("drawing"):
            _write(options, plan, report, robot.tendons.names if robot.tendons else ())
    print(json.dumps(report) if options.json else _sentence(report))
    if plan.warning and not options.json:
        print(plan.warning)
    if options.out and not options.json:
        print(f"Wrote {options.out / 'tendons.csv'}; open {options.out / 'view.html'}.")
    return 0


def columns_of_slides(names: Sequence[str]) -> list[str]:
    """Names of the columns of slides.csv: streams' names, numbered if several are the same.

    >>> columns_of_slides(["coil", "probe", "coil"])
    ['coil_1', 'probe', 'coil_2']
    """
    return [
        f"{name}_{names[: k + 1].count(name)}" if names.count(name) > 1 else name
        for k, name in enumerate(names)
    ]


def _report(plan: MotionPlan) -> dict[str, object]:
    at = plan.evaluation
    clearances = at.clearances.mean  # expected distances of the body to obstacles
    tip = np.sqrt(np.einsum("kii->k", at.cov[:, -1]))
    return {
        "risk": plan.risk,
        "risk_std": plan.risk_std,
        "bound": at.hits.value,
        "delta": plan.problem.scene.delta,
        "miss": plan.miss,
        "tip_std": float(tip[-1]),
        "clearance": float(clearances.min()) + plan.problem.wider if clearances.size else None,
        "cost": at.cost,
        "terms": at.terms,
        "correction_speed": correction_speed(plan.problem, at),
        "units": "m, s, m/s; risks are probabilities",
        "warning": plan.warning,
    }


def _sentence(report: dict[str, object]) -> str:
    mm = {key: 1e3 * float(str(report[key])) for key in ("miss", "tip_std")}
    risk, delta = (100.0 * float(str(report[key])) for key in ("risk", "delta"))
    reached = (
        f"The tip comes within {mm['miss']:.3g} mm of its targets, and the robot is off "
        f"by ± {mm['tip_std']:.3g} mm in the end. "
    )
    if report["clearance"] is None:
        return f"{reached}There is no obstacle."
    return (
        f"{reached}Anything is hit with a probability of {_percent(risk)} %, and {delta:g} % are "
        f"allowed; the nearest obstacle is expected {1e3 * float(str(report['clearance'])):.3g} mm "
        f"away."
    )


def _percent(percent: float) -> str:
    """A sampled risk in per cent, as text: no hit in 4,000 samples does not mean zero."""
    return f"{percent:.2g}" if percent > 0.0 else "less than 0.1"


def _write(
    options: argparse.Namespace, plan: MotionPlan, report: dict[str, object], names: tuple[str, ...]
) -> None:
    time, values = plan.commands()
    count = len(plan.problem.scene.tendons)
    with renewed_folder(options.out, _WRITTEN) as building:
        tendons = np.column_stack([time, values[:, :count]])
        write_table(building / "tendons.csv", ("time", *names), tendons)
        if plan.problem.scene.slides:
            slides = np.column_stack([time, values[:, count:]])
            heads = columns_of_slides([sensor.name for sensor in plan.problem.scene.sensors])
            write_table(building / "slides.csv", ("time", *heads), slides)
        write_report(building / "plan.json", report | stated(options))
        save_figure(scene_figure(plan), building / f"plan.{options.figure}")
        if options.animate:
            save_scene_film(plan, building / "plan.gif")
        title, subtitle = f"Plan of {options.scene.name}", _sentence(report)
        write_text(building / "view.html", page(scene_page(plan), title, subtitle))
