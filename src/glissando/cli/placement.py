"""`glissando design --sensor`: selection and placement of sensors within a budget."""

from __future__ import annotations

import argparse
import json

import numpy as np
from rich.table import Table

from glissando.cli.console import Console, number_table
from glissando.cli.outputs import stated
from glissando.cli.plan_task import stage_of
from glissando.cli.progress import working
from glissando.cli.say import say
from glissando.cli.unused_options import refuse_unused
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.io.atomic import renewed_folder
from glissando.io.provenance import write_report
from glissando.io.robot_file import load_robot
from glissando.model.robot import Robot
from glissando.planning.candidates import SLIDE, Candidate, candidates_of
from glissando.planning.placement import Placement, place_sensors, placement_problem
from glissando.planning.zones import read_zone
from glissando.visualization.canvas import save_figure
from glissando.visualization.planning_figures import placement_figure

_LEVELS = 6  # number of budgets up to the largest
_PLACES = 1000  # most candidate arclengths along the body
_SENSORS = 6.0  # default budget, in units of the cheapest sensor


def place(options: argparse.Namespace) -> int:
    """Choose sensors for each budget, print them, and write them to --out; returns 0."""
    if options.objective != "trace":
        raise GlissandoError(f"Sensors are placed by trace, not by {options.objective}.")
    if all(text.partition("=")[0] != SLIDE for text in options.sensor):
        refuse_unused(options, f"sensors without one of {SLIDE}=COST", "limits")
    robot = load_robot(options.robot)
    candidates = [each for text in options.sensor for each in _candidates(robot, text, options)]
    least = min(each.cost for each in candidates)
    most = options.budget if options.budget is not None else _SENSORS * least
    levels = np.linspace(min(least, most), most, _LEVELS) if np.isfinite(most) else [most]
    budgets = np.unique(levels).tolist()
    with working("choosing sensors"):
        zones = [read_zone(text) for text in options.zone]
        problem = placement_problem(robot, candidates, zones, horizon=options.horizon)
        placements = list(place_sensors(problem, budgets))
    if problem.horizon < options.horizon:
        say(
            f"glissando: sensors read for {problem.horizon:g} s, not {options.horizon:g} s: as "
            f"many time nodes of this robot as fit a thousand numbers"
        )
    if unknown := [p.name for p in robot.sensor_parameters if not p.known]:
        say(
            f"glissando: of a sensor nothing counts as unknown but its noise: {', '.join(unknown)} "
            f"of the robot left out, so positions are known less well than is said"
        )
    report = {
        "zones": options.zone,
        "horizon": problem.horizon,
        "placements": [_row(each) for each in placements],
    }
    if options.out:
        with renewed_folder(options.out, ("design.json", "design.png")) as building:
            write_report(building / "design.json", report | stated(options))
            save_figure(placement_figure(placements, robot.length), building / "design.png")
    if options.json:
        print(json.dumps(report))
    else:
        Console().print(_table(placements))
    return 0


def _candidates(robot: Robot, text: str, options: argparse.Namespace) -> list[Candidate]:
    """Candidate sensors of a text KIND=COST[:STD] of --sensor."""
    kind, _, numbers = text.partition("=")
    cost, _, noise = numbers.partition(":")
    try:
        price = float(cost)
        std: Array | None = np.array([float(n) for n in noise.split(",")]) if noise else None
    except ValueError:
        raise GlissandoError(
            f"--sensor {text!r} is not understood; give KIND=COST or KIND=COST:STD, as coil=1."
        ) from None
    if not 1 <= options.places <= _PLACES:
        raise GlissandoError(f"--places {options.places}: give 1 to {_PLACES}.")
    slide = None
    if kind == SLIDE:
        stage, upper = stage_of(options)
        slide = upper - stage.stroke, upper, stage.speed
    return candidates_of(robot, kind, price, std=std, count=options.places, slide=slide)


def _row(placement: Placement) -> dict[str, object]:
    names = [each.name for each in placement.chosen]
    costs = {"budget": placement.budget, "cost": placement.cost}
    return {**costs, "sensors": names, "std": placement.std, "bound": placement.bound}


def _table(placements: list[Placement]) -> Table:
    headings = "budget", "cost", "σ (mm)", "no set below (mm)"
    table = number_table("position σ in the zones", headings)
    table.add_column("sensors")
    for each in placements:
        mm = (f"{1e3 * value:.2f}" for value in (each.std, each.bound))
        names = ", ".join(sensor.name for sensor in each.chosen)
        table.add_row(f"{each.budget:g}", f"{each.cost:g}", *mm, names)
    return table
