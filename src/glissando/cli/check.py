"""`glissando check`: whether the covariance of an estimate is consistent with its errors."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from glissando.cli.check_draws import add_options, check_draws
from glissando.cli.console import Console
from glissando.cli.outputs import (
    require_replaceable,
    require_results_folder,
    require_writable,
    stated,
)
from glissando.cli.say import say
from glissando.cli.shared import (
    Commands,
    ViewData,
    add_choices,
    add_command,
    of_results,
    posterior_shown,
)
from glissando.cli.unused_options import refuse_unused
from glissando.errors import GlissandoError, RecordingError
from glissando.evaluation.conformal import block_scores, conformal_tube, inside_tube, require_tube
from glissando.evaluation.consistency import LEVELS, Consistency, check, check_readings
from glissando.evaluation.leave_out import leave_out
from glissando.evaluation.metrics import Errors, errors_against
from glissando.io.atomic import renewed_folder, write_text
from glissando.io.provenance import write_report
from glissando.io.robot_file import with_tube
from glissando.model.robot import Robot
from glissando.visualization.canvas import save_figure
from glissando.visualization.evaluation_figures import calibrated_quantities, calibration_figure

_HELP = """\
Check whether the confidence of an estimate is true: errors against truth in units of their own
covariance (NEES, 1 per degree of freedom when true) and the share of errors inside the 50, 90, 95
and 99 % ellipsoids, by site, for position and rotation; and innovations of the readings (NIS), each
against the prediction by all others.

RECORDING is estimated first. A posterior.nc of an earlier estimate needs --recording for its truth.
--leave-out predicts whole streams by the others, stretches of time by the rest, and all by the
prior: a sensor that explains itself cannot hide there. It takes an estimate more than streams + 2.
Bounds hold for 95 % of estimates whose confidence is true, and allow for errors that are correlated
for a part of the session. One that lasts for all of it, of a frame or a mount, is one draw that
looks like many: judge several sessions before confidence is called false.

--store-tube finds how many standard deviations hold the whole body for a whole block of time, by
split conformal prediction on truth that nothing was learned from, and writes the robot file with
this tube: a further block like those lies inside with the level's probability, whatever the errors.

--draws needs no truth: it draws motions, sensor parameters and readings from the robot file's own
prior, estimates them in batch and online, and asks whether the ranks of the truth are uniform.
"""
_EXAMPLES = """\
examples:
  glissando check my_recording --out results
  glissando check results/posterior.nc --recording my_recording --truth mocap_tip
  glissando check my_recording --leave-out
  glissando check my_recording --json | python -m json.tool
  glissando check held_out --robot my_robot.toml --store-tube with_tube.toml --block 1
  glissando check --draws 200 --robot my_robot.toml --out ranks

exit status: 0 done, whatever the verdict; 1 the estimate did not converge, or ranks of --draws are
not uniform; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "check", texts, _check)
    add = parser.add_argument
    target = "folder, or a posterior.nc or the folder it is in"
    add("target", type=Path, nargs="?", metavar="RECORDING|POSTERIOR", help=target)
    add("--recording", type=Path, metavar="FOLDER", help="where the truth of a posterior is")
    add_choices(parser)
    add("--out", type=Path, metavar="DIR", help="write check.json and a figure here")
    add("--store-tube", type=Path, metavar="FILE", help="write the robot file with a tube to here")
    add("--level", type=float, default=0.95, metavar="P", help="of the tube (default 0.95)")
    add("--block", type=float, default=2.0, metavar="S", help="seconds of a block (default 2)")
    add_options(parser)
    left_out = "also judge streams by estimates without them (needs a RECORDING, takes longer)"
    add("--leave-out", action="store_true", help=left_out)
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _check(options: argparse.Namespace) -> int:
    if options.out:
        require_results_folder(options.out)
    if options.draws is None and options.target is not None:
        options.target = of_results(options.target)
    if options.store_tube:
        require_tube(options.block, options.level)
        if options.store_tube.is_dir():
            raise GlissandoError(f"--store-tube {options.store_tube} is a folder; name a file.")
        require_replaceable("--store-tube", options.store_tube, options.target, options.recording)
        require_writable(options.store_tube.parent, "--store-tube")
        _require_tube_file(options.store_tube, options.robot)
    _refuse_unused(options)
    if options.draws is not None:
        return check_draws(options)
    if options.target is None:
        raise GlissandoError("Nothing to check: give a recording or posterior, or --draws N.")
    checks, errors, robot, shown = _checks(options)
    if not checks:
        raise RecordingError(
            f"{shown.title} has no truth inside the window; name streams with --truth, or another "
            f"window."
        )
    tube = _tube(robot, errors, options)
    document = {"name": shown.title, "checks": [c.as_json() for c in checks], "tube": tube}
    if options.out:
        with renewed_folder(options.out, ("check.json", "calibration.png")) as building:
            write_report(building / "check.json", document | stated(options, robot))
            if calibrated_quantities(checks):
                save_figure(calibration_figure(checks), building / "calibration.png")
    if options.json:
        print(json.dumps(document))
    else:
        for quantity in dict.fromkeys(c.quantity for c in checks):
            Console().print(_table(quantity, [c for c in checks if c.quantity == quantity]), "")
        if tube:
            print(_TUBE.format(**tube))
    return 0 if shown.posterior.solve.converged else 1


