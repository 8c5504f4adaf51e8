"""`glissando predict`: states of a robot predicted from its tendon commands alone."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from glissando.cli.importing import number
from glissando.cli.outputs import require_writable
from glissando.cli.progress import working
from glissando.cli.say import say
from glissando.cli.shared import Commands, add_command, names
from glissando.errors import GlissandoError
from glissando.estimation.tendon_prediction import predict, predict_tip
from glissando.geometry.se3 import Array
from glissando.io.atomic import new_folder, require_new, write_table
from glissando.io.plain_file import file_stem
from glissando.io.query_csv import write_states
from glissando.io.robot_file import load_robot
from glissando.io.tendon_commands import read_tendon_commands
from glissando.model.tendons.tendons import Tendons

_HELP = """\
Predict pose, strain and velocity along a robot, with covariance, from the commands of its tendons.

The robot file has [tendons] and a mechanical prior; glissando learn finds their numbers. Commands
are a CSV file: time, and one column a tendon, named as [tendons] names says, or the stream of
tendons in a recording. Displacements are positive when pulled, in metres, or in millimetres in
columns whose names end in _mm.
"""
_EXAMPLES = """\
examples:
  glissando predict --robot learned.toml --tendons commands.csv --out predicted
  glissando predict --robot learned.toml --tendons commands.csv --arclength 0.1,0.18 --out predicted
  glissando predict --robot learned.toml --tendons commands.csv --stream tip --out predicted

DIR/query.csv has a row for each time and arclength, with the columns of glissando estimate --query,
in the robot's frame. With --stream DIR/marker_NAME.csv has what the tracker of a marker at the tip
would read, in the tracker's frame: time, x, y, z, and covariance with the marker's noise, in m².
The robot stands still at every time, nothing outside touches it, and its weight is left out.

exit status: 0 done; 1 the tendons leave no static shape; 2 something given was wrong.
"""

_SLOW = 10.0  # s between commands, above which times are probably in milliseconds
_PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")
_MARKER_COLUMNS = ("time", "x", "y", "z", *(f"cov_{pair}" for pair in _PAIRS))


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "predict", texts, _predict)
    add = parser.add_argument
    add("--robot", required=True, metavar="FILE|NAME", help="robot file with [tendons]")
    add("--tendons", required=True, type=Path, metavar="FILE", help="CSV of the commands")
    add("--arclength", type=names, metavar="M,…", help="where (default: the robot's nodes)")
    add("--stream", metavar="NAME", help="marker at the tip whose readings to predict, too")
    add("--out", required=True, type=Path, metavar="DIR", help="folder to write query.csv into")


def _unit_warnings(time: Array, displacement: Array, tendons: Tendons) -> Iterator[str]:
    """Warnings for times (M,), s, and displacements (M, T), m, probably given in other units."""
    std = tendons.std
    step = float(np.median(np.abs(np.diff(time)))) if time.size > 1 else 0.0
    if step > _SLOW:
        yield (
            f"Times of the commands are {step:g} s apart: if they are milliseconds, divide them by "
            f"1000, as velocities are wrong else."
        )
    most = float(np.abs(displacement).max())
    if 0.0 < most < std:
        yield (
            f"No displacement exceeds {1e3 * most:.2g} mm, less than what they are off by "
            f"({1e3 * std:.2g} mm, std of [tendons]): give metres, or millimetres where a column's "
            f"name ends in _mm."
        )


def _predict(options: argparse.Namespace) -> int:
    require_writable(options.out.parent)
    require_new(options.out, GlissandoError)
    robot = load_robot(options.robot)
    if robot.tendons is None:
        raise GlissandoError(
            f"Robot {robot.name!r} has no [tendons]; add this table to predict from tendons."
        )
    given = [number("--arclength", place) for place in options.arclength or ()]
    places = np.unique(given) if given else robot.arclength_nodes
    time, displacement = read_tendon_commands(options.tendons, robot.tendons.names)
    for doubt in _unit_warnings(time, displacement, robot.tendons):
        say(f"glissando: warning: {doubt}")
    marker = options.stream and file_stem(options.stream)
    placed = [p.streams for p in robot.sensor_parameters if p.kind in ("frame", "mount")]
    if marker and not any(marker in streams for streams in placed):
        raise GlissandoError(
            f"Robot {robot.name!r} states neither frame nor mount of a stream {marker!r}; give one "
            f"that its [[sensor_parameters]] name."
        )
    with working("predicting"):
        prediction = predict(robot, time, displacement, places)
    with new_folder(options.out, GlissandoError) as building:
        rows = ((np.full(places.size, t), places, prediction.take(k)) for k, t in enumerate(time))
        write_states(rows, building / "query.csv")
        if marker:
            place, cov = predict_tip(robot, displacement, marker)
            table = np.column_stack([time, place, cov[:, *np.triu_indices(3)]])
            write_table(building / f"marker_{marker}.csv", _MARKER_COLUMNS, table)
    tip = 1e3 * float(np.mean(prediction.std_position[:, -1]))
    print(
        f"Wrote {options.out / 'query.csv'}: {time.size} times at {places.size} arclengths; at "
        f"{places[-1]:g} m positions have a standard deviation of {tip:.3g} mm."
    )
    if marker:
        print(f"Wrote {options.out / f'marker_{marker}.csv'}: its readings in the tracker's frame.")
    return 0
