"""`glissando import`: other people's files become a recording."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from glissando.cli.shared import (
    Commands,
    add_command,
    findings_in,
    names,
    require_writable,
    warn,
)
from glissando.errors import GlissandoError, RecordingError
from glissando.io.atomic_folder import require_new
from glissando.io.foreign import Choices, read_tracks, write_recording

_HELP = """\
Bring files of motion capture and trackers into a recording folder that every command takes.

Known are CSV of Vicon Tracker (helical rotations) and of Nexus, CSV of NDI Track and ToolBox, c3d,
ROS 1 bags and folders of ROS 2 bags. A file does not say where on the robot its objects sit:
--arclength does, and objects without one are left out.
"""
_EXAMPLES = """\
examples:
  glissando import take3.csv --rate 100 --arclength tip=0.7,mid=0.35 --out take3
  glissando import aurora.csv take3.csv --rate aurora.csv=40,take3.csv=100 --shift tip=-0.25 \\
      --arclength coil=path.csv,tip=0.7 --truth tip --robot sliding700 --out both
  glissando import run.bag --topic /vicon/tip --arclength vicon_tip=0.7 --out run

A sensor that slides takes a CSV file, columns time,arclength, in the place of its arclength. What
an NDI file holds is in the tracker's frame: fill in [frames.tracker] of recording.toml.

exit status: 0 done; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add the command to the parser's."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "import", texts, _import)
    add = parser.add_argument
    add("files", type=Path, nargs="+", metavar="FILE", help="files or folders of one session")
    add("--out", type=Path, required=True, metavar="RECORDING", help="folder to write")
    add("--rate", default="", metavar="HZ|FILE=HZ,…", help="frame rate, where a file has none")
    add("--arclength", default="", metavar="NAME=M|FILE,…", help="where each object sits")
    add("--robot", metavar="FILE|NAME", help="robot that the recording names")
    add("--truth", type=names, default=[], metavar="NAME,…", help="objects to judge by")
    add("--shift", default="", metavar="NAME=S,…", help="seconds added to an object's times")
    add("--kind", default="", metavar="NAME=KIND,…", help="pose or coil (NDI tools: coil)")
    add("--topic", type=names, default=[], metavar="NAME,…", help="of a bag (default: all poses)")


def _import(options: argparse.Namespace) -> int:
    arclength = {name: _place(text) for name, text in pairs(options.arclength).items()}
    shift = {name: number("--shift", text) for name, text in pairs(options.shift).items()}
    choices = Choices(arclength, options.truth, shift, pairs(options.kind), options.robot)
    rates = _rates(options.rate, options.files)
    require_writable(options.out.parent)
    require_new(options.out, RecordingError)
    tracks = []
    for file in options.files:
        tracks += read_tracks(file, rate=rates.get(file.name), topics=options.topic)
    for line in write_recording(tracks, options.out, choices):
        print(line)
    print(f"Wrote {options.out}. Now: glissando estimate {options.out} --out results")
    warn(findings_in(options.out))
    return 0


def pairs(text: str) -> dict[str, str]:
    """The values by name in `NAME=VALUE,…`.

    Raises:
        GlissandoError: A part is no NAME=VALUE.
    """
    values = {}
    for part in names(text):
        name, equals, value = part.partition("=")
        if not equals or not name or not value:
            raise GlissandoError(f"{part!r} is no NAME=VALUE; write them with commas between.")
        values[name.strip()] = value.strip()
    return values


def number(option: str, text: str) -> float:
    """A finite number of an option.

    Raises:
        GlissandoError: The text is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise GlissandoError(f"{option} {text!r} is not a number; give one.")
    return value


def _place(text: str) -> float | Path:
    if Path(text).is_file():
        return Path(text)
    return number("--arclength, where it is no file,", text)


def _rates(text: str, files: list[Path]) -> dict[str, float]:
    """Rate of each file by its name."""
    if "=" not in text:
        return {f.name: number("--rate", text) for f in files} if text else {}
    rates = {name: number("--rate", value) for name, value in pairs(text).items()}
    known = [file.name for file in files]
    for name in rates:
        if name not in known:
            raise GlissandoError(f"--rate names {name!r}; the files are {', '.join(known)}.")
    return rates
