"""`glissando calibrate`: clocks, frames, mounts and the slide's zero from a session."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from glissando.calibration.rig.calibrate import calibrate
from glissando.calibration.rig.result import Calibration, apply
from glissando.calibration.rig.rig import RigData
from glissando.calibration.rig.session_data import rig_data
from glissando.cli.progress import working
from glissando.cli.shared import Commands, add_command, require_writable
from glissando.errors import RecordingError, RobotFileError
from glissando.hardware.capture.capture import LOG
from glissando.io.atomic_folder import require_new
from glissando.io.recording import save_recording
from glissando.io.robot_file import load_robot
from glissando.io.session_log import read_session
from glissando.io.shipped_robots import shipped_robots
from glissando.model.robot import Robot

_HELP = """\
Find the constants of a rig that a sliding sensor needs: the clocks of tracker and slide relative to
motion capture's, the tracker's frame, the coil's mount, and the slide's zero, direction and lead
scale, all with their covariance.

SESSION is a raw session log (MCAP) whose metadata 'setup' says where coil and bodies sit. Bend the
robot to and fro in both planes while the coil slides at two speeds. Constants that a session does
not show are listed, with the motion that would show them.
"""
_EXAMPLES = """\
examples:
  glissando calibrate session --out rig.toml --recording calibrated
  glissando estimate calibrated --out results
  glissando calibrate session.mcap --robot my_robot.toml --out rig.toml --json

exit status: 0 done, whatever the warnings; 2 something given was wrong.
"""
_LENGTH, _ANGLE = ("mm", 1e3), ("mrad", 1e3)
_UNITS = {"delay": ("ms", 1e3), "rate": ("ppm", 1e6), "lead": ("", 1.0)}


def add_to(commands: Commands) -> None:
    """Add the command to the parser's."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "calibrate", texts, _calibrate)
    add = parser.add_argument
    given = "folder that `record` wrote, or its raw log, .mcap"
    add("session", type=Path, metavar="SESSION", help=given)
    robots = ", ".join(shipped_robots())
    add("--robot", metavar="FILE|NAME", help=f"robot file, or one of {robots}")
    add("--out", type=Path, metavar="FILE", required=True, help="TOML file to write")
    made = "also write the session as a recording that is right, to estimate"
    add("--recording", type=Path, metavar="DIR", help=made)
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _calibrate(options: argparse.Namespace) -> int:
    require_writable(options.out.parent)
    if options.session.is_dir():
        options.session = options.session / LOG
    if options.recording:
        require_new(options.recording, RecordingError)
    data = rig_data(read_session(options.session))
    robot = _robot(options, data)
    with working("calibrating"):
        result = calibrate(data, robot)
    result.save(options.out)
    if options.recording:
        name = options.robot or data.robot
        save_recording(apply(result, data, robot), options.recording, name)
    if options.json:
        print(json.dumps(_as_json(result)))
        return 0
    console = Console()
    console.print(_table(result))
    if result.fits:
        console.print(_fits(result))
    for sentence in result.warnings:
        console.print(f"! {sentence}", markup=False)
    also = f" and {options.recording}" if options.recording else ""
    console.print(f"Wrote {options.out}{also}", markup=False)
    return 0


def _robot(options: argparse.Namespace, data: RigData) -> Robot:
    """The robot that was asked for, else the session's; its file may lie beside the session."""
    name = options.robot or data.robot
    if not name:
        raise RobotFileError(
            f"The session does not name its robot; give --robot FILE or one of "
            f"{', '.join(shipped_robots())}."
        )
    beside = options.session.parent / name
    return load_robot(beside if not options.robot and beside.is_file() else name)


def _as_json(result: Calibration) -> dict[str, object]:
    """The result in SI units; log odds are null where only one direction is possible."""
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
        "warnings": list(result.warnings),
    }


def _table(result: Calibration) -> Table:
    table = Table(title=f"{result.coil_name}, direction {result.rig.direction:+d}", box=SIMPLE_HEAD)
    for heading in ("", "value", "±", "unit"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for name, (value, std) in result.values().items():
        if std > 0.0:
            last = name.split()[-1]
            angle = "rotation" in name or "tilt" in name
            unit, size = _ANGLE if angle else _UNITS.get(last, _LENGTH)
            table.add_row(name, f"{size * value:.3f}", f"{size * std:.3f}", unit)
    return table


def _fits(result: Calibration) -> Table:
    table = Table(title="residuals", title_justify="left", box=SIMPLE_HEAD)
    for heading in ("stream", "readings", "mm", "mrad", "whitened"):
        table.add_column(heading, justify="left" if heading == "stream" else "right")
    for f in result.fits:
        rms = [f"{1e3 * value:.3f}" for value in f.rms]
        table.add_row(escape(f.name), str(f.count), *rms, f"{f.whitened:.2f}")
    return table
