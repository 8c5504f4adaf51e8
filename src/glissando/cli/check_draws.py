"""`glissando check --draws`: simulation-based calibration with draws from the robot's prior."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from glissando.cli.console import Console, number_table
from glissando.cli.outputs import stated
from glissando.cli.progress import working
from glissando.cli.say import say
from glissando.cli.shared import chosen_robot
from glissando.errors import GlissandoError, RecordingError
from glissando.evaluation.run import checked_window, chosen_streams
from glissando.evaluation.simulation_based import SimulationCheck, simulate_and_rank
from glissando.io.atomic import renewed_folder
from glissando.io.provenance import write_report
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot
from glissando.model.grid import Grid
from glissando.model.robot import Robot
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings
from glissando.visualization.canvas import save_figure
from glissando.visualization.evaluation_figures import ecdf_figure

_STEPS = 60  # time nodes of a drawn session, by default


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of simulation-based calibration to the parser of `check`."""
    add = parser.add_argument
    drawn = "draw N sessions from the robot file's prior instead, and rank their truth (SBC)"
    add("--draws", type=int, metavar="N", help=drawn)
    factor = "with --draws: estimate with the prior's deviations so many times those drawn from"
    add("--prior-factor", type=float, default=1.0, metavar="F", help=factor)
    add("--seed", type=int, default=0, metavar="N", help="with --draws: of all chance (default 0)")


def check_draws(options: argparse.Namespace) -> int:
    """Draw and estimate sessions, print verdicts on the ranks; returns 0 if all are uniform."""
    if not options.prior_factor > 0.0:
        raise GlissandoError(f"--prior-factor is {options.prior_factor:g}; give one above zero.")
    robot, layout = _robot_and_layout(options)
    with working(f"sessions of {robot.name}") as work:
        checks = simulate_and_rank(
            robot,
            options.draws,
            layout=layout,
            prior_factor=options.prior_factor,
            seed=options.seed,
            progress=work.update,
        )
    document = {"name": robot.name, "simulation": [check.as_json() for check in checks]}
    if options.out:
        with renewed_folder(options.out, ("check.json", "ranks.png")) as building:
            write_report(building / "check.json", document | stated(options, robot))
            save_figure(ecdf_figure(checks), building / "ranks.png")
    if options.json:
        print(json.dumps(document))
    else:
        for check in checks:
            _print(robot, check)
    return 1 if any(check.outside for check in checks) else 0


def _robot_and_layout(
    options: argparse.Namespace,
) -> tuple[Robot, tuple[Grid, list[Readings]] | None]:
    """Robot, and grid and readings that give arclengths, times and noise; None for its own."""
    if options.target is None:
        if not options.robot:
            raise GlissandoError("--draws needs a robot: give --robot FILE or a recording.")
        return load_robot(options.robot), None
    folder: Path = options.target
    if not folder.is_dir():
        raise GlissandoError(f"--draws takes places and times of a recording; {folder} is not one.")
    recording = load_recording(folder)
    robot = chosen_robot(recording, options.robot)
    window = tuple(options.window) if options.window else None
    if window is None:
        window = _middle(checked_window(recording, None), _STEPS / robot.time_rate)
        say(f"Sessions have the readings of {seconds(*window)} s; give --window T0 T1 for others.")
    window = checked_window(recording, window)
    chosen, _, _ = chosen_streams(recording, robot, window, options.use, options.truth)
    readings = [r for r in chosen if len(r)]
    if not readings:
        raise RecordingError(
            f"{recording.name} has no readings from {seconds(*window)} s; give another --window."
        )
    if empty := [r.label for r in chosen if not len(r)]:
        say(f"Without {', '.join(empty)}, which read nothing then.")
    return robot, (robot.grid(*window, readings), readings)


def _middle(window: tuple[float, float], most: float) -> tuple[float, float]:
    """The middle `most` seconds of a window, or the whole window if it is shorter.

    >>> _middle((0.0, 10.0), 2.0)
    (4.0, 6.0)
    """
    spare = max(0.5 * (window[1] - window[0] - most), 0.0)
    return window[0] + spare, window[1] - spare


def _print(robot: Robot, check: SimulationCheck) -> None:
    count = check.checks[0].ranks.size
    title = f"{robot.name}, {check.estimator}: ranks of the truth in {count} drawn sessions"
    headings = "chance if true", "below 5 %", "above 95 %"
    table = number_table(title, headings, left=("quantity",))
    table.add_column("ranks", overflow="fold")
    for c in check.checks:
        verdict = "uniform" if c.p_value >= check.p_limit else "not uniform"
        ends = c.ranks <= 0.05, c.ranks > 0.95
        shares = (f"{100 * ranks.mean():.0f} %" for ranks in ends)
        table.add_row(c.name, f"{c.p_value:.2g}", *shares, verdict)
    Console().print(table)
    if check.not_converged:
        print(f"{check.not_converged} of {count} estimates did not converge.")
    inside = "All ranks are" if not check.outside else f"{len(check.outside)} quantities are not"
    print(f"{inside} uniform inside simultaneous {100 * check.level:g} % bands.\n")
