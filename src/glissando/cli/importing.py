"""`glissando import`: files of other programs are written as a recording."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from shlex import quote

import numpy as np

from glissando.cli.outputs import require_writable, stated
from glissando.cli.shared import Commands, add_command, chosen_robot, findings_in, names, warn
from glissando.cli.unused_options import refuse_unused
from glissando.errors import GlissandoError, RecordingError
from glissando.evaluation.foreign_estimate import (
    estimate_of_tracks,
    foreign_report,
    read_estimate,
)
from glissando.io.atomic import require_new
from glissando.io.foreign import Choices, read_tracks, write_recording
from glissando.io.foreign.kinds import is_bag
from glissando.io.foreign.servo_csv import MARKER
from glissando.io.foreign.tracks import Track
from glissando.io.provenance import write_report
from glissando.io.recording import Recording
from glissando.io.recording_folder import load_recording

_HELP = """\
Bring files of motion capture and trackers into a recording folder that every command takes.

Known are CSV of Vicon Tracker (helical rotations) and of Nexus, of NDI Track and ToolBox, of
OptiTrack Motive; TSV of Qualisys; .tum, c3d, ROS 1 bags and folders of ROS 2 bags; CSV of servos
that pull tendons with the position of a marker (timestamp, servo_<id>_mm, tip_x, tip_y, tip_z), of
which --robot names a file with [tendons]. Any other delimited text is read with --columns.
Semicolons, tabs and decimal commas are understood. A file does not say where on the robot its
objects sit: --arclength does, and objects without one are left out.
"""
_EXAMPLES = """\
examples:
  glissando import take3.csv --rate 100 --arclength tip=0.7,mid=0.35 --out take3
  glissando import aurora.csv take3.csv --rate aurora.csv=40,take3.csv=100 --shift tip=-0.25 \\
      --arclength coil=path.csv,tip=0.7 --truth tip --robot sliding700 --out both
  glissando import log.txt --columns time=1,x=2,y=3,z=4,length=mm --arclength log=0.7 --out log
  glissando import gyro.csv --columns 'time=t [ms],clock=ms,wx=gx,wy=gy,wz=gz,angle=deg' \\
      --arclength gyro=0.4 --out gyro
  glissando import theirs.csv --estimate my_recording --out theirs    # then: glissando report
  glissando import v4_train.csv --robot v4.toml --arclength tip=0.1865 --truth tip --out v4
  glissando import run.bag --topic /vicon/tip --arclength vicon_tip=0.7 --out run

A sensor that slides takes a file in the place of its arclength, with the columns time,arclength or
those that --columns FILE:time=…,travel=…,zero=M says. What an NDI file holds is in the tracker's
frame, which `glissando calibrate` finds.

Keys of --columns: time or count (of frames); x,y,z; qw,qx,qy,qz or rx,ry,rz or a1,a2,a3 with euler;
wx,wy,wz and other sensors' columns; clock=ms, length=mm, angle=deg, frame=tracker.

exit status: 0 done; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "import", texts, _import)
    add = parser.add_argument
    add("files", type=Path, nargs="+", metavar="FILE", help="files or folders of one session")
    add("--out", type=Path, required=True, metavar="RECORDING", help="folder to write")
    add("--rate", default="", metavar="HZ|FILE=HZ,…", help="frame rate, where a file has none")
    columns = "what the columns of any other text hold, or a TOML file that says it"
    metavar = "[FILE:]KEY=COLUMN,…"
    judged = (
        "the files are somebody's estimate: judge it by this recording's truth, as a run in --out"
    )
    add("--estimate", type=Path, metavar="RECORDING", help=judged)
    add("--columns", action="append", default=[], metavar=metavar, help=columns)
    add("--arclength", default="", metavar="NAME=M|FILE,…", help="where each object sits")
    add("--robot", metavar="FILE|NAME", help="robot that the recording names")
    add("--truth", type=names, default=[], metavar="NAME,…", help="objects to judge by")
    add("--shift", default="", metavar="NAME=S,…", help="seconds added to an object's times")
    add("--kind", default="", metavar="NAME=KIND,…", help="pose or coil (NDI tools: coil)")
    add("--topic", type=names, default=[], metavar="NAME,…", help="of a bag (default: all poses)")


def _import(options: argparse.Namespace) -> int:
    if options.estimate:
        return _import_estimate(options)
    arclength = {name: _arclength_or_path(text) for name, text in pairs(options.arclength).items()}
    shift = {name: number("--shift", text) for name, text in pairs(options.shift).items()}
    rates = _rates(options.rate, options.files)
    paths = [place for place in arclength.values() if isinstance(place, Path)]
    mappings = _mappings(options.columns, options.files, paths)
    if not any(map(is_bag, options.files)):
        refuse_unused(options, "files that are not bags", "topic")
    kinds = pairs(options.kind)
    choices = Choices(arclength, options.truth, shift, kinds, options.robot, mappings)
    require_writable(options.out.parent)
    require_new(options.out, RecordingError)
    tracks = []
    for file in options.files:
        rate, columns = rates.get(file.name), mappings.get(file.name, "")
        tracks += read_tracks(file, rate=rate, topics=options.topic, columns=columns)
    for line in write_recording(tracks, options.out, choices):
        print(line)
    recording = load_recording(options.out)
    print(f"Wrote {options.out}. {_next(options.out, recording, bool(choices.truth))}")
    if not recording.unknown_frames:
        warn(findings_in(options.out))
    return 0


