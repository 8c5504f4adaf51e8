"""`glissando plan`: paths of the slide, or motions of robot and slides among obstacles."""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.markup import escape
from rich.table import Table

from glissando.cli.console import Console, number_table
from glissando.cli.outputs import require_results_folder, stated
from glissando.cli.pairing import require_pair
from glissando.cli.plan_scene import plan_scene
from glissando.cli.plan_task import ROBOT, add_task, require_horizon, stage_of, stream_of
from glissando.cli.progress import working
from glissando.cli.shared import Commands, add_command
from glissando.cli.unused_options import refuse_unused
from glissando.errors import GlissandoError, PlanWarning
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.io.atomic import renewed_folder, write_table
from glissando.io.netcdf import load_posterior
from glissando.io.provenance import write_report
from glissando.io.robot_file import load_robot
from glissando.model.robot import Robot
from glissando.planning.belief import belief_of
from glissando.planning.compare import (
    PathEvaluation,
    baseline_paths,
    best_evaluated,
    evaluate_path,
)
from glissando.planning.objectives import objective_named
from glissando.planning.path_objective import path_objective_of
from glissando.planning.path_space import path_space_of
from glissando.planning.plan_slide import Plan, plan_slide
from glissando.planning.planning_problem import PlanningProblem, predict_information
from glissando.planning.sliding_sensor import sliding_sensor
from glissando.planning.zones import Zone, read_zone
from glissando.visualization.canvas import save_figure
from glissando.visualization.planning_figures import plan_figure, save_plan_film

_HELP = """\
Plan where a sliding sensor goes so that zones of the body are known best.

The information of a reading depends on where and when it is taken, not on its value. The best path
is therefore found before it is taken: from a robot file alone, or from the end of an estimate. It
is compared with baseline paths, by the uncertainty that the estimator will state after each.

With --scene the robot moves as well: tendons and slides are planned as one, so that the tip reaches
its targets and any part of the body hits anything at any moment with no more than a stated
probability. Of sensing as much is planned as the passage needs.
"""
_EXAMPLES = """\
examples:
  glissando plan --robot sliding700 --zone 0.5:0.6 --out plan
  glissando simulate --shape S --slide plan/path.csv --out s_planned
  glissando plan --zone 0.3:0.4@0:5 --zone 0.65:0.7@5:10*2 --limits 0.7,0.1,0.2 --objective max
  glissando plan --zone 0.2:0.3..0.6:0.7@0:20 --horizon 20 --limits 0.7,0.1,0.2 --json
  glissando plan --robot sliding700 --from results/posterior.nc --zone 0.5:0.6 --out next

  glissando plan --scene scene.toml --robot arm.toml --out motion

A zone is S0:S1 in metres, always or @T0:T1 in seconds; S0:S1..S2:S3@T0:T1 moves from one place to
another; *W weighs it against others. path.csv has the columns time,arclength,speed.
--scene writes tendons.csv and slides.csv with the commands over time, plan.json, a figure, and
view.html, the motion with its tube, obstacles and targets, with --animate also as plan.gif. How a
scene is written and an example: docs/how-to/scenes.md.

exit status: 0 done; 2 something given was wrong.
"""

_EQUAL = 1e-3  # relative difference of objectives that the table's four digits hardly show
_OF_ZONES = (
    *("posterior", "horizon", "objective", "bound", "limits", "stream"),
    *("start", "rate", "node_step", "speed_weight"),
)


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    parser = add_command(commands, "plan", (_HELP, _EXAMPLES), _plan)
    add = parser.add_argument
    add("--from", dest="posterior", type=Path, metavar="POSTERIOR", help="go on from its end")
    add_task(parser, zones_required=False)
    parser.set_defaults(robot=None)  # must be given with --from
    add("--scene", type=Path, metavar="FILE", help="obstacles, targets, limits of the actuators")
    add("--figure", default="png", choices=("png", "pdf", "svg"), help="of --scene (default png)")
    add("--start", type=float, metavar="M", help="arclength now (default: drawn out)")
    add("--rate", type=float, default=40.0, metavar="HZ", help="readings a second (default 40)")
    add("--node-step", type=float, metavar="S", help="between time nodes (default: the robot's)")
    add("--speed-weight", "--wear", type=float, default=0.0, metavar="S²", help="default 0")
    add("--seed", type=int, default=0, metavar="N", help="of random starts (default 0)")
    add("--out", type=Path, metavar="DIR", help="write path.csv, plan.json and plan.png here")
    add("--animate", action="store_true", help="also write plan.gif, the same in time, in DIR")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _plan(options: argparse.Namespace) -> int:
    if options.posterior and not (options.robot or options.scene):
        raise GlissandoError("--from needs the robot of that estimate; give --robot as well.")
    options.robot = options.robot or ROBOT
    if options.seed < 0:
        raise GlissandoError(f"--seed is {options.seed}; give 0 or more.")
    if options.out:
        require_results_folder(options.out)
    elif options.animate:
        raise GlissandoError("--animate writes into a folder: give --out DIR.")
    if options.scene:
        if options.zone:
            raise GlissandoError("--scene and --zone exclude each other; give [[zones]] in it.")
        refuse_unused(options, "--scene", *_OF_ZONES)
        return plan_scene(options)
    refuse_unused(options, "a plan without --scene", "figure")
    if options.objective != "chance":
        refuse_unused(options, f"--objective {options.objective}", "bound")
    if not options.zone:
        raise GlissandoError("Nothing is to be known: give --zone S0:S1, or --scene FILE.")
    require_horizon(options)
    return _plan_slide(options)


