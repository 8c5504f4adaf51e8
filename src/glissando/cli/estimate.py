"""`glissando estimate`: the posterior of a recording, its errors against truth, and figures."""

from __future__ import annotations

import argparse
import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape

from glissando.cli.console import (
    TRUTH_HEADINGS,
    Console,
    parameter_text,
    print_rows_dropped,
    site_table,
    truth_cells,
)
from glissando.cli.loads import loads_json, print_loads, scanned, write_contacts
from glissando.cli.outputs import (
    require_replaceable,
    require_results_folder,
    stated,
)
from glissando.cli.progress import working
from glissando.cli.say import say
from glissando.cli.shared import (
    Commands,
    add_choices,
    add_command,
    estimate_watched,
    recording_and_robot,
)
from glissando.errors import GlissandoError
from glissando.estimation.contact import ContactScan
from glissando.estimation.loads import require_mechanics
from glissando.evaluation.metrics import pool
from glissando.evaluation.run import Run, checked_window, write_run
from glissando.geometry.se3 import Array
from glissando.io.atomic import renewed_folder
from glissando.io.query_csv import QUERY_COLUMNS, read_query, write_query
from glissando.io.recording import Recording
from glissando.model.robot import Robot
from glissando.model.seconds import seconds
from glissando.visualization.figures import save_figures
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
  glissando estimate my_recording --robot my_rod.toml --loads        # what acts on it
  glissando estimate my_recording --json | python -m json.tool

exit status: 0 done; 1 the estimate did not converge; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _ESTIMATE_HELP, _ESTIMATE_EXAMPLES
    estimate = add_command(commands, "estimate", texts, _estimate)
    estimate.set_defaults(figures=True)
    add = estimate.add_argument
    add("recording", type=Path, metavar="RECORDING", help="folder of the recording")
    add_choices(estimate)
    answers = "points (columns time,arclength); answers go to query.csv in DIR, or here"
    add("--query", type=Path, metavar="FILE.csv", help=answers)
    add("--out", type=Path, metavar="DIR", help="write posterior.nc, report.json and figures here")
    add("--animate", action="store_true", help="also write an animation, shape.mp4 or .gif, in DIR")
    add("--view", action="store_true", help="also write view.html, the robot over time, in DIR")
    add("--start", type=Path, metavar="FILE.nc", help="start from an earlier posterior.nc")
    most = "most iterations, after the rough ones that find a start (default: 100)"
    add("--max-iterations", type=int, metavar="N", help=most)
    wrenches = "print what acts on the robot, map contacts, add internal wrenches to query.csv"
    add("--loads", action="store_true", help=wrenches)
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _estimate(options: argparse.Namespace) -> int:
    recording, robot = recording_and_robot(options)
    if options.loads:
        require_mechanics(robot.prior)
    query = _checked_query(options, recording, robot) if options.query else None
    if options.out:
        if missing := [name for name in _NEEDED if find_spec(name) is None]:
            extras = ",".join(dict.fromkeys(_NEEDED[name] for name in missing))
            raise GlissandoError(
                f"--out needs {', '.join(missing)}, not installed: run pip install "
                f"'glissando[{extras}]'."
            )
        require_results_folder(options.out)
    elif options.animate or options.view:
        wish = "--animate" if options.animate else "--view"
        raise GlissandoError(f"{wish} writes into a folder: give --out DIR.")

    run, complaint = estimate_watched(recording, robot, options)
    scan = scanned(run.posterior) if options.loads else None
    written = _write(options, run, query, scan, stated(options, robot))
    if complaint:
        say(f"glissando: {complaint}")
    _warn_of_truth(run)
    if options.json:
        more = loads_json(run.posterior, scan) if scan else {}
        print(json.dumps(run.as_json() | more))
    else:
        _print(run, Console())
        if scan:
            print_loads(run.posterior, scan, Console(), tendons=_has_tendons(run))
        if written:
            Console().print("Wrote " + ", ".join(str(path) for path in written), markup=False)
    return 0 if run.posterior.solve.converged else 1


_ENOUGH, _FALSE = 50, 0.7  # least samples of truth, and least share inside 95 %, for no warning
_SHOWN = 5  # times shown of rejected readings
_NEEDED = {"h5netcdf": "netcdf", "h5py": "netcdf", "matplotlib": "plot"}  # extras, for --out


def _has_tendons(run: Run) -> bool:
    """Whether the robot file has tendons, or some readings are of tendons, which span the robot."""
    return run.robot.tendons is not None or any(r.spans for r in run.readings)


def _warn_of_truth(run: Run) -> None:
    """Warn on stderr if far less than 95 % of truth lies inside the 95 % ellipsoids."""
    if not run.errors:
        return
    errors = pool(run.errors)
    inside = errors.summary()["coverage95_position"]
    if inside is not None and errors.position.size >= _ENOUGH and inside < _FALSE:
        say(
            f"glissando: warning: {100.0 * inside:.0f} % of truth lies inside the ellipsoids that "
            f"should hold 95 %: the robot file is too sure of this robot, or truth is not in its "
            f"frame. See glissando check, and learn or widen the file."
        )


