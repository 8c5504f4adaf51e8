"""`glissando simulate`: simulation of a robot and imperfect sensors, written as a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from shlex import quote

from glissando.cli.outputs import require_writable
from glissando.cli.progress import working
from glissando.cli.shared import Commands, add_command, names
from glissando.errors import SimulationError
from glissando.io.atomic import require_new
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file, shipped_robots
from glissando.model.tendons.channel import Channel
from glissando.simulation.imperfections import PARTS
from glissando.simulation.simulate import simulate
from glissando.simulation.simulated_session import write_session

_HELP = """\
Simulate a tendon-driven robot with a sliding coil, and write what its sensors would record.

The robot's shapes are static Cosserat rods, so slow motions only; with --dynamic it has inertia and
damping, and gyroscopes, accelerometer_*.csv, truth.csv and loads.csv are written, too. The coil
reports five degrees of freedom with noise, bias that depends on place, drop-outs, and the slide's
own errors; motion capture stands beside as truth. The folder is estimated like any other recording.
"""
_EXAMPLES = """\
examples:
  glissando simulate --shape S --slide oscillate --out s_oscillating
  glissando estimate s_oscillating --out results
  glissando simulate --shape C --slide hold --at 0.06 --without bias,dropouts --out c_fixed
  glissando simulate --shape C-to-S --slide traverse --speed 0.1 --seed 7 --out moving
  glissando simulate --dynamic --shape C --slide traverse --out swinging
  glissando simulate --shape C --slide traverse --channel 0.004,0.5 --out beside
  glissando simulate --shape my_shape.toml --slide my_path.csv --out mine

A shape file is TOML: tensions = [10, 20] in newtons, or one such row for each of time = [0, 20];
gravity = [0, 0, 9.81] and [[loads]] with arclength, force and moment may follow. A slide file is
CSV: time,displacement (at rest at each row), or time,displacement,speed; arclength may stand in the
place of displacement, as `glissando plan` writes it.

With --dynamic the file may also have displacements (m) and tendon_stiffness (N/m) in the place of
tensions, `from` and `until` (s) in [[loads]], [[half_spaces]] (point, normal, stiffness in N/m²,
damping, friction), [[holds]] (arclength, stiffness in N/m, damping, place), and [base] (time,
positions in m, rotations in rad).

exit status: 0 done; 1 the physics has no static shape there; 2 something given was wrong.
"""


def add_channel(parser: argparse.ArgumentParser) -> None:
    """Add the option for the channel in which the simulated coil slides."""
    metres = "the coil slides in a channel beside the backbone: m, rad, and m a turn if it winds"
    parser.add_argument("--channel", type=channel, metavar="RADIUS,ANGLE[,PITCH]", help=metres)


def channel(text: str) -> Channel:
    """Parse RADIUS,ANGLE[,PITCH], in m, rad and m a turn, as a channel.

    >>> channel("0.004,0.5")
    Channel(radius=0.004, angle=0.5, pitch=inf)
    """
    try:
        return Channel(*map(float, text.split(",")))
    except (TypeError, ValueError) as problem:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a channel; give RADIUS,ANGLE or RADIUS,ANGLE,PITCH. {problem}"
        ) from None


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "simulate", texts, _simulate)
    add = parser.add_argument
    robots = "robot file with [physics], of `robot new --physics` or your own (default sliding700)"
    add("--robot", default="sliding700", metavar="FILE|NAME", help=robots)
    add("--shape", default="S", metavar="NAME|FILE", help="straight, C, S, C-to-S or a TOML file")
    slides = "hold, oscillate, traverse (a stage as long as the robot) or a CSV file"
    add("--slide", default="oscillate", metavar="NAME|FILE", help=slides)
    add("--cycles", type=int, metavar="N", help="there and back (default 3; traverse 1)")
    add("--stroke", type=float, metavar="M", help="of a cycle (default: the stage's)")
    add("--speed", type=float, metavar="M/S", help="of the slide (default: the stage's)")
    add("--at", type=float, metavar="M", help="displacement of hold, from the tip (default 0)")
    add("--duration", type=float, metavar="S", help="seconds (default: until at rest; hold 15)")
    add("--dynamic", action="store_true", help="a robot with inertia, which swings")
    parts = ", ".join((*PARTS, "all"))
    add("--without", type=names, default=[], metavar="NAME,…", help=f"switch off: {parts}")
    add_channel(parser)
    add("--tendons", action="store_true", help="record displacements of the tendons, too")
    add("--seed", type=int, default=0, metavar="N", help="of all noise (default 0)")
    add("--out", type=Path, required=True, metavar="RECORDING", help="folder to write")


def _simulate(options: argparse.Namespace) -> int:
    file = robot_file(options.robot)
    load_robot(file)  # raises for a file that cannot be estimated
    require_writable(options.out.parent)
    require_new(options.out, SimulationError)
    given = {name: getattr(options, name) for name in ("at", "cycles", "stroke", "speed")}
    with working("simulating"):
        session = simulate(
            options.robot,
            shape=options.shape,
            slide=options.slide,
            seed=options.seed,
            duration=options.duration,
            without=options.without,
            dynamic=options.dynamic,
            name=options.out.resolve().name,
            tendons=options.tendons,
            channel=options.channel,
            **{name: value for name, value in given.items() if value is not None},
        )
    shipped = options.robot in shipped_robots()
    write_session(session, options.out, options.robot if shipped else file, seed=options.seed)
    rows, lasts = len(session.coil.time), session.duration
    print(
        f"Wrote {options.out}: {lasts:.3g} s, {rows} readings of the coil, {len(session.mocap)} "
        f"motion capture frames. Now: glissando estimate {quote(str(options.out))} --out results"
    )
    return 0
