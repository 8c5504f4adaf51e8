"""`glissando learn`: the numbers of a robot file from recordings."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

from glissando.calibration.robot.case import RecordingCase
from glissando.calibration.robot.hyperparameters import Document, Parameter, expanded, learnable
from glissando.calibration.robot.joint_calibration import lasting, locate
from glissando.calibration.robot.learn import Learned, learn
from glissando.calibration.robot.predictive import Start
from glissando.cli.console import Console
from glissando.cli.learn_tendons import is_of_tendons, learn_from_tendons
from glissando.cli.outputs import require_spared, write_robot
from glissando.cli.progress import working
from glissando.cli.shared import Commands, add_command, names
from glissando.cli.tables import number_table, parameter_text
from glissando.errors import GlissandoError, RecordingError
from glissando.evaluation.metrics import pool
from glissando.evaluation.run import checked_window, require_rows, run_estimate
from glissando.geometry.se3 import Array
from glissando.io.recording import Recording
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot, parse_robot, read_robot_document
from glissando.io.shipped_robots import robot_file
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.table import Table

_STEPS = 20  # unless told otherwise
_HELP = """\
Learn the numbers of a robot file from recordings: densities, time scale, strength by segment,
noise, drifts; of a mechanical prior loads and weights. Without truth, the numbers that make the
readings most likely (their evidence); with truth, those that predict it best from the sensors
alone: small errors and a true confidence. A number that the recordings do not determine stays near
its start; a factor of three is expected.

Recordings of displacements of tendons and of a marker, positions named tip, give the numbers of
[tendons] and [mechanics] with the error of the model, and --robot then needs a mechanical prior.
Where other sensors stand beside them, --use and the other options choose the usual way.

The file written has the same keys and is given to estimate with --robot.
"""
_EXAMPLES = """\
examples:
  glissando learn slow --robot tdcr466-segments --truth vicon1,vicon2 --calibrate --out mine.toml
  glissando learn first second --robot my_robot.toml --out learned.toml      # evidence only
  glissando learn slow --robot my_robot.toml --out learned.toml --only noise --window 0 20

exit status: 0 done; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add the command to the parser's."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "learn", texts, _learn)
    add = parser.add_argument
    add("recordings", type=Path, nargs="+", metavar="RECORDING", help="folders of recordings")
    add("--robot", required=True, metavar="FILE|NAME", help="robot file to start from")
    add("--out", required=True, type=Path, metavar="FILE", help="robot file to write")
    add("--use", type=names, metavar="NAME,…", help="streams to use (default: all but truth)")
    add("--truth", type=names, metavar="NAME,…", help="streams to predict (default: none)")
    add("--hold-out", type=names, metavar="NAME,…", help="truth to judge by, never learned from")
    calibrate = "find the frame of the truth and the mounts of its bodies, and write them as known"
    add("--calibrate", action="store_true", help=calibrate)
    joint = "find them first, with the mounts of uncertain sensors, from sensors and truth at once"
    add("--joint", action="store_true", help=joint)
    add("--window", nargs=2, type=float, metavar=("T0", "T1"), help="seconds to learn from")
    only = "learn only numbers whose names hold all words of one of these (default: all)"
    add("--only", type=names, metavar="WORDS,…", help=only)
    alike = "segments are built alike: scale what each has together"
    add("--alike", action="store_true", help=alike)
    add("--steps", type=int, metavar="N", help=f"steps at most (default: {_STEPS})")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _learn(options: argparse.Namespace) -> int:
    recordings = [load_recording(folder) for folder in options.recordings]
    robot = load_robot(options.robot)  # which says what is wrong with it
    document = expanded(read_robot_document(robot_file(options.robot)))
    document.pop("tube", None)  # it was calibrated for the numbers of before
    _require_writable(options)
    if is_of_tendons(recordings, options):
        return learn_from_tendons(recordings, document, options)
    _require_one_way(options)
    cases = [_case(recording, options).while_moving(robot) for recording in recordings]
    parameters = _parameters(document, cases, options)
    constants: tuple[SensorParameter, ...] = ()
    std: dict[str, Array] = {}
    start: Start | None = None
    with working("learning") as work:
        if options.joint:
            work.begin("finding frames and mounts")
            first = cases[0]
            document, constants, std, start = locate(
                document, recordings[0], first.window, first.use, options.truth
            )
            work.begin("learning")
        result = learn(
            document,
            parameters,
            cases,
            calibrate=options.calibrate,
            constants=constants,
            start=start,
            steps=_steps(options),
            watch=lambda done, value, total: work.update(
                done, total, f"step {math.ceil(done)}, {value:.4f} a degree of freedom"
            ),
        )
    written = _with_constants(result)
    write_robot(written, options.robot, options.out)
    report = _as_json(result, options.out) | {"windows": [case.window for case in cases]}
    if options.hold_out and not result.interrupted:
        report["held_out"] = [
            {"file": name, **_held_out(case, file, options)}
            for case in cases
            for name, file in (("before", document), ("after", written))
        ]
    if options.json:
        print(json.dumps(report))
    else:
        _print(result, report, std)
    if result.interrupted:
        said = f"{options.out} holds what was learned in {result.steps} steps"
        print(f"glissando: interrupted; {said}; learn on from it.", file=sys.stderr)
        return 130
    return 0


