"""`glissando learn`: hyperparameters of a robot file, learned from recordings."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np

from glissando.calibration.robot.case import RecordingCase
from glissando.calibration.robot.hyperparameters import Document, Parameter, expanded, learnable
from glissando.calibration.robot.joint_calibration import lasting, locate, without_constants
from glissando.calibration.robot.learn import End, Learned, learn
from glissando.calibration.robot.predictive import Start
from glissando.cli.learn_judgement import judged, warn_of_confidence, with_rows
from glissando.cli.learn_report import as_json, print_report, steps_of
from glissando.cli.learn_tendons import is_of_tendons, learn_from_tendons
from glissando.cli.outputs import LEARNED, require_replaceable, require_writable, write_robot
from glissando.cli.progress import working
from glissando.cli.say import say
from glissando.cli.shared import Commands, add_command, names, warn
from glissando.errors import GlissandoError, RecordingError
from glissando.evaluation.plausibility.examine import examine_recording
from glissando.evaluation.plausibility.finding import refuse
from glissando.evaluation.run import checked_window, chosen_streams, require_rows
from glissando.geometry.se3 import Array
from glissando.io.recording import Recording
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot, parse_robot, read_robot_document
from glissando.io.shipped_robots import robot_file
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.table import Table

_STEPS = 20  # default of --steps
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

exit status: 0 done; 2 something given was wrong, or the search broke off: what it had found by then
is written.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "learn", texts, _learn)
    add = parser.add_argument
    add("recordings", type=Path, nargs="+", metavar="RECORDING", help="folders of recordings")
    add("--robot", required=True, metavar="FILE|NAME", help="robot file to start from")
    add("--out", required=True, type=Path, metavar="FILE", help="robot file to write")
    add("--use", type=names, metavar="NAME,…", help="streams to use (default: all but truth)")
    add("--truth", type=names, metavar="NAME,…", help="streams to predict (default: none)")
    judges = "truth to judge by, never learned from (default: without --truth, what is marked)"
    add("--hold-out", type=names, metavar="NAME,…", help=judges)
    calibrate = "find the frame of the truth and the mounts of its bodies, and write them as known"
    add("--calibrate", action="store_true", help=calibrate)
    joint = "find them first, with the mounts of uncertain sensors, from sensors and truth at once"
    add("--joint", action="store_true", help=joint)
    add("--window", nargs=2, type=float, metavar=("T0", "T1"), help="seconds to learn from")
    only = "learn only numbers whose names hold all words of one of these (default: all)"
    add("--only", type=names, metavar="WORDS,…", help=only)
    alike = "segments are built alike: scale what each has together"
    add("--alike", action="store_true", help=alike)
    allowed = "checks of plausibility to leave out, of those that a refusal names"
    add("--allow", type=names, default=[], metavar="NAME,…", help=allowed)
    add("--steps", type=int, metavar="N", help=f"steps at most (default: {_STEPS})")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _learn(options: argparse.Namespace) -> int:
    recordings = [load_recording(folder) for folder in options.recordings]
    robot = load_robot(options.robot)  # raises if it is invalid
    document = expanded(read_robot_document(robot_file(options.robot)))
    document.pop("tube", None)  # it was calibrated for the initial file
    _require_writable(options)
    if is_of_tendons(recordings, options):
        return learn_from_tendons(recordings, document, options)
    _require_one_calibration(options)
    if options.calibrate or options.joint:
        document = without_constants(document, options.truth)
        robot = parse_robot(Table(document, "learned", GlissandoError))
    cases = [_case(recording, options).while_moving(robot) for recording in recordings]
    for case in cases:
        _examine(case, robot, options)
    initial, result, std_constants = _learn_numbers(document, cases, options)
    written = _with_constants(result)
    write_robot(written, options.robot, options.out)
    report = as_json(result, options.out) | {"windows": [case.window for case in cases]}
    judgement_error = ""
    if result.end not in (End.INTERRUPTED, End.BROKEN):
        files = {"before": initial, "after": written}
        try:
            with working("judging what was learned"):
                report["held_out"] = judged(files, cases, options)
        except GlissandoError as problem:  # the learned file stays valid
            judgement_error = str(problem)
    if options.json:
        print(json.dumps(report))
    else:
        print_report(result, report, std_constants)
    warn_of_confidence(report, options)
    return _exit_status(result, judgement_error, options)


def _learn_numbers(
    document: Document, cases: list[RecordingCase], options: argparse.Namespace
) -> tuple[Document, Learned, dict[str, Array]]:
    """Initial document, result of learning, and std (6,) of each constant located before."""
    parameters = _parameters(document, cases, options)
    constants: tuple[SensorParameter, ...] = ()
    std: dict[str, Array] = {}
    start: Start | None = None
    with working("learning") as work:
        if options.joint:
            work.begin("finding frames and mounts")
            cases = _longest_first(cases)
            first = cases[0]
            document, constants, std, start = locate(
                document, first.recording, first.window, first.use, options.truth
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
    return document, result, std


def _longest_first(cases: list[RecordingCase]) -> list[RecordingCase]:
    """Cases with the one of most rows of truth, in which constants are located, moved first."""

    def rows(case: RecordingCase) -> int:
        times = (case.recording.stream(name).rows.time for name in case.predict)
        return sum(int(np.sum((case.window[0] <= t) & (t <= case.window[1]))) for t in times)

    longest = max(range(len(cases)), key=lambda i: rows(cases[i]))
    if len(cases) > 1:
        say(
            f"glissando: frames and mounts are found in {cases[longest].recording.name} alone; "
            f"truth of the other recordings counts as on time."
        )
    return [cases[longest], *cases[:longest], *cases[longest + 1 :]]


def _exit_status(result: Learned, judgement_error: str, options: argparse.Namespace) -> int:
    """Print warnings about the search on stderr, and return the exit status."""
    if result.at_bounds:
        numbers = "; ".join(result.at_bounds)
        say(
            f"glissando: warning: as far as a number may go from its start, a factor of ten "
            f"thousand, went: {numbers}. Learn on from {options.out} if that is plausible."
        )
    if result.end is not End.SETTLED:
        say(
            f"glissando: the search ended after {steps_of(result)}: {result.end.value}. "
            f"{options.out} holds what was learned."
        )
    if judgement_error:
        say(
            f"glissando: {options.out} holds what was learned, but the truth that was held out "
            f"cannot be judged: {judgement_error}"
        )
    if result.end is End.INTERRUPTED:
        return 130
    return 2 if (judgement_error and options.hold_out) or result.end is End.BROKEN else 0


def _examine(case: RecordingCase, robot: Robot, options: argparse.Namespace) -> None:
    """Check the readings and truth of a case: raise for impossible data, warn of implausible."""
    use, truth = with_rows(case.use, case, case.window), [*case.predict, *(options.hold_out or ())]
    readings, references, _ = chosen_streams(case.recording, robot, case.window, use, truth)
    streams = readings, references, case.window, options.allow
    findings = examine_recording(case.recording, robot, *streams)
    refuse(findings)
    warn(findings)


def _require_one_calibration(options: argparse.Namespace) -> None:
    """Raise if both --calibrate and --joint are given, or one of them without --truth."""
    for flag in ("calibrate", "joint"):
        if getattr(options, flag) and not options.truth:
            raise GlissandoError(
                f"--{flag} finds where the truth is mounted: name it with --truth."
            )
    if options.calibrate and options.joint:
        raise GlissandoError("--joint and --calibrate find the same constants; give one of them.")


def _steps(options: argparse.Namespace) -> int:
    """Largest number of steps: --steps, or its default."""
    return _STEPS if options.steps is None else options.steps


def _parameters(
    document: Document, cases: list[RecordingCase], options: argparse.Namespace
) -> list[Parameter]:
    """Hyperparameters to learn; prints the kinds of sensor whose noise cannot be learned."""
    kinds, excluded = _kinds(document, cases)
    everything = learnable(document, kinds, alike=options.alike)
    for kind, why in excluded.items():
        if not options.only or _matches(f"{kind} noise", options.only):
            say(f"glissando: {kind} noise is not learned: {why}.")
    chosen = [p for p in everything if not options.only or _matches(p.label, options.only)]
    for words in options.only or ():
        if everything and not any(_matches(p.label, [words]) for p in everything):
            raise GlissandoError(
                f"--only {words!r} matches no number; the numbers are: "
                f"{'; '.join(p.label for p in everything)}."
            )
    if _steps(options) < 1:
        raise GlissandoError(f"--steps is {_steps(options)}; give 1 or more.")
    if not chosen:
        raise GlissandoError(
            f"There is nothing to learn with --only {','.join(options.only or [])}; the numbers "
            f"are: {'; '.join(p.label for p in everything)}."
        )
    return chosen


def _kinds(document: Document, cases: list[RecordingCase]) -> tuple[list[str], dict[str, str]]:
    """Kinds of sensor whose noise can be learned, and the reason for each other kind."""
    excluded: dict[str, str] = {}
    streams = [case.recording.streams[name] for case in cases for name in case.use]
    kinds = list(dict.fromkeys(stream.rows.kind for stream in streams))
    with_file_noise = {stream.rows.kind for stream in streams if stream.std is None}
    for kind in kinds:
        loss = document.get("sensors", {}).get(kind, {}).get("loss")
        if kind not in with_file_noise:
            excluded[kind] = "the recording states it"
        elif loss == "geman-mcclure" and not any(case.predict for case in cases):
            excluded[kind] = (
                f"with a loss that saturates ({loss}) less is always likelier; give huber, or truth"
            )
    return [kind for kind in kinds if kind not in excluded], excluded


def _matches(label: str, only: list[str]) -> bool:
    """Whether a label contains all words of one of the entries of --only."""
    return any(all(word in label for word in words.split()) for words in only)


def _require_writable(options: argparse.Namespace) -> None:
    out = options.out
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise GlissandoError(f"--out {out} is not a file in an existing folder; give one.")
    if out.exists() and robot_file(options.robot).resolve() == out.resolve():
        raise GlissandoError(f"--out {out} is the file to start from; give another name.")
    require_replaceable("--out", out, *options.recordings, begins=(LEARNED,))
    require_writable(out.absolute().parent)


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
    """The learned document with the constants of truth streams as known sensor parameters."""
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
