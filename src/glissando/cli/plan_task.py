"""Options that `plan` and `design` share: zones, objective, robot and stage."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence

from glissando.errors import GlissandoError, PlanWarning, RobotFileError, SimulationError
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file, shipped_robots
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.slide_path import SlideLimits
from glissando.planning.objectives import OBJECTIVES
from glissando.simulation.bench import load_bench

ROBOT = "sliding700"
"""Default robot."""

_AHEAD = 300.0  # longest horizon, s
_FASTEST, _SHARPEST = 2.0, 50.0  # largest speed, m/s, and acceleration, m/s², of a slide
_STREAM = "coil"  # default stream of the sliding sensor


def add_task(parser: argparse.ArgumentParser, *, zones_required: bool = True) -> None:
    """Add the options for robot, zones, horizon, objective and limits of the stage."""
    add = parser.add_argument
    robots = ", ".join(shipped_robots())
    add("--robot", default=ROBOT, metavar="FILE|NAME", help=f"robot file, or of {robots}")
    zone = "may be repeated"
    add("--zone", action="append", required=zones_required, metavar="S0:S1[@T0:T1]", help=zone)
    add("--horizon", type=float, default=10.0, metavar="S", help="seconds ahead (default 10)")
    stream = f"by which sensor parameters name the sliding sensor (default {_STREAM})"
    add("--stream", metavar="NAME", help=stream)
    add("--objective", default="trace", choices=OBJECTIVES, help="default trace")
    add("--bound", type=float, default=5e-3, metavar="M", help="error of chance (default 0.005)")
    add(
        "--limits",
        metavar="STROKE,SPEED,ACCEL",
        help="m, m/s, m/s² (default: [physics.slide] of the robot file)",
    )


def require_horizon(options: argparse.Namespace) -> None:
    """Raise GlissandoError for a horizon that is too long, such as one in milliseconds."""
    if options.horizon > _AHEAD:
        raise GlissandoError(
            f"--horizon is {options.horizon:g} s; give at most {_AHEAD:g} s "
            f"({options.horizon:g} milliseconds are {options.horizon / 1e3:g} s)."
        )


def stream_of(options: argparse.Namespace, parameters: Sequence[SensorParameter]) -> str:
    """Stream of the sliding sensor, by which its sensor parameters are chosen.

    Warns:
        PlanWarning: The default stream has no uncertain parameter, but others have.

    Raises:
        GlissandoError: The stream of --stream has no uncertain parameter.
    """
    stream: str = options.stream or _STREAM
    streams = {name for each in parameters if not each.known for name in each.streams}
    known = ", ".join(sorted(streams))
    if stream in streams:
        return stream
    if options.stream:
        raise GlissandoError(
            f"--stream {stream}: sensor parameters are of {known or 'no stream'}; give one of "
            f"these, or leave it out."
        )
    if known:
        warnings.warn(
            f"No sensor parameter is of the stream {stream!r}, so the plan counts none; if the "
            f"sensor slides as one of {known}, give --stream NAME.",
            PlanWarning,
            stacklevel=2,
        )
    return stream


def require_speed(option: str, speed: float) -> None:
    """Raise GlissandoError for a speed that is too high, such as one in mm/s."""
    if speed > _FASTEST:
        raise GlissandoError(
            f"{option}: a speed of {speed:g} m/s is more than {_FASTEST:g} m/s; give metres a "
            f"second ({speed:g} mm/s are {speed / 1e3:g} m/s)."
        )


def stage_of(options: argparse.Namespace) -> tuple[SlideLimits, float]:
    """Limits of the stage, and the arclength, m, of the sensor at travel zero (drawn out).

    Both are those of [physics] in the robot file; --limits replaces the former, and without
    [physics] the latter is the robot's length.
    """
    file = robot_file(options.robot)
    length = load_robot(file).length
    try:
        bench = load_bench(file)
        stage, upper = bench.slide, length + bench.coil_offset
    except SimulationError as problem:
        if not options.limits:
            raise RobotFileError(
                f"{file.name} does not say what its stage can do: give --limits "
                f"STROKE,SPEED,ACCEL, or [physics] with a [physics.slide] ({problem})"
            ) from None
        upper = length
    if options.limits:
        try:
            stage = SlideLimits(*map(float, options.limits.split(",")))
        except (TypeError, ValueError) as problem:
            if isinstance(problem, GlissandoError):
                raise
            raise GlissandoError(
                f"--limits {options.limits}: give STROKE,SPEED,ACCEL, three numbers in m, m/s, "
                f"m/s²."
            ) from None
        require_speed("--limits", stage.speed)
        if stage.acceleration > _SHARPEST:
            raise GlissandoError(
                f"--limits: an acceleration of {stage.acceleration:g} m/s² is more than "
                f"{_SHARPEST:g} m/s²; give metres a second squared."
            )
    return stage, upper