def _require_one_way(options: argparse.Namespace) -> None:
    """Raise unless constants are found in one way, or in none, and there is truth to find them."""
    for flag in ("calibrate", "joint"):
        if getattr(options, flag) and not options.truth:
            raise GlissandoError(
                f"--{flag} finds where the truth is mounted: name it with --truth."
            )
    if options.calibrate and options.joint:
        raise GlissandoError("--joint and --calibrate find the same constants; give one of them.")


def _steps(options: argparse.Namespace) -> int:
    """Steps at most; None tells an option that was not given."""
    return _STEPS if options.steps is None else options.steps


def _parameters(
    document: Document, cases: list[RecordingCase], options: argparse.Namespace
) -> list[Parameter]:
    """The numbers to learn."""
    kinds = [case.recording.streams[name].rows.kind for case in cases for name in case.use]
    everything = learnable(document, kinds, alike=options.alike)
    chosen = [p for p in everything if not options.only or _matches(p.label, options.only)]
    for words in options.only or ():
        if everything and not any(_matches(p.label, [words]) for p in everything):
            raise GlissandoError(
                f"--only {words!r} matches no number; the numbers are: "
                f"{'; '.join(p.label for p in everything)}."
            )
    if not chosen or _steps(options) < 1:
        raise GlissandoError(
            f"There is nothing to learn with --only {','.join(options.only or [])} and "
            f"--steps {_steps(options)}; the numbers are: "
            f"{'; '.join(p.label for p in everything)}."
        )
    return chosen


def _matches(label: str, only: list[str]) -> bool:
    """Whether a number's name contains all words of one of those asked for."""
    return any(all(word in label for word in words.split()) for words in only)


def _require_writable(options: argparse.Namespace) -> None:
    out = options.out
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise GlissandoError(f"--out {out} is no file in a folder that exists; give one.")
    if out.exists() and robot_file(options.robot).resolve() == out.resolve():
        raise GlissandoError(f"--out {out} is the file to start from; give another name.")
    require_spared("--out", out, *options.recordings)


def _case(recording: Recording, options: argparse.Namespace) -> RecordingCase:
    truth, held_out = options.truth or [], options.hold_out or []
    both = set(truth) & set(held_out)
    if both:
        raise RecordingError(f"{', '.join(sorted(both))} cannot be learned from and held out.")
    marked = recording.choose(None, None)[1]
    use, _ = recording.choose(options.use, list(dict.fromkeys([*truth, *held_out, *marked])))
    recording.choose([], [*truth, *held_out] or None)
    window = checked_window(recording, options.window)
    require_rows(recording, [*truth, *held_out, *(options.use or ())], window)
    return RecordingCase(recording, window, tuple(use), truth)


