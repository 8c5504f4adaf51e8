"""`glissando rerun`: computes a result again from its report, and lists differences."""

from __future__ import annotations

import argparse
import io
import json
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from glissando.cli.main import build_parser
from glissando.cli.shared import Commands, add_command
from glissando.cli.unused_options import refuse_unused
from glissando.errors import GlissandoError
from glissando.evaluation.reproduction import (
    SAME,
    differences,
    posterior_difference,
    table_difference,
)
from glissando.io.netcdf import load_posterior
from glissando.io.plain_file import plain_text

_HELP = """\
Compute again what a report states (report.json, replay.json, check.json, plan.json, design.json or
summary.json), with the same options and inputs, and say what differs: bytes of the inputs,
versions, entries of the report, and the tables and the posterior beside it. Nothing is written.

Numbers count as the same if they agree to 1e-8 of their size: another BLAS or processor rounds
differently. On one machine all are the same to the last digit. Running times are not compared.
"""
_EXAMPLES = """\
examples:
  glissando rerun results/report.json
  glissando rerun results/report.json --recording copy_of_recording --robot copy_of_robot.toml
  glissando rerun results/report.json --json | python -m json.tool

exit status: 0 the numbers are the same; 1 some differ; 2 something given was wrong.
"""
_COMMANDS = "estimate", "replay", "check", "plan", "design", "study", "import"
_STATED = {"request": list, "inputs": dict, "versions": dict}
_TIMES = "latency", "real_time_factor"
_LEFT_OUT = {"scheduler": None} | dict.fromkeys(
    ("live", "animate", "view", "figures", "resume"), False
)
_SHOWN = 12  # most differing entries of the report that are printed


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    parser = add_command(commands, "rerun", (_HELP, _EXAMPLES), _rerun)
    add = parser.add_argument
    add("report", type=Path, metavar="REPORT", help="report that a command wrote into its --out")
    moved = "folder of the recording, if it is not where it was"
    add("--recording", type=Path, metavar="RECORDING", help=moved)
    add("--robot", metavar="FILE|NAME", help="robot file, if it is not where it was")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _written(folder: Path, name: str) -> Path:
    """Path of the report in a folder of results: `name`, else report.json, else any JSON file."""
    reports = [folder / name, folder / "report.json", *sorted(folder.glob("*.json"))]
    return next((file for file in reports if file.is_file()), reports[0])


def _rerun(options: argparse.Namespace) -> int:
    if options.report.is_dir():
        options.report /= "report.json"
    report = _report(options.report)
    with tempfile.TemporaryDirectory() as place:
        request = _request([*report["request"], "--out", f"{place}/out"], options)
        if getattr(request, "store_tube", None):
            request.store_tube = Path(place) / "tube.toml"
        with redirect_stdout(io.StringIO()):
            request.run(request)
        again = _report(_written(request.out, options.report.name))
        comparison = _report_differences(report, again) | _file_differences(
            options.report.parent, request.out
        )
    differ = [e for e in comparison["report"] if not e["size"] <= SAME]
    posteriors = comparison["posterior"]
    comparison["same"] = (
        not differ
        and posteriors is not None
        and max(*posteriors.values(), *comparison["tables"].values()) <= SAME
    )
    if options.json:
        print(json.dumps(comparison, default=str))
    else:
        _print(comparison, differ)
    return 0 if comparison["same"] else 1


def _report(path: Path) -> dict[str, Any]:
    """Read a report that can be computed again. Raises GlissandoError for any other file."""
    try:
        report: dict[str, Any] = json.loads(plain_text(path))
        sound = all(isinstance(report[key], kind) for key, kind in _STATED.items())
    except OSError as problem:
        raise GlissandoError(f"{path} cannot be read ({problem.strerror}).") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        sound = False
    if not sound:
        raise GlissandoError(
            f"{path} does not state how it was made; give a report that one of glissando "
            f"{', '.join(_COMMANDS)} wrote into its --out."
        )
    return report