def _print(run: Run, console: Console) -> None:
    """Print a line on the solve, and a table of errors with a row for each truth site and all."""
    solve = run.posterior.solve
    counted = "" if "iterations" in solve.status else f"{solve.iterations} iterations, "
    console.print(
        f"[bold]{escape(run.recording.name)}[/bold] on {escape(run.robot.name)}, "
        f"{seconds(*run.window)} s: {solve.status}, {counted}{solve.unknowns:,} unknowns, "
        f"{sum(len(r) for r in run.readings):,} readings, {solve.seconds['total']:.2f} s of CPU"
    )
    print_rows_dropped(run.dropped, console)
    for name, times in run.refused().items():
        shown = ", ".join(f"{t:.3f}" for t in times[:_SHOWN]) + ", …" * (len(times) > _SHOWN)
        one = len(times) == 1
        console.print(
            f"  {escape(name)}: {len(times)} reading{'' if one else 's'} not used, which all "
            f"others refute: at {shown} s"
        )
    for parameter in run.sensor_parameters():
        kind = parameter["kind"]
        text = parameter_text(kind, parameter["value"], parameter["std"])
        stays = "" if parameter["observed"] else "; as stated, the readings do not determine it"
        console.print(f"  {escape(parameter['name'])} ({kind}): {text}{stays}")
    if not run.errors:
        console.print("No truth inside the window to compare with; name streams with --truth.")
        return
    headings = ("s (m)", "samples", *TRUTH_HEADINGS)
    table = site_table("RMSE against truth, and whether its confidence is true", headings)
    places = *(f"{np.mean(errors.arclength):.4f}" for errors in run.errors), "all"
    for errors, place in zip([*run.errors, pool(run.errors)], places, strict=True):
        if place == "all":
            table.add_section()
        cells = truth_cells(errors.summary())
        table.add_row(escape(errors.name), place, str(errors.arclength.size), *cells)
    console.print(table)


def _checked_query(
    options: argparse.Namespace, recording: Recording, robot: Robot
) -> tuple[Array, Array]:
    """Times (M,), s, and arclengths (M,), m, of the query, checked before the estimate."""
    time, arclength, lines = read_query(options.query)
    window = checked_window(recording, tuple(options.window) if options.window else None)
    inside = robot.grid(*window).contains(arclength, time)
    if not np.all(inside):
        row = int(np.argmin(inside))
        raise GlissandoError(
            f"{options.query.name} line {lines[row]}: time "
            f"{seconds(time[row], decimals=6)} s, arclength "
            f"{arclength[row]:g} m lies outside {seconds(*window, decimals=6)} s or the robot, "
            f"0 to {robot.length:g} m; correct or delete that line."
        )
    answers, begins = _answers_file(options), (",".join(QUERY_COLUMNS),)
    if options.out is None:
        require_results_folder(answers.parent)
    require_replaceable("--query: the answers,", answers, options.query, begins=begins)
    return time, arclength


def _answers_file(options: argparse.Namespace) -> Path:
    """Path of the file with the answers to a query."""
    return (options.out or Path()) / "query.csv"


_OUTPUTS = (
    *("report.json", "posterior.nc", "shape.png", "confidence.png", "error.png"),
    *("shape.mp4", "shape.gif", "view.html", "query.csv", "contacts.png", "contacts.csv"),
)


def _write(
    options: argparse.Namespace,
    run: Run,
    query: tuple[Array, Array] | None,
    scan: ContactScan | None,
    more: dict[str, Any],
) -> list[Path]:
    """Write the requested files, and delete those of an earlier run in --out."""
    if options.out is None:
        if query is not None:
            write_query(run.posterior, query, _answers_file(options), loads=options.loads)
        return [] if query is None else [_answers_file(options)]
    shown = run.posterior, run.readings, run.truth
    with renewed_folder(options.out, _OUTPUTS) as building, working("writing the results") as work:
        written = write_run(run, building, **more)
        if options.figures:
            written += save_figures(*shown, building)
        if scan:
            written += write_contacts(scan, building)
        if options.animate:
            work.begin("drawing the film")
            film = save_animation(*shown, building / "shape.mp4", progress=work.update)
            written.append(film)
        if options.view:
            work.begin("evaluating the posterior for the view")
            page = save_view(
                run.posterior,
                building / "view.html",
                title=run.recording.name,
                readings=run.readings,
                truth=run.truth,
                progress=work.update,
            )
            written.append(page)
        if query is not None:
            answers = building / _answers_file(options).name
            write_query(run.posterior, query, answers, loads=options.loads)
            written.append(_answers_file(options))
    return [options.out / path.name for path in written]
