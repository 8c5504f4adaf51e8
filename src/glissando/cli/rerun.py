"""`glissando rerun`: a result computed again from its report.json, and what differs."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from glissando.cli.shared import (
    Commands,
    add_command,
    estimate_watched,
    input_digests,
    recording_and_robot,
)
from glissando.errors import GlissandoError
from glissando.evaluation.reproduction import SAME, differences, posterior_difference
from glissando.io.netcdf import load_posterior

_HELP = """\
Compute again what report.json states, with the same options and inputs, and say what differs: bytes
of the inputs, versions, entries of the report, and the posterior beside it.

Numbers count as the same if they agree to 1e-9 of their size: another BLAS or processor rounds
differently. On one machine all bytes are the same.
"""
_EXAMPLES = """\
examples:
  glissando rerun results/report.json
  glissando rerun results/report.json --recording copy_of_recording --robot copy_of_robot.toml
  glissando rerun results/report.json --json | python -m json.tool

exit status: 0 the numbers are the same; 1 some differ; 2 something given was wrong.
"""
_APART = "inputs", "versions", "request"  # compared by themselves, or not results
_SHOWN = 12  # entries of the report that differ


def add_to(commands: Commands) -> None:
    """Add the command to the parser's."""
    parser = add_command(commands, "rerun", (_HELP, _EXAMPLES), _rerun)
    add = parser.add_argument
    add("report", type=Path, metavar="REPORT", help="report.json that estimate --out wrote")
    moved = "folder of the recording, if it is not where it was"
    add("--recording", type=Path, metavar="RECORDING", help=moved)
    add("--robot", metavar="FILE|NAME", help="robot file, if it is not where it was")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _rerun(options: argparse.Namespace) -> int:
    report = _report(options.report)
    request = _request(report, options)
    recording, robot = recording_and_robot(request)
    before, now = report["inputs"], input_digests(recording, robot, request)
    inputs = sorted(k for k in {*before, *now} if before.get(k) != now.get(k))
    run, _ = estimate_watched(recording, robot, request)
    again = json.loads(json.dumps(run.as_json()))
    versions = [vars(d) for d in differences(report["versions"], again["versions"])]
    for document in (report, again):
        for key in (*_APART, "seconds"):
            document.pop(key, None)
    entries = [vars(d) | {"size": d.size} for d in differences(report, again)]
    differ = [e for e in entries if not e["size"] <= SAME]
    saved = options.report.parent / "posterior.nc"
    nodes = (
        posterior_difference(load_posterior(saved), run.posterior) if saved.is_file() else (0, 0)
    )
    same = not differ and nodes is not None and max(nodes) <= SAME
    found = {"same": same, "inputs": inputs, "versions": versions, "report": entries}
    found |= {"posterior": None if nodes is None else {"mean_in_std": nodes[0], "std": nodes[1]}}
    if options.json:
        print(json.dumps(found, default=str))
    else:
        _print(found, differ)
    return 0 if same else 1


def _report(path: Path) -> dict[str, Any]:
    """A report that can be computed again. Raises GlissandoError for anything else."""
    try:
        report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        wanted = {key: report[key] for key in _APART}
    except OSError as problem:
        raise GlissandoError(f"{path} cannot be read ({problem.strerror}).") from None
    except (ValueError, KeyError, TypeError):
        wanted = {}
    if not wanted or not all(isinstance(value, dict) for value in wanted.values()):
        raise GlissandoError(
            f"{path} does not state how it was made; give a report.json that glissando estimate "
            f"--out wrote."
        )
    return report


def _request(report: dict[str, Any], options: argparse.Namespace) -> argparse.Namespace:
    """The options of the estimate, with those given now in their place."""
    request = argparse.Namespace(**report["request"])
    request.recording = options.recording or Path(request.recording)
    request.robot = options.robot or request.robot
    request.start = Path(request.start) if request.start else None
    if not request.recording.exists():
        raise GlissandoError(
            f"The recording {str(request.recording)!r} of {options.report} is not there; run this "
            f"where the estimate ran, or give --recording."
        )
    return request


def _print(found: dict[str, Any], differ: list[dict[str, Any]]) -> None:
    """Say what differs, a line each."""
    for name in found["inputs"]:
        print(f"input {name}: its bytes are not those of then")
    for entry in found["versions"]:
        print(f"{entry['key']}: {entry['before']} then, {entry['now']} now")
    for entry in differ[:_SHOWN]:
        print(f"{entry['key']}: {entry['before']} then, {entry['now']} now")
    if len(differ) > _SHOWN:
        print(f"… and {len(differ) - _SHOWN} more entries; --json lists all")
    if found["posterior"] is None:
        print("posterior.nc: another grid or state")
    elif not found["same"]:
        apart = found["posterior"]
        print(
            f"posterior.nc: means up to {apart['mean_in_std']:.2g} standard deviations apart, "
            f"standard deviations up to {apart['std']:.2g} of themselves"
        )
    rounded = found["report"] or any((found["posterior"] or {}).values())
    extent = f"to {SAME:g}" if rounded else "to the last digit"
    print(f"The same {extent}." if found["same"] else "Not the same.")
