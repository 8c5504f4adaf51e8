"""Options and functions that several commands share."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from glissando.cli.commands import COMMANDS
from glissando.cli.pairing import other_readings, require_pair
from glissando.cli.progress import Descent, working
from glissando.cli.say import say
from glissando.cli.unused_options import refuse_unused
from glissando.errors import (
    EstimateWarning,
    GlissandoError,
    NotConvergedWarning,
    OtherTimesWarning,
    RobotFileError,
)
from glissando.estimation.channels import placed
from glissando.estimation.posterior import Posterior
from glissando.evaluation.plausibility.examine import examine_recording
from glissando.evaluation.plausibility.finding import Finding, listed
from glissando.evaluation.run import Run, checked_window, chosen_streams, run_estimate
from glissando.io.netcdf import load_posterior
from glissando.io.recording import Recording
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import shipped_robots
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.solver.gauss_newton import SolverOptions

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""Subparsers to which a command adds its own."""

_AS_LONG = 0.01  # largest relative difference of lengths without a warning


def add_command(
    commands: Commands,
    name: str,
    texts: tuple[str, str],
    run: Callable[[argparse.Namespace], int],
) -> argparse.ArgumentParser:
    """Add a command and return its parser.

    Args:
        commands: Subparsers to which the command is added.
        name: Name of the command.
        texts: Description and epilog of its help, above and below the options.
        run: Function that executes the command and returns its exit status.
    """
    parser = commands.add_parser(
        name,
        help=COMMANDS[name][1],
        description=texts[0],
        epilog=texts[1],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run, default_of=parser.get_default, refuse=parser.error)
    return parser


