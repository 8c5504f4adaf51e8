"""`glissando design`: uncertainty in zones over stroke, speed, rate and number of coils."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from glissando.cli.console import Console, number_table
from glissando.cli.outputs import require_results_folder, stated
from glissando.cli.placement import place
from glissando.cli.plan_task import (
    add_task,
    require_horizon,
    require_speed,
    stage_of,
    stream_of,
)
from glissando.cli.progress import working
from glissando.cli.shared import Commands, add_command
from glissando.cli.unused_options import refuse_unused
from glissando.errors import GlissandoError
from glissando.io.atomic import renewed_folder
from glissando.io.provenance import write_report
from glissando.io.robot_file import load_robot
from glissando.planning.design import Design, pareto_front, sweep
from glissando.planning.objectives import objective_named
from glissando.planning.zones import read_zone
from glissando.visualization.canvas import save_figure
from glissando.visualization.planning_figures import design_figure

_HELP = """\
Compare designs of a sliding sensor before one is built: strokes, speeds, rates, numbers of coils.

Every combination is evaluated on its own best path, by the uncertainty that the estimator will
state of each zone. A design is marked if no other matches it with less stroke, speed or coils.

With --sensor, it is sensors that are chosen and placed within a --budget instead: fixed ones of any
kind along the body, a fibre, a slide. For each budget the set is printed that makes the zones most
certain, with what no other set of the same budget could go below.
"""
_EXAMPLES = """\
examples:
  glissando design --zone 0.5:0.6 --strokes 0.03,0.06,0.12 --out design
  glissando design --robot my_robot.toml --zone 0.2:0.3 --zone 0.6:0.7 --coils 1,2 --rates 20,40
  glissando design --zone 0:0.7 --sensor coil=1 --sensor gyro=0.3:0.01 --sensor slide=3 --budget 5

What is not given is that of the robot file. Several coils follow each other a stroke apart.

--sensor may be repeated. KIND is a kind of readings (coil, pose, position, orientation, gyro,
strain), fbg for one fibre of gratings along the body, or slide for one coil on the stage. COST is
in any unit. STD is the standard deviation of its readings, in SI units; of a coil or a pose also
POSITION,ROTATION in m and rad; that of the robot file unless given.

exit status: 0 done; 2 something given was wrong.
"""

_COILS = 100  # at most, on one slide


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "design", texts, _design)
    add = parser.add_argument
    add_task(parser)
    add("--strokes", type=_numbers, metavar="M,…", help="default: half, one and two of the stage's")
    add("--speeds", type=_numbers, metavar="M/S,…", help="default: half and all of the stage's")
    add("--rates", type=_numbers, default=[20.0, 40.0], metavar="HZ,…", help="default 20,40")
    add("--coils", type=_numbers, default=[1, 2], metavar="N,…", help="default 1,2")
    add("--sensor", action="append", metavar="KIND=COST[:STD]", help="a sensor to place; see below")
    add("--budget", type=float, metavar="COST", help="most that sensors may cost (default: of 6)")
    add("--places", type=int, default=14, metavar="N", help="places of fixed ones (default 14)")
    add("--out", type=Path, metavar="DIR", help="write design.json and design.png here")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers") from None


def _design(options: argparse.Namespace) -> int:
    if options.out:
        require_results_folder(options.out)
    require_horizon(options)
    if options.sensor:
        refuse_unused(options, "--sensor", "strokes", "speeds", "rates", "coils", "bound", "stream")
        return place(options)
    _require_sweep(options)
    stage, upper = stage_of(options)
    robot = load_robot(options.robot)
    strokes = options.strokes or [
        part * stage.stroke for part in (0.5, 1.0, 2.0) if part * stage.stroke <= upper
    ]
    speeds = options.speeds or [0.5 * stage.speed, stage.speed]
    zones = [read_zone(text) for text in options.zone]
    most = len(strokes) * len(speeds) * len(options.rates) * len(options.coils)
    designs: list[Design] = []
    with working("planning every design") as work:
        for each in sweep(
            robot,
            zones,
            strokes=strokes,
            speeds=speeds,
            rates=options.rates,
            coils=[int(count) for count in options.coils],
            acceleration=stage.acceleration,
            upper=upper,
            horizon=options.horizon,
            objective=objective_named(options.objective, options.bound, robot.length),
            stream=stream_of(options, robot.sensor_parameters),
        ):
            designs.append(each)
            work.update(len(designs), most)
    best = pareto_front(designs)
    rows = [{**asdict(d), "best": bool(b)} for d, b in zip(designs, best, strict=True)]
    report = {"zones": options.zone, "designs": rows}
    if options.out:
        with renewed_folder(options.out, ("design.json", "design.png")) as building:
            write_report(building / "design.json", report | stated(options))
            save_figure(design_figure(designs), building / "design.png")
    if options.json:
        print(json.dumps(report))
    else:
        Console().print(_table(designs, best.tolist(), options.zone))
    return 0


def _require_sweep(options: argparse.Namespace) -> None:
    """Raise GlissandoError for options that have no effect on, or are invalid for, a sweep."""
    refuse_unused(options, "a design without --sensor", "budget", "places")
    if options.objective != "chance":
        refuse_unused(options, f"--objective {options.objective}", "bound")
    if any(count not in range(1, _COILS + 1) for count in options.coils):
        raise GlissandoError(f"--coils {options.coils}: give whole numbers from 1 to {_COILS}.")
    for speed in options.speeds or ():
        require_speed("--speeds", speed)


def _table(designs: list[Design], best: list[bool], zones: list[str]) -> Table:
    headings = "stroke (mm)", "speed (mm/s)", "rate (Hz)", "coils", *zones
    table = number_table("position σ (mm) in each zone", headings)
    table.add_column("worth it")
    for design, mark in zip(designs, best, strict=True):
        costs = f"{1e3 * design.stroke:g}", f"{1e3 * design.speed:g}", f"{design.rate:g}"
        std = (f"{1e3 * value:.2f}" for value in design.std)
        table.add_row(*costs, str(design.coils), *std, "*" if mark else "")
    return table