def _with_constants(result: Learned) -> Document:
    """The learned document with the constants of the truth as known sensor parameters."""
    document = dict(result.document)
    known = [
        {"name": c.name, "kind": c.kind, "streams": list(c.streams), "value": c.value.tolist()}
        for c in lasting(result.after.constants)
    ]
    replaced = [k["name"] for k in known]
    others = [u for u in document.get("sensor_parameters", []) if u["name"] not in replaced]
    if others or known:
        document["sensor_parameters"] = others + known
    return document


def _held_out(
    case: RecordingCase, document: Document, options: argparse.Namespace
) -> dict[str, Any]:
    """Errors against truth that was not learned from, of an estimate from the case's sensors."""
    robot, recording = parse_robot(Table(document, "learned", GlissandoError)), case.recording
    start, stop = checked_window(recording, options.window)
    times = {name: recording.stream(name).rows.time for name in case.use}
    use = [name for name, time in times.items() if np.any((time >= start) & (time <= stop))]
    run = run_estimate(recording, robot, window=(start, stop), use=use, truth=options.hold_out)
    return {"recording": recording.name, **pool(run.errors).summary()}


def _as_json(result: Learned, out: Path) -> dict[str, Any]:
    return {
        "out": str(out),
        "objective_before": result.before.value,
        "objective_after": result.after.value,
        "degrees_of_freedom": result.before.samples,
        "steps": result.steps,
        "parameters": [
            {
                "name": p.label,
                "value": p.of(result.document),
                "factor": math.exp(moved),
                "log_std": None if math.isinf(std) else std,
            }
            for p, moved, std in zip(result.parameters, result.moved, result.std, strict=True)
        ],
        "constants": [
            {"name": c.name, "kind": c.kind, "value": c.value.tolist()}
            for c in result.after.constants
        ],
    }


def _parameters_of(document: Document) -> tuple[SensorParameter, ...]:
    """The sensor parameters of a robot file."""
    return parse_robot(Table(document, "learned", GlissandoError)).sensor_parameters


def _print(result: Learned, report: dict[str, Any], std: dict[str, Array]) -> None:
    console = Console()
    table = number_table("What was learned", ("value", "times", "known within"), left=("number",))
    for p in report["parameters"]:
        within = "–" if p["log_std"] is None else f"× {math.exp(min(p['log_std'], 20.0)):.3g}"
        table.add_row(p["name"], f"{p['value']:.4g}", f"{p['factor']:.3g}", within)
    console.print(table)
    constants = [
        *result.after.constants,
        *(p for p in _parameters_of(result.document) if p.name in std),
    ]
    for c in constants:
        text = parameter_text(c.kind, c.value.tolist(), std.get(c.name, 0.0 * c.value).tolist())
        left = " (of this recording, not written)" if c.kind == "time_offset" else ""
        console.print(f"  {c.name} ({c.kind}): {text}{left}", markup=False)
    windows = "; ".join(f"{start:g} to {stop:g} s" for start, stop in report["windows"])
    console.print(f"Learned from {windows}")
    console.print(
        f"{result.steps} steps; log-likelihood a degree of freedom {result.before.value:.4f} → "
        f"{result.after.value:.4f} ({result.before.samples:,} of them)"
    )
    if held_out := report.get("held_out"):
        headings = "position (mm)", "rotation (deg)", "NEES / dof", "inside 95 %"
        table = number_table("Truth that was held out", headings, left=("file",))
        for held in held_out:
            table.add_row(held["file"], *_held_out_cells(held))
        console.print(table)
    console.print(f"Wrote {report['out']}", markup=False)


def _held_out_cells(held: dict[str, Any]) -> list[str]:
    """Errors of a stream that was held out, as a table shows them; what it does not read is –."""
    forms = {
        "position_rmse": (1e3, "{:.2f}"), "rotation_rmse": (math.degrees(1.0), "{:.2f}"),
        "nees_position": (1.0, "{:.2f}"), "coverage95_position": (100.0, "{:.1f} %"),
    }  # fmt: skip
    return [
        "–" if held[key] is None else form.format(scale * held[key])
        for key, (scale, form) in forms.items()
    ]