def _require_tube_file(file: Path, robot: str | None) -> None:
    """Raise GlissandoError unless the file is new, the --robot file, or has a [tube] already."""
    if not file.exists() or (robot and Path(robot).exists() and file.samefile(robot)):
        return
    if "[tube]" not in file.read_text(encoding="utf-8", errors="replace"):
        raise GlissandoError(
            f"--store-tube {file} is there already, and is neither the --robot file nor one with a "
            f"[tube]; give a new file."
        )


def _refuse_unused(options: argparse.Namespace) -> None:
    """Raise GlissandoError for options that have no effect on this kind of check."""
    if options.draws is not None:
        unjudged = "recording", "store_tube", "level", "block", "leave_out", "allow"
        refuse_unused(options, "--draws", *unjudged)
        if options.target is None:
            refuse_unused(options, "--draws without a recording", "window", "use", "truth")
        return
    refuse_unused(options, "a check without --draws", "prior_factor", "seed")
    if not options.store_tube:
        refuse_unused(options, "a check without --store-tube", "level", "block")
    if options.target is not None and options.target.is_dir():
        refuse_unused(options, "a recording, which has its own truth", "recording")
    else:
        again = "a posterior, which is not estimated again"
        refuse_unused(options, again, "leave_out", "window", "allow")


def _tube(
    robot: Robot, errors: Sequence[Errors], options: argparse.Namespace
) -> dict[str, float | int] | None:
    """The robot's tube, or a new one that is stored, with the share of blocks inside it.

    Returns None without a tube, without errors against truth, or without a whole block of time.
    """
    tube = robot.tube
    if options.store_tube:
        tube = conformal_tube(block_scores(errors, options.block), options.block, options.level)
        assert robot.file is not None  # set by `chosen_robot`
        text = with_tube(robot.file.read_text(encoding="utf-8"), tube)
        write_text(options.store_tube, text)
    if tube is None or not errors:
        return None
    scores = block_scores(errors, tube.seconds)
    if not scores.size:
        return None
    return {**vars(tube), "inside": inside_tube(tube, scores), "here": int(scores.size)}


_TUBE = """\
Whole-body tube: {sigmas:.2f} standard deviations hold a block of {seconds:g} s wholly with
probability {level:g}, if it is exchangeable with the {blocks} blocks it was chosen on.
Here {inside:.1%} of {here} blocks lie wholly inside."""


def _checks(
    options: argparse.Namespace,
) -> tuple[list[Consistency], list[Errors], Robot, ViewData]:
    """Consistency checks (none without truth), errors, robot, and the posterior with its data."""
    if options.target.is_file() and options.recording is None:
        raise GlissandoError(
            "A posterior holds no truth: give the folder that does with --recording FOLDER."
        )
    shown = posterior_shown(options)
    robot = shown.robot
    assert robot is not None  # a recording has a robot
    errors = [errors_against(shown.posterior, t) for t in shown.truth]
    checks = check(errors)
    if errors or options.leave_out:
        checks += check_readings(shown.posterior, shown.readings, robot.sensor_parameters)
    if options.leave_out:
        checks += leave_out(
            robot,
            shown.posterior.grid,
            shown.readings,
            lambda left, at, count: say(f"estimate {at + 1} of {count}, without {left}"),
        )
    return checks, errors, robot, shown


def _table(quantity: str, checks: Sequence[Consistency]) -> Table:
    title = f"{quantity}: squared error per dof in units of its variance, and share inside"
    table = Table(
        title=title,
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
        show_edge=False,  # saves two columns, to fit 80
        collapse_padding=True,
    )
    table.add_column("site", overflow="fold")
    headings = ["s (m)", "NEES", "if true", *(f"{100 * level:g} %" for level in LEVELS), "worth"]
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("confidence", overflow="fold")
    for c in checks:
        low, high = c.mean_bounds()
        place = "" if math.isnan(c.arclength) else f"{c.arclength:.3f}"
        shares = [f"{100 * c.coverage(level):.0f}" for level in LEVELS]
        numbers = [f"{c.mean:.2f}", f"{low:.2f}…{high:.2f}", *shares, f"{c.effective:.0f}"]
        table.add_row(escape(c.site), place, *numbers, c.verdict)
    return table
