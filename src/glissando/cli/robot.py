"""`glissando robot new`: a robot file with a broad prior, from a few physical numbers."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from shlex import quote

from glissando.cli.say import say
from glissando.cli.shared import Commands, add_command, names
from glissando.errors import GlissandoError
from glissando.io.atomic import write_text
from glissando.io.physics_template import physics_text
from glissando.io.robot_template import RobotOutline, robot_text

_HELP = """\
Write a commented robot file for a robot of one's own, with nothing learned: length, segments,
diameter, largest bend and sensors give broad numbers that keep confidence true. What is not given
is asked for on a terminal. With --physics `glissando simulate` can have the robot, too.

A sensor is a kind (pose, coil, position, orientation, gyro, strain, fbg), or KIND:STREAM for a
stream of a recording, whose mount, drift or delay is then estimated.
"""
_EXAMPLES = """\
examples:
  glissando robot new --length 0.4 --segments 2 --diameter 0.012 --bend 180 --sensors coil \\
      --out first.toml
  glissando robot new --length 0.466 --segments 2 --diameter 0.012 --bend 180 \\
      --sensors pose:aurora0,pose:aurora1,gyro:gyro_mid,gyro:gyro_ee --out mine.toml
  glissando robot new --length 0.3 --segments 1 --diameter 0.006 --bend 90 --sensors coil:coil \\
      --physics --out planned.toml
  glissando robot new --out asked.toml

exit status: 0 done; 2 something given was wrong.
"""
_RADIANS, _NEAR = 20.0, 0.01  # degrees; tolerance, turns, for angles probably in radians
_ASKED = {
    "length": "Length of the robot in metres",
    "segments": "Number of segments that are driven each on its own",
    "diameter": "Outer diameter in metres",
    "bend": "Largest bend of one segment in degrees",
    "sensors": "Sensors, separated by commas (such as coil, or pose:STREAM)",
}


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    parser = add_command(commands, "robot", (_HELP, _EXAMPLES), _robot)
    add = parser.add_argument
    add("action", choices=["new"], help="what to do")
    add("--length", type=float, metavar="M", help="length, m")
    add("--segments", type=int, metavar="N", help="segments of equal length")
    add("--diameter", type=float, metavar="M", help="outer diameter, m")
    add("--bend", type=float, metavar="DEG", help="largest bend of one segment, degrees")
    add("--sensors", type=names, metavar="KIND[:STREAM],…", help="what reads the robot")
    stretch = "largest stretch, or slip of discs, as a share of the length (default 0.05)"
    add("--stretch", type=float, default=0.05, metavar="SHARE", help=stretch)
    change = "seconds in which the shape can change altogether (default 0.5)"
    add("--time-scale", type=float, default=0.5, metavar="S", help=change)
    physics = "tubes, tendons and a stage that such a robot may have, too, to simulate it"
    add("--physics", action="store_true", help=physics)
    add("--out", type=Path, required=True, metavar="FILE", help="robot file to write, a new one")


def _robot(options: argparse.Namespace) -> int:
    out: Path = options.out
    if out.exists():
        raise GlissandoError(f"--out {out} is there already; give a new file.")
    if not out.absolute().parent.is_dir():
        raise GlissandoError(f"--out {out} is in no folder; make {out.absolute().parent} first.")
    answers = {key: getattr(options, key) for key in _ASKED}
    missing = [key for key, value in answers.items() if value is None]
    if missing and not sys.stdin.isatty():
        flags = ", ".join(f"--{key}" for key in missing)
        raise GlissandoError(f"A robot file needs {flags} as well.")
    for key in missing:
        answers[key] = _answer(key)
    turns = answers["bend"] / math.pi
    if 1.0 < answers["bend"] < _RADIANS and abs(turns - round(2.0 * turns) / 2.0) < _NEAR:
        raise GlissandoError(
            f"--bend {answers['bend']:g} is most likely in radians; give degrees: "
            f"{math.degrees(answers['bend']):.0f}."
        )
    outline = RobotOutline(
        name=out.stem,
        length=answers["length"],
        segments=answers["segments"],
        diameter=answers["diameter"],
        bend=math.radians(answers["bend"]),
        sensors=answers["sensors"],
        stretch=options.stretch,
        time_scale=options.time_scale,
    )
    physics = physics_text(outline) if options.physics else ""
    write_text(out, robot_text(outline) + physics)
    bare = [kind for kind in outline.sensors if ":" not in kind]
    if bare:
        say(
            f"{', '.join(bare)} {'name' if len(bare) > 1 else 'names'} no stream, so mounts and "
            f"drifts count as known: give KIND:STREAM for what may be mounted a little off."
        )
    robot = f"--robot {quote(str(out))}"
    estimate = f"estimate RECORDING {robot} --out results"
    simulated = f"simulate --shape C {robot} --out simulated"
    print(f"Wrote {out}. Now: glissando {simulated if physics else estimate}")
    return 0


def _answer(key: str) -> object:
    """Ask for an option on the terminal, and return the answer as the option's type."""
    text = input(f"{_ASKED[key]}: ").strip()
    if key == "sensors":
        return names(text)
    try:
        return int(text) if key == "segments" else float(text)
    except ValueError:
        raise GlissandoError(f"{text!r} is not a number; give {_ASKED[key].lower()}.") from None
