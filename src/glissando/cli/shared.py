"""What several commands need."""

from __future__ import annotations

import argparse
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from glissando.errors import GlissandoError, NotConvergedWarning, RobotFileError
from glissando.estimation.posterior import Posterior
from glissando.evaluation.run import Run, run_estimate
from glissando.io.recording import Recording
from glissando.io.robot_file import Robot, load_robot, shipped_robots
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.readings import Readings

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""Where a command adds its parser."""


def add_command(
    commands: Commands,
    name: str,
    summary: str,
    texts: tuple[str, str],
    run: Callable[[argparse.Namespace], int],
) -> argparse.ArgumentParser:
    """The parser of a new command; `texts` stand above and below its options in the help."""
    parser = commands.add_parser(
        name,
        help=summary,
        description=texts[0],
        epilog=texts[1],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def names(text: str) -> list[str]:
    """Names separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def add_choices(parser: argparse.ArgumentParser) -> None:
    """Options that say what of a recording is estimated, and by what it is judged."""
    add = parser.add_argument
    robots = ", ".join(shipped_robots())
    add("--robot", metavar="FILE|NAME", help=f"robot file, or one of {robots}")
    add("--window", nargs=2, type=float, metavar=("T0", "T1"), help="seconds to estimate")
    add("--use", type=names, metavar="NAME,…", help="streams to use (default: all but truth)")
    add("--truth", type=names, metavar="NAME,…", help="streams to judge by (default: as marked)")


def chosen_robot(recording: Recording, name: str | None) -> Robot:
    """The robot that was asked for, else the recording's. Raises RobotFileError without one."""
    robot = load_robot(name) if name else recording.robot
    if robot is None:
        raise RobotFileError(
            f"{recording.name} does not name its robot and no shipped robot fits; "
            f"give --robot FILE or one of {', '.join(shipped_robots())}."
        )
    return robot


def streams_of(
    posterior: Posterior, recording: Recording, options: argparse.Namespace
) -> tuple[list[Readings], list[Readings]]:
    """Readings that were used and truth, of the recording that a posterior was estimated from."""
    robot = chosen_robot(recording, options.robot)
    time = posterior.grid.time
    window = (float(time[0]), float(time[-1]))
    used, judges = recording.choose(options.use, options.truth)
    readings, _ = recording.readings(used, robot, window)
    truth, _ = recording.readings(judges, robot, window, as_truth=True)
    return readings, [corrected(t, robot.sensor_parameters) for t in truth if len(t)]


def estimate_watched(
    recording: Recording, robot: Robot, options: argparse.Namespace
) -> tuple[Run, str]:
    """Estimate behind a progress line on stderr; also the sentence of a warning, if any."""
    console = Console(stderr=True)
    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with (
        warnings.catch_warnings(record=True) as caught,
        Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar,
    ):
        warnings.simplefilter("always", NotConvergedWarning)
        doing = f"estimating {escape(recording.name)}"
        task = bar.add_task(doing, total=None)

        def advance(iteration: int, cost: float, length: float) -> None:
            text = f"{doing}: iteration {iteration}, cost {cost:.6g}, step {length:.3g} σ"
            bar.update(task, description=text)

        run = run_estimate(
            recording,
            robot,
            window=tuple(options.window) if options.window else None,
            use=options.use,
            truth=options.truth,
            progress=advance,
        )
    complaints = [w for w in caught if issubclass(w.category, NotConvergedWarning)]
    return run, str(complaints[0].message) if complaints else ""


def require_writable(folder: Path) -> None:
    """Raise, before any work is done, unless results can be written into the folder."""
    above = next((p for p in (folder, *folder.absolute().parents) if p.exists()), folder)
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise GlissandoError(f"--out {folder}: {above} is not a folder that can be written to.")