def names(text: str) -> list[str]:
    """Names in a text separated by commas, in order and without repeats."""
    return list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def add_choices(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose robot, window, streams to use and truth."""
    add = parser.add_argument
    robots = ", ".join(shipped_robots())
    add("--robot", metavar="FILE|NAME", help=f"robot file, or one of {robots}")
    add("--window", nargs=2, type=float, metavar=("T0", "T1"), help="seconds to estimate")
    add("--use", type=names, metavar="NAME,…", help="streams to use (default: all but truth)")
    add("--truth", type=names, metavar="NAME,…", help="streams to judge by (default: as marked)")
    allowed = "checks of plausibility to leave out, of those that a refusal names"
    add("--allow", type=names, default=[], metavar="NAME,…", help=allowed)


def chosen_robot(recording: Recording, name: str | None) -> Robot:
    """The robot of a name or file, else the recording's own.

    Warnings on stderr report a robot that is not as long as the recording's own, and streams of
    its sensor parameters that the recording lacks.

    Raises:
        RobotFileError: No name is given and the recording has no robot, or the file is invalid.
    """
    robot = load_robot(name) if name else recording.robot
    if robot is None:
        raise RobotFileError(
            f"{recording.name} does not name its robot and no shipped robot fits; "
            f"give --robot FILE or one of {', '.join(shipped_robots())}."
        )
    own = recording.robot.length if recording.robot else robot.length
    if abs(robot.length - own) > _AS_LONG * own:
        say(
            f"glissando: warning: {robot.name} is {robot.length:g} m long, the robot that "
            f"{recording.name} names {own:g} m."
        )
    named = dict.fromkeys(s for p in robot.sensor_parameters for s in p.streams)
    lacking = [stream for stream in named if stream not in recording.streams]
    if lacking:
        say(
            f"glissando: warning: sensor parameters of {robot.name} are for {listed(lacking)}, "
            f"which {recording.name} lacks; its streams are {', '.join(recording.streams)}."
        )
    return robot


def streams_of(
    posterior: Posterior, recording: Recording, robot: Robot, options: argparse.Namespace
) -> tuple[list[Readings], list[Readings]]:
    """Readings and truth of the recording in a posterior's time, with the choices of `options`.

    Readings in channels get the arclengths at which the posterior places them.
    """
    time = posterior.grid.time
    require_pair(posterior, robot, recording.name, recording.span())
    window = (float(time[0]), float(time[-1]))
    readings, truth, _ = chosen_streams(recording, robot, window, options.use, options.truth)
    return placed(readings, posterior), placed(truth, posterior)


def estimate_watched(
    recording: Recording, robot: Robot, options: argparse.Namespace
) -> tuple[Run, str]:
    """Estimate a recording while stderr shows the progress of the iterations.

    Returns:
        The run, and the warning that it has not converged, or an empty text.
    """
    most = getattr(options, "max_iterations", None)
    if most is not None and most < 1:
        raise GlissandoError(f"--max-iterations is {most}; give 1 or more.")
    work = working(f"estimating {recording.name}")
    with warnings.catch_warnings(record=True) as caught, work as shown:
        warnings.simplefilter("always", EstimateWarning)
        run = run_estimate(
            recording,
            robot,
            window=tuple(options.window) if options.window else None,
            use=options.use,
            truth=options.truth,
            progress=Descent(shown, SolverOptions().tolerance),
            allow=options.allow,
            start=_start(options, recording, robot),
            max_iterations=most,
        )
    for each in caught:
        if issubclass(each.category, OtherTimesWarning):
            warnings.warn(each.message, stacklevel=2)
    warn(run.findings)
    if run.posterior.solve.doubt:
        say(f"glissando: warning: {run.posterior.solve.doubt}")
    complaints = [w for w in caught if issubclass(w.category, NotConvergedWarning)]
    return run, str(complaints[0].message) if complaints else ""


def warn(findings: Sequence[Finding]) -> None:
    """Print findings on stderr as warnings, one a line."""
    for finding in findings:
        say(f"glissando: warning ({finding.name}): {finding.sentence}")


def findings_in(folder: Path) -> list[Finding]:
    """Implausible properties of a recording just written; none are found without a robot."""
    recording = load_recording(folder)
    if recording.robot is None:
        return []
    try:
        window = checked_window(recording, None)
        streams = chosen_streams(recording, recording.robot, window, None, None)[:2]
        return examine_recording(recording, recording.robot, *streams, window)
    except GlissandoError as problem:  # such as a stream without noise
        return [Finding("shape", str(problem), False)]


@dataclass(frozen=True)
class ViewData:
    """Data shown by a page, a figure or a check.

    Attributes:
        posterior: Posterior to show.
        readings: Readings that were used; empty without a recording.
        truth: Truth streams to compare with; empty without a recording.
        title: Name of the recording, or of the posterior's file or folder.
        complaint: Warning that the estimate has not converged, else empty.
        robot: Robot of the recording or of --robot; None without either.
    """

    posterior: Posterior
    readings: list[Readings]
    truth: list[Readings]
    title: str
    complaint: str = ""
    robot: Robot | None = None


def of_results(target: Path) -> Path:
    """Path of the posterior in a folder of results, else the path itself."""
    inside = target / "posterior.nc"
    return inside if inside.is_file() and not (target / "recording.toml").exists() else target


def posterior_shown(options: argparse.Namespace) -> ViewData:
    """Posterior of `options.target`: its file or folder, or a recording, which is estimated.

    Raises:
        GlissandoError: The target does not exist, or an option has no effect on it.
    """
    target = of_results(options.target)
    if target.is_dir():
        refuse_unused(options, "a recording, which has its own", "recording")
        recording = load_recording(target)
        robot = chosen_robot(recording, options.robot)
        run, complaint = estimate_watched(recording, robot, options)
        return ViewData(run.posterior, run.readings, run.truth, recording.name, complaint, robot)
    if not target.is_file():
        raise GlissandoError(
            f"There is no recording folder or posterior {str(target)!r}; give one."
        )
    refuse_unused(options, "a posterior, which is not estimated again", "allow")
    posterior = load_posterior(target)
    if options.recording is None:
        refuse_unused(options, "a posterior without --recording", "use", "truth")
        known = load_robot(options.robot) if options.robot else None
        return ViewData(posterior, [], [], options.target.resolve().name, "", known)
    recording = load_recording(options.recording)
    if others := other_readings(target, options.recording):
        say(f"glissando: warning: {others}")
    robot = chosen_robot(recording, options.robot)
    streams = streams_of(posterior, recording, robot, options)
    return ViewData(posterior, *streams, recording.name, "", robot)


def _start(options: argparse.Namespace, recording: Recording, robot: Robot) -> Posterior | None:
    """Earlier posterior of --start, from which to start; None if it is not given."""
    path = getattr(options, "start", None)
    if path is None:
        return None
    posterior = load_posterior(path)
    window = checked_window(recording, tuple(options.window) if options.window else None)
    require_pair(posterior, robot, recording.name, window)
    return posterior


def recording_and_robot(options: argparse.Namespace) -> tuple[Recording, Robot]:
    """Load the recording of `options.recording`, and the robot of --robot or its own."""
    recording = load_recording(options.recording)
    return recording, chosen_robot(recording, options.robot)