def _request(words: list[Any], options: argparse.Namespace) -> argparse.Namespace:
    """Parse a report's command line, and replace recording and robot by those given now."""
    complaint = io.StringIO()
    try:
        if words[:1] not in [[name] for name in _COMMANDS] or not all(
            isinstance(word, str) for word in words
        ):
            raise ValueError(f"it may not run {str(words[:1])[:60]}")
        with redirect_stderr(complaint), redirect_stdout(complaint):
            request = build_parser(words[0]).parse_args(words)
    except (ValueError, SystemExit) as problem:
        why = problem if isinstance(problem, ValueError) else complaint.getvalue().strip()[-200:]
        raise GlissandoError(f"{options.report} states no command to run again: {why}") from None
    request.words = words
    for name, value in _LEFT_OUT.items():
        if hasattr(request, name):
            setattr(request, name, value)
    folders = [name for name in ("recording", "target", "estimate") if getattr(request, name, None)]
    if not folders:
        refuse_unused(options, "a report that names no recording", "recording")
    if not hasattr(request, "robot"):
        refuse_unused(options, f"a report of {words[0]}", "robot")
    if folders and options.recording:
        setattr(request, folders[0], options.recording)
    if folders and not getattr(request, folders[0]).exists():
        raise GlissandoError(
            f"The recording {str(getattr(request, folders[0]))!r} of {options.report} is not "
            f"there; run this where the command ran, or give --recording."
        )
    if options.robot:
        request.robot = options.robot
    return request


def _report_differences(report: dict[str, Any], again: dict[str, Any]) -> dict[str, Any]:
    """Differences of two reports: names of inputs, versions, and entries with relative sizes."""
    before, now = report["inputs"], again["inputs"]
    inputs = sorted(k for k in {*before, *now} if before.get(k) != now.get(k))
    versions = [vars(d) for d in differences(report["versions"], again["versions"])]
    for document in (report, again):
        for key in (*_STATED, *_TIMES):
            document.pop(key, None)
    entries = [vars(d) | {"size": d.size} for d in differences(report, again)]
    return {"inputs": inputs, "versions": versions, "report": entries}


def _file_differences(before: Path, now: Path) -> dict[str, Any]:
    """Differences of the tables and posteriors of two folders; None for unlike posteriors."""
    pairs = [(path, now / path.name) for path in sorted(before.iterdir())]
    tables = {
        path.name: table_difference(path, other)
        for path, other in pairs
        if path.suffix == ".csv" and other.is_file()
    }
    nodes: tuple[float, float] | None = (0.0, 0.0)
    saved = "posterior.nc"
    if (before / saved).is_file() and (now / saved).is_file():
        nodes = posterior_difference(load_posterior(before / saved), load_posterior(now / saved))
    posteriors = None if nodes is None else {"mean_in_std": nodes[0], "std": nodes[1]}
    return {"tables": tables, "posterior": posteriors}


def _print(comparison: dict[str, Any], differ: list[dict[str, Any]]) -> None:
    """Print the differences, one a line."""
    for name in comparison["inputs"]:
        print(f"input {name}: its bytes are not those of then")
    for entry in comparison["versions"]:
        print(f"{entry['key']}: {entry['before']} then, {entry['now']} now")
    for entry in differ[:_SHOWN]:
        print(f"{entry['key']}: {entry['before']} then, {entry['now']} now")
    if len(differ) > _SHOWN:
        print(f"… and {len(differ) - _SHOWN} more entries; --json lists all")
    for name, size in comparison["tables"].items():
        if size > SAME:
            print(f"{name}: numbers up to {size:.2g} of the largest of their column apart")
    posteriors = comparison["posterior"]
    if posteriors is None:
        print("posterior.nc: another grid or state")
    elif max(posteriors.values()) > SAME:
        print(
            f"posterior.nc: means up to {posteriors['mean_in_std']:.2g} standard deviations apart, "
            f"standard deviations up to {posteriors['std']:.2g} of themselves"
        )
    rounded = comparison["report"] or any(
        (*(posteriors or {}).values(), *comparison["tables"].values())
    )
    extent = f"to {SAME:g}" if rounded else "to the last digit"
    print(f"The same {extent}." if comparison["same"] else "Not the same.")
