"""`glissando learn`: finds a robot file's numbers from recordings."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import tomli_w
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table as Grid

from glissando.calibration.robot.hyperparameters import Document, expanded, learnable
from glissando.calibration.robot.joint_calibration import lasting, locate
from glissando.calibration.robot.learn import Learned, RecordingCase, learn
from glissando.cli.shared import Commands, add_command, names
from glissando.errors import GlissandoError, RecordingError
from glissando.evaluation.metrics import pool
from glissando.evaluation.run import checked_window, run_estimate
from glissando.io.recording import Recording, load_recording
from glissando.io.robot_file import load_robot, parse_robot, robot_file
from glissando.io.toml_table import Table, read_document
from glissando.model.sensors.parameters import SensorParameter

_HELP = """\
Learn the numbers of a robot file from recordings: densities, time scale, strength by segment,
noise, drifts. Without truth, what makes the readings most likely (their evidence); with truth, what
foretells it best from the sensors alone: small errors and a confidence that is true. A number of
which the recordings say nothing stays near where it starts; a factor of three is expected.

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
    parser = add_command(commands, "learn", "learn a robot file from recordings", texts, _learn)
    add = parser.add_argument
    add("recordings", type=Path, nargs="+", metavar="RECORDING", help="folders of recordings")
    add("--robot", required=True, metavar="FILE|NAME", help="robot file to start from")
    add("--out", required=True, type=Path, metavar="FILE", help="robot file to write")
    add("--use", type=names, metavar="NAME,…", help="streams to use (default: all but truth)")
    add("--truth", type=names, metavar="NAME,…", help="streams to foretell (default: none)")
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
    add("--steps", type=int, default=20, metavar="N", help="steps at most (default: 20)")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _learn(options: argparse.Namespace) -> int:
    recordings = [load_recording(folder) for folder in options.recordings]
    load_robot(options.robot)  # which says what is wrong with it
    document = expanded(read_document(robot_file(options.robot)))
    _require_writable(options)
    truth = options.truth or []
    for flag in ("calibrate", "joint"):
        if getattr(options, flag) and not truth:
            raise GlissandoError(
                f"--{flag} finds where the truth is mounted: name it with --truth."
            )
    if options.calibrate and options.joint:
        raise GlissandoError("--joint and --calibrate find the same constants; give one of them.")
    cases = [_case(recording, options, truth) for recording in recordings]
    kinds = [
        r.streams[name].rows.kind for r, c in zip(recordings, cases, strict=True) for name in c.use
    ]
    parameters = everything = learnable(document, kinds, alike=options.alike)
    if options.only:
        parameters = [p for p in parameters if _meant(p.label, options.only)]
    if not parameters or options.steps < 1:
        raise GlissandoError(
            f"There is nothing to learn with --only {','.join(options.only or [])} and "
            f"--steps {options.steps}; the numbers are: "
            f"{'; '.join(p.label for p in everything)}."
        )
    constants: tuple[SensorParameter, ...] = ()
    if options.joint:
        document, constants = locate(document, recordings[0], cases[0].window, cases[0].use, truth)
    with _watched(options.steps) as (progress, task):
        found = learn(
            document,
            parameters,
            cases,
            calibrate=options.calibrate,
            constants=constants,
            steps=options.steps,
            watch=lambda step, value: progress.update(
                task, completed=step, description=f"learning: {value:.4f} a degree of freedom"
            ),
        )
    written = _with_constants(found)
    options.out.write_text(_HEADER.format(options.robot) + tomli_w.dumps(written), encoding="utf-8")
    told = _as_json(found, options.out)
    if options.hold_out:
        told["held_out"] = [
            {"file": name, **_held_out(recording, file, options)}
            for recording in recordings
            for name, file in (("before", document), ("after", written))
        ]
    if options.json:
        print(json.dumps(told))
    else:
        _print(found, told, options.out)
    return 0


def _meant(label: str, only: list[str]) -> bool:
    """Whether a number's name holds all words of one of those asked for."""
    return any(all(word in label for word in words.split()) for words in only)


