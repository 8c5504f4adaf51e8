"""Reading and checking robot files: length, rest strain, base, grid, prior, sensor noise (TOML)."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import GlissandoError, OldNameWarning, RobotFileError
from glissando.geometry.se3 import Array
from glissando.io.provenance import require_readable
from glissando.io.shipped_robots import robot_file
from glissando.io.toml_table import read_document
from glissando.model.grid import with_places
from glissando.model.mechanics import implausible, read_mechanics
from glissando.model.noise import GemanMcClure, Huber, Loss
from glissando.model.priors.prior import Prior
from glissando.model.priors.registry import prior_class, prior_kinds
from glissando.model.robot import LONGEST, SHORTEST, Robot
from glissando.model.sensors.parameters import SIZES, SensorParameter
from glissando.model.sensors.sensors import sensor_class, sensor_kinds
from glissando.model.table import Table
from glissando.model.tendons.tendons import read_tendons
from glissando.model.tube import Tube

OLD_KINDS = {
    "kinematic": "white-noise",
    "world": "frame",
    "slide": "arclength_offset",
    "delay": "time_offset",
}
"""Present kinds of priors and of sensor parameters by their names in older files."""
_VAGUE = 0.5  # of the length: a std of positions above it must be in another unit
_NODES = 10_000  # most nodes along a robot: more must be a mistake of units
LOSSES: dict[str, type[Huber] | type[GemanMcClure]] = {
    "huber": Huber,
    "geman-mcclure": GemanMcClure,
}
"""Robust losses by their names in robot files."""


def load_robot(name: str | Path) -> Robot:
    """Load a shipped robot by its name, or any robot by the path of its file.

    Raises:
        RobotFileError: There is no such robot, or its file is invalid; the message names the file.

    >>> load_robot("tdcr466").length
    0.466
    """
    if not isinstance(name, str | PathLike):
        raise RobotFileError(f"load_robot was given {name!r}; give a robot's name or its file.")
    path = robot_file(name)
    try:
        robot = parse_robot(Table(read_robot_document(path), path.name, RobotFileError))
        _require_metres(robot)
    except RobotFileError:
        raise
    except GlissandoError as problem:  # of what its numbers make
        raise RobotFileError(f"{path.name}: {problem}") from None
    return replace(robot, file=path)


def _require_metres(robot: Robot) -> None:
    """Raise RobotFileError if a tracker's std of positions is too large to be in metres."""
    for kind, std in robot.sensor_std.items():
        sensor = sensor_class(kind)
        reads_places = sensor.tracker and sensor.value_shape != (3, 3)
        if reads_places and np.any(std[:3] > _VAGUE * robot.length):
            raise RobotFileError(
                f"{robot.name}: [sensors.{kind}] std is {std[:3].max():g} m on a robot of "
                f"{robot.length:g} m; give metres, not millimetres."
            )


def read_robot_document(path: Path) -> dict[str, Any]:
    """Read a robot file as a TOML document, in which old names are replaced by present ones.

    Warns:
        OldNameWarning: The file uses old names.

    Raises:
        RobotFileError: The file cannot be read or parsed.
    """
    document, renamed = read_document(path, RobotFileError), []
    require_readable(document.get("format"), "robot", path, RobotFileError)
    if "unknowns" in document and "sensor_parameters" not in document:
        document["sensor_parameters"] = document.pop("unknowns")
        renamed.append("[[unknowns]] is now [[sensor_parameters]]")
    entries = document.get("sensor_parameters")
    for entry in [document.get("prior"), *(entries if isinstance(entries, list) else [])]:
        kind = entry.get("kind") if isinstance(entry, dict) else None
        if isinstance(kind, str) and kind in OLD_KINDS:
            entry["kind"] = OLD_KINDS[kind]
            renamed.append(f'kind = "{kind}" is now kind = "{OLD_KINDS[kind]}"')
    if renamed:
        names = "; ".join(dict.fromkeys(renamed))
        warnings.warn(f"{path.name}: {names}; rename it.", OldNameWarning, stacklevel=3)
    return document


def parse_robot(table: Table) -> Robot:
    """Robot described by the table of a robot file.

    Raises:
        RobotFileError: An entry is missing, unknown or invalid; the message names its key.
    """
    name = table.text("name", Path(table.where).stem)
    length = table.number("length")
    if not SHORTEST <= length <= LONGEST:
        raise table.fail("length", f"is {length:g} m; give metres, not millimetres or inches.")
    prior = _prior(table)
    if prior.joints.size and prior.joints[-1] >= length:
        raise table.fail(
            "[prior]",
            f"has a joint or a point load at {prior.joints[-1]:g} m, at or beyond the tip at "
            f"{length:g} m; give arclengths in metres, and var_tip for loads at the tip.",
        )
    nodes, rate, at_readings = _grid(table, length)
    nodes = with_places(nodes, prior.joints)
    mechanics = getattr(prior, "mechanics", None) or read_mechanics(table)
    if mechanics is not None:
        problem = implausible(mechanics, length)
        if problem is not None:
            raise table.fail(f"[mechanics] {problem[0]}", problem[1])
    sensors = _sensors(table)
    sensor_parameters = tuple(
        _sensor_parameter(entry) for entry in table.tables("sensor_parameters")
    )
    tube, tendons = _tube(table.table("tube")), read_tendons(table, length, mechanics)
    table.skip("format")
    table.skip("physics")  # read and checked by the simulator
    table.close()
    optional = (mechanics, tube, tendons)
    return Robot(
        name, length, nodes, rate, prior, *sensors, sensor_parameters, *optional, at_readings
    )


