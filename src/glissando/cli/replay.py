"""`glissando replay`: online estimation of a recording, as if it were live."""

from __future__ import annotations

import argparse
import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape

from glissando.cli.browser import browser_view
from glissando.cli.console import Console, print_rows_dropped, site_table, truth_cells
from glissando.cli.outputs import require_results_folder, stated
from glissando.cli.progress import working
from glissando.cli.shared import Commands, add_choices, add_command, recording_and_robot
from glissando.errors import GlissandoError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.evaluation.replay import Replay, replay
from glissando.io.atomic import renewed_folder
from glissando.io.provenance import write_report
from glissando.io.query_csv import write_states
from glissando.model.robot import Robot
from glissando.model.seconds import seconds
from glissando.visualization.canvas import save_figure
from glissando.visualization.evaluation_figures import replay_figure
from glissando.visualization.page.live import follow

_HELP = """\
Run a recording through the online estimator as if it were live: at the robot's rate it is given the
readings up to now and estimates the state. Its newest states are compared with truth, and so are
the lagged ones that are about to leave its window.

With --out every reading is written to DIR/log before it is used. If the run is killed, the same
command continues from there.
"""
_EXAMPLES = """\
examples:
  glissando replay slow_free_space --window 19 29
  glissando replay my_recording --robot my_robot.toml --lag 0.5 --out live
  glissando replay my_recording --rate real --live            # takes as long as it took
  glissando replay my_recording --json | python -m json.tool

exit status: 0 done; 2 something given was wrong.
"""

_UNINFORMATIVE = 0.5  # bound on the deviation of a miss rate from which it is not informative
_MOST = 1000  # most time nodes of the estimator's window, as in `glissando live`


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "replay", texts, _replay)
    add = parser.add_argument
    add("recording", type=Path, metavar="RECORDING", help="folder of the recording")
    add_choices(parser)
    rates = "as fast as it goes (max, the default), or as it was (real)"
    add("--rate", choices=("real", "max"), default="max", help=rates)
    lag = "seconds the estimator looks back (default: four time nodes; 0 is a filter)"
    add("--lag", type=float, metavar="S", help=lag)
    add("--out", type=Path, metavar="DIR", help="write log, replay.json, newest.csv, figure here")
    add("--live", action="store_true", help="show it in a browser as it goes (needs viser)")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _replay(options: argparse.Namespace) -> int:
    recording, robot = recording_and_robot(options)
    _require_lag(options.lag, robot)
    if options.out:
        require_results_folder(options.out)
        if (options.out / "replay.json").exists():
            raise GlissandoError(f"{options.out} holds a finished run; give another --out.")
    with working(f"replaying {recording.name}") as work, ExitStack() as stack:
        view = browser_view(robot.length, stack) if options.live else None

        def watch(done: int, total: int, smoother: FixedLagSmoother) -> None:
            work.update(done, total)
            if view is not None:
                follow(view, smoother)

        result = replay(
            recording,
            robot,
            window=tuple(options.window) if options.window else None,
            lag=options.lag,
            use=options.use,
            truth=options.truth,
            real_time=options.rate == "real",
            journal=options.out / "log" if options.out else None,
            watch=watch,
            allow=options.allow,
        )
    more = stated(options, robot)
    written = _write(result, options.out, more) if options.out else []
    print(json.dumps(result.as_json())) if options.json else _print(result, Console())
    if written and not options.json:
        Console().print("Wrote " + ", ".join(map(str, written)), markup=False)
    return 0


def _require_lag(lag: float | None, robot: Robot) -> None:
    """Raise GlissandoError for a lag, s, that is invalid or longer than `glissando live` allows."""
    if lag is None:
        return
    longest = _MOST / robot.time_rate
    if not (np.isfinite(lag) and lag >= 0.0):
        raise GlissandoError(f"--lag is {lag:g} s; give seconds, 0 or more.")
    if lag > longest:
        raise GlissandoError(f"--lag is {lag:g} s; give at most {longest:g} s, {_MOST} time nodes.")


def _write(result: Replay, folder: Path, more: dict[str, Any]) -> list[Path]:
    names = "replay.json", "newest.csv", "replay.png"
    nodes = result.robot.arclength_nodes
    pairs = zip(result.time, result.states, strict=True)
    with renewed_folder(folder, names) as building:
        report, newest, figure = (building / name for name in names)
        write_report(report, result.as_json() | more)
        write_states(((np.full(nodes.size, t), nodes, at) for t, at in pairs), newest)
        save_figure(replay_figure(result), figure)
    return [folder / "log", *(folder / name for name in names)]


def _print(result: Replay, console: Console) -> None:
    report = result.as_json()
    latency = ", ".join(f"{name} {1e3 * s:.1f} ms" for name, s in report["latency"].items())
    nis = "–" if report["nis"] is None else f"{report['nis']:.2f}"
    console.print(
        f"[bold]{escape(report['recording'])}[/bold] on {escape(report['robot'])}: "
        f"{report['updates']} updates of {report['nodes']} time nodes, {latency} each, "
        f"{report['real_time_factor']:.1f} × real time; NIS {nis}"
    )
    if report["judged_from"] > report["window"][0]:
        console.print(
            f"  went on with its log: all numbers are from {seconds(report['judged_from'])} s on"
        )
    print_rows_dropped(result.rows_dropped, console)
    for name, reasons in report["dropped"].items():
        counted = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
        console.print(f"  {escape(name)}: {counted} readings not used")
    if report["restarts"]:
        console.print(f"  began again {report['restarts']} times after it was lost")
    for name, ahead in report["next_reading"].items():
        console.print(
            f"  next reading of {escape(name)}: {ahead['miss_rate']:.1%} outside its "
            f"{ahead['level']:.0%} set, "
            + (
                f"by construction {1 - ahead['level']:.0%} ± {ahead['bound']:.1%}"
                if ahead["bound"] < _UNINFORMATIVE
                else "too few readings for a promise"
            )
        )
    if report["newest"] is None:
        console.print("No truth inside the window to compare with; name streams with --truth.")
        return
    headings = ("newest (mm)", "(deg)", "in 95 %", "lagged (mm)", "(deg)", "in 95 %")
    table = site_table("RMSE against truth: the newest states, and those that leave", headings)
    for name in [*(e.name for e in result.newest), ""]:
        cells = [_cells(report[kind], name) for kind in ("newest", "lagged")]
        if not name:
            table.add_section()
        table.add_row(escape(name or "overall"), *cells[0], *cells[1])
    console.print(table)


def _cells(errors: dict[str, Any] | None, name: str) -> list[str]:
    """Cells of RMSE and coverage at one site, or at all if the name is empty."""
    sites = {s["name"]: s for s in errors["sites"]} if errors else {}
    summary = sites.get(name) if name or not errors else errors["overall"]
    return truth_cells(summary or {}, ("position_rmse", "rotation_rmse", "coverage95_position"))
