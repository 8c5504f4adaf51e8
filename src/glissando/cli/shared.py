"""Options and steps that several commands share."""

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
"""Where a command adds its parser."""

_AS_LONG = 0.01  # of its length: robots that differ by less count as alike


def add_command(
    commands: Commands,
    name: str,
    texts: tuple[str, str],
    run: Callable[[argparse.Namespace], int],
) -> argparse.ArgumentParser:
    """Add a command and return its parser.

    Args:
        commands: Where the command is added.
        name: Name of the command.
        texts: What stands above and below its options in the help.
        run: Executes the command and returns its exit status.
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
    """The names in a list separated by commas, each once."""
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
    """The robot of that name or file, else the recording's own.

    Lines on stderr say that it is not as long as the recording's own, and name streams that its
    sensor parameters are for and the recording lacks.

    Raises:
        RobotFileError: If there is neither.
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
    """The readings and the truth of the recording that a posterior was estimated from, placed."""
    time = posterior.grid.time
    require_pair(posterior, robot, recording.name, recording.span())
    window = (float(time[0]), float(time[-1]))
    readings, truth, _ = chosen_streams(recording, robot, window, options.use, options.truth)
    return placed(readings, posterior), placed(truth, posterior)


def estimate_watched(
    recording: Recording, robot: Robot, options: argparse.Namespace
) -> tuple[Run, str]:
    """Estimate a recording while stderr shows how far the iteration is.

    Returns:
        The run, and the sentence of a warning that it has not converged, else an empty one.
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
    """Print findings on stderr, a line each."""
    for finding in findings:
        say(f"glissando: warning ({finding.name}): {finding.sentence}")


def findings_in(folder: Path) -> list[Finding]:
    """What is implausible about a recording that was just written; nothing if it names no robot."""
    recording = load_recording(folder)
    if recording.robot is None:
        return []
    try:
        window = checked_window(recording, None)
        streams = chosen_streams(recording, recording.robot, window, None, None)[:2]
        return examine_recording(recording, recording.robot, *streams, window)
    except GlissandoError as problem:  # such as a stream without noise: an estimate will say so
        return [Finding("shape", str(problem), False)]


@dataclass(frozen=True)
class ViewData:
    """What a page or a figure shows.

    Attributes:
        posterior: The posterior.
        readings: Streams that were used; empty where no recording is known.
        truth: Streams to compare with.
        title: Name of the recording or of the posterior's folder.
        complaint: Sentence of a warning that it has not converged, else empty.
        robot: The robot, where a recording or a name tells it.
    """

    posterior: Posterior
    readings: list[Readings]
    truth: list[Readings]
    title: str
    complaint: str = ""
    robot: Robot | None = None


def of_results(target: Path) -> Path:
    """The posterior of a folder of results, else what was given, such as a recording's folder."""
    inside = target / "posterior.nc"
    return inside if inside.is_file() and not (target / "recording.toml").exists() else target


def posterior_shown(options: argparse.Namespace) -> ViewData:
    """The posterior of `options.target`, which is one, its folder, or a recording to estimate.

    Raises:
        GlissandoError: There is neither.
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
    """The earlier estimate to start from, if the command has that option and it is given."""
    path = getattr(options, "start", None)
    if path is None:
        return None
    posterior = load_posterior(path)
    window = checked_window(recording, tuple(options.window) if options.window else None)
    require_pair(posterior, robot, recording.name, window)
    return posterior


def recording_and_robot(options: argparse.Namespace) -> tuple[Recording, Robot]:
    """The recording of `options.recording`, and its robot or the one that was asked for."""
    recording = load_recording(options.recording)
    return recording, chosen_robot(recording, options.robot)
