"""Writing recording folders: one CSV a stream and a recording.toml."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.atomic import write_text
from glissando.io.csv_stream import Stream, write_named
from glissando.io.plain_file import file_stem
from glissando.io.provenance import made_by, stated_format
from glissando.io.shipped_robots import robot_file, shipped_robots
from glissando.model.table import pose_table

ROBOT = "robot.toml"
"""A robot's file in the folder of a recording."""


def write_streams(
    building: Path,
    name: str,
    streams: Iterable[Stream],
    *,
    robot: str | Path = "",
    frames: Mapping[str, Array | None] | None = None,
    calibration: Mapping[str, Mapping[str, Any]] | None = None,
    **more: Any,
) -> None:
    """Write a recording into an existing folder, such as one of `new_folder`.

    Args:
        building: Folder to write into.
        name: Name of the recording.
        streams: Streams, each with rows in the frame that it names.
        robot: Name of a robot, or path of a robot file, which is copied into the folder.
        frames: Pose T_wf (4, 4) of each frame that a stream names; None if unknown.
        calibration: Value, std and unit of each calibrated constant applied to the streams.
        **more: Further fields of recording.toml.

    Raises:
        RecordingError: The name of a stream is not usable as a file name.
    """
    if isinstance(robot, Path):
        shutil.copy(robot, building / ROBOT)
        robot = ROBOT
    text = describe_recording(name, robot, **more)
    for frame, pose in (frames or {}).items():
        text += (
            f"\n[frames.{_key(frame)}]\n{_UNKNOWN if pose is None else _fields(pose_table(pose))}"
        )
    if calibration:
        text += (
            "\n[calibration]          # found by glissando calibrate, and applied to the streams\n"
        )
    for constant, estimate in (calibration or {}).items():
        inner = ", ".join(f"{key} = {_value(value)}" for key, value in estimate.items())
        text += f"{_value(constant)} = {{ {inner} }}\n"
    for stream in streams:
        write_named(building / f"{file_stem(stream.name, RecordingError)}.csv", stream.rows)
        text += describe_stream(stream)
    write_text(building / "recording.toml", text)


_UNKNOWN = (
    "# glissando calibrate finds it from motion capture; else state position and quaternion (w, x, "
    "y, z).\nunknown = true\n"
)


def named_in(folder: Path, robot: Path) -> str:
    """Name for a recording's robot: that of a shipped robot, else a copy of its file in `folder`.

    A robot file that is not shipped is copied to `folder` here.
    """
    if robot.stem in shipped_robots() and robot.samefile(robot_file(robot.stem)):
        return robot.stem
    write_text(folder / ROBOT, robot.read_text(encoding="utf-8"))
    return ROBOT


def describe_recording(name: str, robot: str = "", **more: Any) -> str:
    """First lines of a recording.toml: format, program, name, robot, and any `more` fields."""
    stated = {"format": stated_format("recording"), "made_by": made_by()}
    return _fields({**stated, "name": name, **({"robot": robot} if robot else {}), **more})


def describe_stream(stream: Stream) -> str:
    """Lines of a recording.toml that describe one stream.

    >>> from glissando.io.csv_stream import Rows
    >>> gyro = Rows("gyro", np.zeros(1), np.zeros(1), np.zeros((1, 3)), {})
    >>> print(describe_stream(Stream("tip", gyro, std=np.full(3, 0.2))), end="")
    <BLANKLINE>
    [[streams]]
    name = "tip"
    kind = "gyro"
    std = [0.2, 0.2, 0.2]
    """
    fields: dict[str, Any] = {"name": stream.name, "kind": stream.rows.kind}
    if stream.frame != "world":
        fields["frame"] = stream.frame
    fields |= {key: True for key in ("truth", "keep_repeats") if getattr(stream, key)}
    if stream.std is not None:
        fields["std"] = stream.std
    text = "\n[[streams]]\n" + _fields({**fields, **stream.rows.settings})
    if stream.channel:
        text += "[streams.channel]\n" + _fields(stream.channel.to_table())
    if np.array_equal(stream.mount, np.eye(4)):
        return text
    return f"{text}[streams.mount]\n{_fields(pose_table(stream.mount))}"


def _fields(fields: Mapping[str, Any]) -> str:
    return "".join(f"{key} = {_value(value)}\n" for key, value in fields.items())


def _key(name: str) -> str:
    """A key in TOML, without quotes where TOML allows it."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _value(name)


def _value(value: Any) -> str:
    """A value in TOML; a character that UTF-8 lacks becomes a question mark."""
    if isinstance(value, str):
        plain = value.encode("utf-8", "replace").decode().replace("\x7f", "?")
        return json.dumps(plain, ensure_ascii=False)
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    return repr(float(value)) if isinstance(value, float) else json.dumps(value)