def _tube(table: Table | None) -> Tube | None:
    """Conformal tube of the table [tube]; None without one."""
    if table is None:
        return None
    level, sigmas = table.number("level"), table.number("sigmas")
    blocks, seconds = table.number("blocks"), table.number("seconds", positive=False)
    if level >= 1.0 or seconds < 0.0 or blocks != int(blocks):
        raise table.fail(
            "level, seconds or blocks", "cannot be; write it anew with glissando check."
        )
    table.close()
    return Tube(level, sigmas, int(blocks), seconds)


def with_tube(text: str, tube: Tube) -> str:
    """Text of a robot file with its [tube] replaced, or added; all else stays unchanged.

    Args:
        text: Text of the robot file.
        tube: Tube to write.
    """
    table = r"^\[tube\][^\n]*\n((?:(?!\[)[^\n]*(?:\n|\Z))*)"
    keys = re.compile(r"^[ \t]*\w+[ \t]*=[^\n]*(?:\n|\Z)", re.MULTILINE)
    rest = re.sub(table, lambda own: keys.sub("", own[1]), text, flags=re.MULTILINE)
    entries = "".join(f"{key} = {value}\n" for key, value in vars(tube).items())
    return f"{rest.rstrip()}\n\n[tube]\n{entries}"


def _grid(table: Table, length: float) -> tuple[Array, float, bool]:
    """Arclength nodes (N,), m, time nodes a second, and whether readings add time nodes."""
    grid = table.subtable("grid")
    rate, at_readings = grid.number("time_rate"), grid.flag("nodes_at_readings")
    if isinstance(grid.peek("arclength_nodes"), list):
        nodes = grid.vector("arclength_nodes", len(grid.peek("arclength_nodes")))
        if nodes.size == 0 or nodes[0] != 0.0 or np.any(np.diff(nodes) <= 0.0):
            raise grid.fail("arclength_nodes", "must begin at 0 and increase.")
        if abs(nodes[-1] - length) > 1e-9:
            raise grid.fail(
                "arclength_nodes", f"ends at {nodes[-1]:g} m; end it at the length, {length:g} m."
            )
    else:
        count = grid.number("arclength_nodes")
        if count != int(count) or not 2 <= count <= _NODES:
            raise grid.fail(
                "arclength_nodes",
                f"is {count:g}; give a whole number from 2 up to {_NODES}, or the nodes.",
            )
        nodes = np.linspace(0.0, length, int(count))
    grid.close()
    return nodes, rate, at_readings


def _prior(table: Table) -> Prior:
    """Prior described by the table [prior], of the kind named there."""
    entries = table.subtable("prior")
    prior = prior_class(entries.kind(prior_kinds())).from_table(entries, table)
    entries.close()
    return prior


def _sensor_parameter(table: Table) -> SensorParameter:
    """Sensor parameter of an entry of [[sensor_parameters]]; without a std its value is known."""
    name, kind = table.text("name"), table.text("kind", choices=SIZES)
    size = SIZES[kind]
    value = table.vector("value", size, np.zeros(size), pairs=False)
    uncertain = table.peek("std") is not None
    std = table.vector("std", size, np.zeros(size))
    if np.any(std < 0.0) or (uncertain and not np.any(std)):
        raise table.fail(
            "std", f"is {std.tolist()}; give numbers above zero, and 0 for those that are known."
        )
    drifts = table.peek("correlation_time") is not None
    memory = table.number("correlation_time", 1.0)
    streams = tuple(table.texts("streams"))
    table.close()
    return SensorParameter(name, kind, streams, value, std, memory if drifts else np.inf)


def _sensors(
    table: Table,
) -> tuple[dict[str, Array], dict[str, Loss], dict[str, float], dict[str, float]]:
    """Standard deviations, losses, ranges and rates by kind of sensor."""
    std: dict[str, Array] = {}
    losses: dict[str, Loss] = {}
    ranges: dict[str, float] = {}
    rates: dict[str, float] = {}
    for kind, sensor in table.named_tables("sensors"):
        if kind not in sensor_kinds():
            known = ", ".join(sensor_kinds())
            raise table.fail(f"[sensors.{kind}]", f"is not a kind of sensor; known: {known}.")
        std[kind] = sensor.std(sensor_class(kind).rows)
        if sensor.peek("clip") is not None and not sensor_class(kind).tracker:
            ranges[kind] = sensor.number("clip")
        if sensor.peek("rate") is not None:
            rates[kind] = sensor.number("rate")
        name = sensor.text("loss", "none", choices=("none", *LOSSES))
        if name != "none":
            loss = LOSSES[name]
            losses[kind] = loss(sensor.number("threshold", loss().threshold))
        sensor.close()
    return std, losses, ranges, rates
