"""`glissando calibrate`: clock offsets, frames, mounts and the slide's zero from a session."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from glissando.calibration.rig.calibrate import calibrate
from glissando.calibration.rig.carriage import SlideFit
from glissando.calibration.rig.recording_data import calibrated, recording_data
from glissando.calibration.rig.result import Calibration, apply
from glissando.calibration.rig.rig import RigData
from glissando.calibration.rig.session_data import rig_data
from glissando.cli.console import Console, number_table
from glissando.cli.outputs import require_replaceable, require_writable
from glissando.cli.progress import working
from glissando.cli.shared import Commands, add_command, chosen_robot
from glissando.errors import GlissandoError, RecordingError, RobotFileError
from glissando.io.atomic import require_new
from glissando.io.recording_folder import load_recording, save_recording
from glissando.io.robot_file import load_robot
from glissando.io.session_log import read_session
from glissando.io.session_recording import LOG
from glissando.io.shipped_robots import beside, robot_file, shipped_robots
from glissando.io.toml_table import read_document
from glissando.model.robot import Robot

_HELP = """\
Find the constants of a rig that a sliding sensor needs: the clocks of tracker and slide relative to
motion capture's, the tracker's frame, the coil's mount, and the slide's zero, direction and lead
scale, all with their covariance.

SESSION is a folder that `record` wrote, or its raw log (MCAP). RECORDING is any recording with a
coil and motion capture as truth, such as `import` writes: what is found is applied to it and listed
in its recording.toml, with units and standard deviations, and RECORDING.uncalibrated keeps it as it
was. Bend the robot to and fro in both planes while the coil slides at two speeds. Constants that a
session does not show are listed, with the motion that would show them.
"""
_EXAMPLES = """\
examples:
  glissando calibrate imported                            # puts the recording itself right
  glissando calibrate imported --recording calibrated     # writes another one
  glissando calibrate session --out rig.toml --recording calibrated
  glissando estimate calibrated --out results
  glissando calibrate session.mcap --robot my_robot.toml --out rig.toml --json

exit status: 0 done, whatever the warnings; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "calibrate", texts, _calibrate)
    add = parser.add_argument
    given = "folder that `record` wrote, or its raw log, .mcap; or a recording"
    add("session", type=Path, metavar="SESSION|RECORDING", help=given)
    robots = ", ".join(shipped_robots())
    add("--robot", metavar="FILE|NAME", help=f"robot file, or one of {robots}")
    add(
        "--coil",
        metavar="NAME",
        help="the coil of a session or stream of a recording to calibrate, if several",
    )
    add("--out", type=Path, metavar="FILE", help="TOML file to write (needed for a SESSION)")
    made = "write what was recorded, put right, as a new recording"
    add("--recording", type=Path, metavar="DIR", help=made)
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _calibrate(options: argparse.Namespace) -> int:
    if options.out:
        require_writable(options.out.parent)
        begins = ('format = "glissando calibration',)
        require_replaceable("--out", options.out, options.session, options.robot, begins=begins)
    if options.recording:
        require_new(options.recording, RecordingError)
    given: Path = options.session
    is_log = given.suffix == ".mcap" and not given.is_dir()
    is_session = is_log or (given / LOG).is_file()
    result, written = (_calibrate_session if is_session else _calibrate_recording)(options)
    if options.out:
        result.save(options.out)
        written.insert(0, options.out)
    if options.json:
        print(json.dumps(_as_json(result)))
        return 0
    console = Console()
    title = f"{result.coil_name}, direction {result.rig.direction:+d}"
    console.print(_table(title, result.displayed(), 3))
    if result.fits:
        console.print(_fits(result))
    if result.tube is not None:
        console.print(_tube(result.tube))
    for sentence in result.warnings:
        console.print(f"! {sentence}", markup=False)
    console.print(f"Wrote {', '.join(map(str, written))}", markup=False)
    return 0


def _calibrate_session(options: argparse.Namespace) -> tuple[Calibration, list[Path]]:
    """Calibrate a session; returns the result, and the path of the recording written, if any."""
    if options.out is None:
        raise GlissandoError("A session is kept as it is: give --out FILE for what is found.")
    if options.session.is_dir():
        options.session = options.session / LOG
    data = rig_data(read_session(options.session), options.coil)
    robot = load_robot(_robot_name(options, data))
    with working("calibrating"):
        result = calibrate(data, robot)
    if options.recording is None:
        return result, []
    made = apply(result, data, robot)
    where = _robot_source(_robot_name(options, data))
    save_recording(made, options.recording, where, _calibration_entries(result))
    return result, [options.recording]


