"""Writing robot files, which `load_robot` reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from glissando.errors import RobotFileError
from glissando.estimation.given import require_kind
from glissando.geometry.se3 import Array
from glissando.io.atomic import write_text
from glissando.io.provenance import made_by, stated_format
from glissando.io.robot_file import LOSSES
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter


def save_robot(robot: Robot, path: str | Path) -> None:
    """Write a robot to a TOML file that `load_robot` and every command read.

    The table [physics] of a file, which only the simulator reads, is not part of a robot and is
    not written.

    Args:
        robot: Robot to write.
        path: File to write, whole or not at all.

    Raises:
        RobotFileError: The robot has a property that a robot file cannot express.
        GlissandoError: The file cannot be written.
    """
    require_kind(robot, Robot, "robot", "give the robot, and then the file")
    require_kind(path, (str, Path), "robot file to write", "give its path")
    write_text(path, f"# Written by {made_by()}.\n" + tomli_w.dumps(robot_document(robot)))


def robot_document(robot: Robot) -> dict[str, Any]:
    """Content of a robot's file, as a TOML document.

    Args:
        robot: Robot to describe.

    Raises:
        RobotFileError: The robot has a property that a robot file cannot express.
    """
    document = {
        "format": stated_format("robot"),
        "name": robot.name,
        "length": float(robot.length),
        **robot.prior.to_table(),
        "grid": {
            "arclength_nodes": robot.arclength_nodes.tolist(),
            "time_rate": float(robot.time_rate),
            "nodes_at_readings": bool(robot.nodes_at_readings),
        },
        "sensors": _sensors(robot),
        "sensor_parameters": [_sensor_parameter(each) for each in robot.sensor_parameters],
    }
    if robot.mechanics is not None:
        document.setdefault("mechanics", robot.mechanics.to_table())
    if robot.tendons is not None:
        document["tendons"] = robot.tendons.to_table()
    if robot.tube is not None:
        document["tube"] = dict(vars(robot.tube))
    return document


def _sensors(robot: Robot) -> dict[str, dict[str, Any]]:
    """Tables of [sensors] by kind: std, clip, rate and loss."""
    tables: dict[str, dict[str, Any]] = {
        kind: {"std": _as_list(std)} for kind, std in robot.sensor_std.items()
    }
    for key, numbers in (("clip", robot.sensor_range), ("rate", robot.sensor_rate)):
        for kind, number in numbers.items():
            _table_with_std(robot, tables, kind, key)[key] = float(number)
    for kind, loss in robot.sensor_loss.items():
        named = [name for name, known in LOSSES.items() if type(loss) is known]
        if not named:
            raise RobotFileError(
                f"Robot {robot.name}: a robot file cannot name the loss {loss!r} of {kind!r}; "
                f"known: {', '.join(LOSSES)}."
            )
        stated = {"loss": named[0], "threshold": float(vars(loss)["threshold"])}
        _table_with_std(robot, tables, kind, "loss").update(stated)
    return tables


def _table_with_std(
    robot: Robot, tables: dict[str, dict[str, Any]], kind: str, key: str
) -> dict[str, Any]:
    """Table of a kind of sensor to which a key is added; the kind must have a std."""
    if kind not in tables:
        raise RobotFileError(
            f"Robot {robot.name}: sensors of kind {kind!r} have a {key} and no standard deviation; "
            f"give sensor_std[{kind!r}]."
        )
    return tables[kind]


def _sensor_parameter(parameter: SensorParameter) -> dict[str, Any]:
    """An entry of [[sensor_parameters]]."""
    entry: dict[str, Any] = {
        "name": parameter.name,
        "kind": parameter.kind,
        "streams": list(parameter.streams),
        "value": _as_list(parameter.value),
    }
    if not parameter.known:
        entry["std"] = _as_list(parameter.std)
    if np.isfinite(parameter.correlation_time):
        entry["correlation_time"] = float(parameter.correlation_time)
    return entry


def _as_list(values: Array) -> list[float]:
    return [float(value) for value in values]