_HEADER = "# Learned from recordings, beginning with {}; comments of that file are not kept.\n"


class _watched:  # noqa: N801 - reads as a word
    """A progress bar on stderr."""

    def __init__(self, steps: int) -> None:
        console = Console(stderr=True)
        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            TimeElapsedColumn(),
        )
        self._bar = Progress(
            *columns, console=console, transient=True, disable=not console.is_terminal
        )
        self._steps = steps

    def __enter__(self) -> tuple[Progress, Any]:
        self._bar.start()
        return self._bar, self._bar.add_task("learning", total=self._steps)

    def __exit__(self, *_: object) -> None:
        self._bar.stop()


def _require_writable(options: argparse.Namespace) -> None:
    out = options.out
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise GlissandoError(f"--out {out} is no file in a folder that exists; give one.")
    if out.exists() and robot_file(options.robot).resolve() == out.resolve():
        raise GlissandoError(f"--out {out} is the file to start from; give another name.")


def _case(recording: Recording, options: argparse.Namespace, truth: list[str]) -> RecordingCase:
    held = options.hold_out or []
    both = set(truth) & set(held)
    if both:
        raise RecordingError(f"{', '.join(sorted(both))} cannot be learned from and held out.")
    marked = recording.choose(None, None)[1]
    use, _ = recording.choose(options.use, list(dict.fromkeys([*truth, *held, *marked])))
    recording.choose([], truth or None)
    return RecordingCase(recording, checked_window(recording, options.window), tuple(use), truth)


def _with_constants(found: Learned) -> Document:
    """The learned document with the constants of the truth as known unknowns."""
    document = dict(found.document)
    known = [
        {"name": c.name, "kind": c.kind, "streams": list(c.streams), "value": c.value.tolist()}
        for c in lasting(found.after.constants)
    ]
    kept = [u for u in document.get("unknowns", []) if u["name"] not in [k["name"] for k in known]]
    if kept or known:
        document["unknowns"] = kept + known
    return document


def _held_out(
    recording: Recording, document: Document, options: argparse.Namespace
) -> dict[str, Any]:
    """Errors against truth that was not learned from."""
    robot = parse_robot(Table(document, "learned", GlissandoError))
    run = run_estimate(
        recording, robot, window=options.window, use=options.use, truth=options.hold_out
    )
    return {"recording": recording.name, **pool(run.errors).summary()}


def _as_json(found: Learned, out: Path) -> dict[str, Any]:
    return {
        "out": str(out),
        "objective_before": found.before.value,
        "objective_after": found.after.value,
        "degrees_of_freedom": found.before.samples,
        "steps": found.steps,
        "parameters": [
            {
                "name": p.label,
                "value": p.of(found.document),
                "factor": math.exp(moved),
                "log_std": None if math.isinf(std) else std,
            }
            for p, moved, std in zip(found.parameters, found.moved, found.std, strict=True)
        ],
        "constants": [
            {"name": c.name, "kind": c.kind, "value": c.value.tolist()}
            for c in found.after.constants
        ],
    }


def _print(found: Learned, told: dict[str, Any], out: Path) -> None:
    console = Console()
    table = Grid(title="What was learned", title_justify="left")
    table.add_column("number")
    for heading in ("value", "times", "known within"):
        table.add_column(heading, justify="right", no_wrap=True)
    for p in told["parameters"]:
        sure = "–" if p["log_std"] is None else f"× {math.exp(min(p['log_std'], 20.0)):.3g}"
        table.add_row(p["name"], f"{p['value']:.4g}", f"{p['factor']:.3g}", sure)
    console.print(table)
    for c in found.after.constants:
        console.print(f"  {c.name}: " + ", ".join(f"{v:.4g}" for v in c.value), markup=False)
    console.print(
        f"{found.steps} steps; log-likelihood a degree of freedom {found.before.value:.4f} → "
        f"{found.after.value:.4f} ({found.before.samples:,} of them)"
    )
    for held in told.get("held_out", []):
        console.print(f"held out, {held['file']}: {json.dumps(held)}", markup=False)
    console.print(f"Wrote {out}", markup=False)