def _import_estimate(options: argparse.Namespace) -> int:
    """Write the report of an estimate of another program, which `glissando report` reads."""
    refuse_unused(options, "--estimate", "shift", "kind", "topic")
    if not options.arclength:
        refuse_unused(options, "--estimate without --arclength", "rate", "columns")
    require_writable(options.out)
    require_new(options.out, GlissandoError)
    recording = load_recording(options.estimate)
    robot = chosen_robot(recording, options.robot)
    names_of_files = ", ".join(file.name for file in options.files)
    if options.arclength:
        places = {name: number("--arclength", at) for name, at in pairs(options.arclength).items()}
        rates = _rates(options.rate, options.files)
        mappings = _mappings(options.columns, options.files, [])
        tracks: list[Track] = []
        for file in options.files:
            rate, columns = rates.get(file.name), mappings.get(file.name, "")
            tracks += read_tracks(file, rate=rate, columns=columns)
        estimate = estimate_of_tracks(tracks, places)
    elif len(options.files) == 1:
        estimate = read_estimate(options.files[0])
    else:
        raise GlissandoError("Give one file with a column arclength, or --arclength NAME=M,…")
    truth = recording.choose([], options.truth or None)[1]
    judges = recording.readings(truth, robot, recording.span(), as_truth=True)[0]
    report = foreign_report(names_of_files, estimate, recording, robot, judges)
    write_report(options.out / "report.json", report | stated(options, robot))
    overall, judged = report["overall"], ", ".join(s["name"] for s in report["sites"])
    if overall["position_rmse"] is None:  # orientations alone
        rmse = f"{math.degrees(overall['rotation_rmse']):.2f}°"
    else:
        rmse = f"{1e3 * overall['position_rmse']:.2f} mm"
    for name, lost in report["dropped"].items():
        counts = ", ".join(f"{count} {why}" for why, count in lost.items())
        print(f"{name}: {counts}, not judged")
    print(f"Wrote {options.out}: {rmse} RMSE against {judged}.")
    print(f"Now: glissando report RUN {quote(str(options.out))}")
    return 0


def _next(folder: Path, recording: Recording, truth: bool) -> str:
    """Sentence with the next command for an imported recording."""
    given = quote(str(folder))
    unknown, used = sorted(recording.unknown_frames), recording.choose(None, None)[0]
    if not unknown and {recording.streams[name].rows.kind for name in used} == {"tendon"}:
        if MARKER not in recording.streams:
            return (
                f"To learn from its tendons, import again with --arclength {MARKER}=METRES, where "
                f"on the robot the marker sits."
            )
        robot = quote(str(folder / "robot.toml"))
        return f"Now: glissando learn {given} --robot {robot} --out learned.toml"
    if not unknown:
        return f"Now: glissando estimate {given} --out results"
    where = f"Where the frame {' and '.join(unknown)} is in the world is not known"
    if truth:
        coils = [name for name in used if recording.streams[name].frame in unknown]
        first = max(coils, key=lambda name: np.ptp(recording.streams[name].rows.arclength))
        which = f" --coil {quote(first)}" if len(coils) > 1 else ""
        return f"{where}. Now: glissando calibrate {given}{which}"
    file = folder / "recording.toml"
    return f"{where}: state it in {file}, or import motion capture with --truth."


def _mappings(given: list[str], files: list[Path], paths: list[Path]) -> dict[str, str]:
    """Mapping of columns of each file, by its name; one without a name applies to all files."""
    known = [file.name for file in (*files, *paths)]
    out: dict[str, str] = {}
    for text in given:
        name, colon, mapping = text.partition(":")
        if not colon:
            out |= dict.fromkeys([file.name for file in files], text)
        elif name not in known:
            raise GlissandoError(f"--columns names {name!r}; the files are {', '.join(known)}.")
        else:
            out[name] = mapping
    return out


def pairs(text: str) -> dict[str, str]:
    """Parse `NAME=VALUE,…` into values by name.

    Raises:
        GlissandoError: A part is not of the form NAME=VALUE.
    """
    values = {}
    for part in names(text):
        name, equals, value = part.partition("=")
        if not equals or not name or not value:
            raise GlissandoError(f"{part!r} is not NAME=VALUE; write them with commas between.")
        values[name.strip()] = value.strip()
    return values


def number(option: str, text: str) -> float:
    """Parse the text of an option as a finite number.

    Raises:
        GlissandoError: The text is not a finite number.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise GlissandoError(f"{option} {text!r} is not a number; give one.")
    return value


def _arclength_or_path(text: str) -> float | Path:
    if Path(text).is_file():
        return Path(text)
    return number("--arclength, if it is not a file,", text)


def _rates(text: str, files: list[Path]) -> dict[str, float]:
    """Rate, Hz, of each file, by its name."""
    if "=" not in text:
        return {f.name: number("--rate", text) for f in files} if text else {}
    rates = {name: number("--rate", value) for name, value in pairs(text).items()}
    known = [file.name for file in files]
    for name in rates:
        if name not in known:
            raise GlissandoError(f"--rate names {name!r}; the files are {', '.join(known)}.")
    return rates