def _calibrate_recording(options: argparse.Namespace) -> tuple[Calibration, list[Path]]:
    """Calibrate a recording; returns the result, and the paths of the recordings written."""
    folder: Path = options.session
    folder = folder if folder.name.strip(".") else folder.resolve()  # "." has no name
    original = folder.with_name(f"{folder.name}.uncalibrated")
    if options.recording is None and original.exists():
        raise GlissandoError(
            f"{original} exists, so {folder} was calibrated before; give --recording DIR for "
            f"another calibration, or calibrate {original}."
        )
    recording = load_recording(folder)
    robot = chosen_robot(recording, options.robot)
    data = recording_data(recording, options.coil)
    with working("calibrating"):
        result = calibrate(data, robot)
    made = calibrated(recording, result, data, robot)
    named = options.robot or _stated_robot(folder, robot)
    where = _robot_source(named if options.robot else beside(folder, named))
    out = options.recording or folder.with_name(f".{folder.name}-calibrated")
    save_recording(made, out, where, _calibration_entries(result))
    if options.recording:
        return result, [out]
    folder.rename(original)
    out.rename(folder)
    return result, [folder, original]


def _stated_robot(folder: Path, robot: Robot) -> str:
    """Name of the robot in recording.toml; in the public layout, that of the matching robot."""
    file = folder / "recording.toml"
    return str(read_document(file).get("robot", "")) if file.is_file() else robot.name


def _calibration_entries(result: Calibration) -> dict[str, dict[str, float | str]]:
    """Calibrated constants as entries of recording.toml, by name."""
    return {
        name: {"value": float(f"{value:.6g}"), "std": float(f"{std:.2g}"), "unit": unit}
        for name, value, std, unit in result.displayed()
    }


def _robot_name(options: argparse.Namespace, data: RigData) -> str:
    """Name or file of the robot of --robot, else of the session's, whose file may be beside it."""
    name = options.robot or data.robot
    if not name:
        raise RobotFileError(
            f"The session does not name its robot; give --robot FILE or one of "
            f"{', '.join(shipped_robots())}."
        )
    return name if options.robot else beside(options.session.parent, name)


def _robot_source(robot: str) -> str | Path:
    """Name of a shipped robot, or path of another robot's file, which a recording copies."""
    return robot if not robot or robot in shipped_robots() else robot_file(robot)


def _as_json(result: Calibration) -> dict[str, object]:
    """The result for JSON, SI units; log odds are null if only one direction is possible."""
    return {
        "coil": result.coil_name,
        "direction": result.rig.direction,
        "log_odds": result.log_odds if math.isfinite(result.log_odds) else None,
        "epoch": result.rig.epoch,
        "values": {k: {"value": v, "std": s} for k, (v, s) in result.values().items()},
        "streams": [
            {"name": f.name, "count": f.count, "rms": f.rms.tolist(), "whitened": f.whitened}
            for f in result.fits
        ],
        "tube": None if result.tube is None else _tube_as_json(result.tube),
        "warnings": list(result.warnings),
    }


def _tube_as_json(fit: SlideFit) -> dict[str, object]:
    numbers = {"lead": fit.lead, "backlash": fit.backlash, "delay": fit.delay}
    std = fit.cov.diagonal() ** 0.5
    values = {k: {"value": v, "std": s} for (k, v), s in zip(numbers.items(), std, strict=True)}
    return {"name": fit.name, **values, "along": fit.along, "across": fit.across}


def _table(title: str, displayed: Iterable[tuple[str, float, float, str]], digits: int) -> Table:
    table = number_table(title, ("value", "±"), left=("",))
    table.add_column("unit")
    for name, *numbers, unit in displayed:
        table.add_row(name, *(f"{n:.{digits}f}" for n in numbers), "" if unit == "1" else unit)
    return table


def _tube(fit: SlideFit) -> Table:
    left = f"{1e3 * fit.along:.3g} mm RMS is left along its line, {1e3 * fit.across:.3g} mm across"
    return _table(f"the slide by {fit.name} on the tube: {left}", fit.displayed(), 4)


def _fits(result: Calibration) -> Table:
    table = number_table("residuals", ("readings", "mm", "mrad", "whitened"), left=("stream",))
    for f in result.fits:
        rms = [f"{1e3 * value:.3f}" for value in f.rms]
        table.add_row(escape(f.name), str(f.count), *rms, f"{f.whitened:.2f}")
    return table