def _plan_slide(options: argparse.Namespace) -> int:
    """Plan the path of the slide, compare it with baselines, and print or write the result."""
    zones = [read_zone(text) for text in options.zone]
    robot = load_robot(options.robot)
    objective = objective_named(options.objective, options.bound, robot.length)
    stage, upper = stage_of(options)
    start = upper if options.start is None else options.start
    source = _planning_source(options, robot)
    stream = stream_of(options, belief_of(source).sensor_parameters)
    sensor = sliding_sensor(robot, rate=options.rate, name=stream)
    reach = upper - stage.stroke, upper
    with working("planning") as work:
        problem = predict_information(
            source, reach, options.horizon, sensor, node_step=options.node_step
        )
        path_objective = path_objective_of(problem, zones, objective)
        path_space = path_space_of(stage, upper, start, options.horizon)
        weight = options.speed_weight
        plan = plan_slide(
            path_objective,
            path_space,
            zones,
            speed_weight=weight,
            seed=options.seed,
            progress=work.update,
        )
        aims = baseline_paths(stage, upper, start, path_space.control_times, options.seed)
        work.begin("comparing the plan with other paths")
        plan = best_evaluated(plan, path_objective, zones, aims, weight, work.update)
        work.begin("predicting what the estimate will state")
        baselines = baseline_paths(stage, upper, start, path_space.times, options.seed)
        paths = {"planned": plan.arclength, **baselines}
        results = {}
        for name, path in paths.items():
            results[name] = evaluate_path(problem, zones, objective, path)
            work.update(len(results), len(paths))
    if not options.speed_weight:
        _warn_of_better(results)
    report = {
        "robot": robot.name,
        "objective": options.objective,
        "zones": options.zone,
        "limits": vars(stage),
        "start": start,
        "paths": {
            name: {key: getattr(result, key) for key in ("value", "std", "worst")}
            for name, result in results.items()
        },
        "starts": plan.starts,
    }
    if options.out:
        _write(options, report | stated(options), plan, problem, zones, paths)
    if options.json:
        print(json.dumps(report))
        return 0
    Console().print(_table(options.objective, results))
    if options.out:
        print(f"Wrote {options.out / 'path.csv'}")
    return 0


def _planning_source(options: argparse.Namespace, robot: Robot) -> Posterior | Robot:
    """Belief to plan from: the posterior of --from, checked against the robot, or the robot."""
    if not options.posterior:
        return robot
    posterior = load_posterior(options.posterior)
    require_pair(posterior, robot, "the plan", (-np.inf, np.inf))
    return posterior


def _warn_of_better(results: Mapping[str, PathEvaluation]) -> None:
    """Warn if a baseline path has a lower objective than the plan, by more than _EQUAL."""
    best, planned = min(results, key=lambda name: results[name].value), results["planned"].value
    if results[best].value < planned - _EQUAL * abs(planned):
        warnings.warn(
            f"The {best} path does better than the planned one; look farther ahead with --horizon, "
            f"as the rest in which a plan ends then weighs less, or try another --seed.",
            PlanWarning,
            stacklevel=2,
        )


def _write(
    options: argparse.Namespace,
    report: dict[str, object],
    plan: Plan,
    problem: PlanningProblem,
    zones: list[Zone],
    paths: dict[str, Array],
) -> None:
    """Write path.csv, plan.json and plan.png, and plan.gif with --animate."""
    knots, head = np.column_stack(plan.knots()), ("time", "arclength", "speed")
    shown = {name: paths[name] for name in ("planned", "oscillating", "fixed")}
    with renewed_folder(options.out, ("path.csv", "plan.json", "plan.png", "plan.gif")) as building:
        write_table(building / "path.csv", head, knots)
        write_report(building / "plan.json", report)
        save_figure(plan_figure(problem, shown, zones), building / "plan.png")
        if options.animate:
            save_plan_film(problem, shown, zones, building / "plan.gif")


def _table(objective: str, results: dict[str, PathEvaluation]) -> Table:
    headings = "σ (mm)", "worst (mm)", objective, "variance against oscillating"
    table = number_table("predicted for the zones", headings, left=("path",))
    reference = results["oscillating"].std ** 2
    for name, result in results.items():
        change = f"{100 * (result.std**2 / reference - 1):+.1f} %"
        numbers = f"{1e3 * result.std:.2f}", f"{1e3 * result.worst:.2f}", f"{result.value:.4g}"
        table.add_row(escape(name), *numbers, "" if name == "oscillating" else change)
    return table
