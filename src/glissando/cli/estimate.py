"""`glissando estimate RECORDING`: a posterior, its table against truth, and its figures."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from rich.console import Console

from glissando.cli.shared import (
    Commands,
    add_choices,
    add_command,
    chosen_robot,
    estimate_watched,
    require_writable,
)
from glissando.errors import GlissandoError
from glissando.evaluation.run import (
    Run,
    checked_window,
    print_table,
    read_query,
    write_query,
    write_run,
)
from glissando.geometry.se3 import Array
from glissando.io.recording import Recording, load_recording
from glissando.io.robot_file import Robot
from glissando.visualization.film import save_animation
from glissando.visualization.page import save_view

_ESTIMATE_HELP = """\
Estimate a robot's shape over arclength and time from a recording, with its confidence,
and judge both against the recording's truth streams.

RECORDING is a folder with one CSV file a stream and a recording.toml, or a folder of the
public space-time recordings as it is.
"""
_ESTIMATE_EXAMPLES = """\
examples:
  glissando estimate slow_free_space --window 19 29 --out results
  glissando estimate my_recording --robot my_robot.toml --use coil,gyro --truth mocap_tip
  glissando estimate my_recording --query points.csv --out results   # pose anywhere, any time
  glissando estimate my_recording --json | python -m json.tool

exit status: 0 done; 1 the estimate did not converge; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add the command to the parser's."""
    texts = _ESTIMATE_HELP, _ESTIMATE_EXAMPLES
    estimate = add_command(commands, "estimate", "estimate a recording", texts, _estimate)
    add = estimate.add_argument
    add("recording", type=Path, metavar="RECORDING", help="folder of the recording")
    add_choices(estimate)
    answers = "points (columns time,arclength); answers go to query.csv in DIR, or here"
    add("--query", type=Path, metavar="FILE.csv", help=answers)
    add("--out", type=Path, metavar="DIR", help="write posterior.nc, report.json and figures here")
    add("--animate", action="store_true", help="also write an animation, shape.mp4 or .gif, in DIR")
    add("--view", action="store_true", help="also write view.html, the robot over time, in DIR")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _estimate(options: argparse.Namespace) -> int:
    recording = load_recording(options.recording)
    robot = chosen_robot(recording, options.robot)
    query = _checked_query(options, recording, robot) if options.query else None
    if options.out:
        require_writable(options.out)
    elif options.animate or options.view:
        wish = "--animate" if options.animate else "--view"
        raise GlissandoError(f"{wish} writes into a folder: give --out DIR.")

    run, complaint = estimate_watched(recording, robot, options)
    if options.json:
        print(json.dumps(run.as_json()))
    else:
        print_table(run, Console())
    written = _write(options, run, query)
    if written and not options.json:
        Console().print("Wrote " + ", ".join(str(path) for path in written), markup=False)
    if complaint:
        print(f"glissando: {complaint}", file=sys.stderr)
    return 0 if run.posterior.solve.converged else 1


def _checked_query(
    options: argparse.Namespace, recording: Recording, robot: Robot
) -> tuple[Array, Array]:
    """Times and arclengths to answer; raises, before any work is done, when they cannot be."""
    time, arclength = read_query(options.query)
    window = checked_window(recording, tuple(options.window) if options.window else None)
    inside = robot.grid(*window).contains(arclength, time)
    if not np.all(inside):
        row = int(np.argmin(inside))
        raise GlissandoError(
            f"{options.query.name} line {row + 2}: time {time[row]:g} s, arclength "
            f"{arclength[row]:g} m lies outside {window[0]:g} to {window[1]:g} s or the robot, "
            f"0 to {robot.length:g} m; correct or delete that line."
        )
    if _answers(options).resolve() == options.query.resolve():
        raise GlissandoError(
            f"The answers would overwrite {options.query}; give another --out folder or name."
        )
    return time, arclength


def _answers(options: argparse.Namespace) -> Path:
    """The file that answers a query."""
    return (options.out or Path()) / "query.csv"


def _write(options: argparse.Namespace, run: Run, query: tuple[Array, Array] | None) -> list[Path]:
    folder = options.out
    written = write_run(run, folder) if folder else []
    if options.animate:
        film = save_animation(run.posterior, run.readings, run.truth, folder / "shape.mp4")
        written.append(film)
    if options.view:
        path, name = folder / "view.html", run.recording.name
        page = save_view(run.posterior, path, title=name, readings=run.readings, truth=run.truth)
        written.append(page)
    if query is not None:
        path = _answers(options)
        write_query(run.posterior, query, path)
        written.append(path)
    return written
