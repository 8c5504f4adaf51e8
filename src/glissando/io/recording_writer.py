"""Recording folders as everyone writes them: one CSV a stream and a recording.toml."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.csv_stream import Stream, write_named


def write_streams(
    folder: Path,
    name: str,
    streams: Iterable[Stream],
    *,
    robot: str | Path = "",
    frames: Mapping[str, Array] | None = None,
    comment: str = "",
) -> None:
    """Write a recording into a folder that exists, such as one of `new_folder`.

    Args:
        folder: Folder to write into.
        name: Name of the recording.
        streams: Streams, rows in the frames they name.
        robot: Text that names the robot, or a robot file, which is copied into the folder.
        frames: Pose (4, 4) in the world of each frame that a stream names.
        comment: Line above the frames, without its #.
    """
    if isinstance(robot, Path):
        shutil.copy(robot, folder / "robot.toml")
        robot = "robot.toml"
    text = describe_recording(name, robot) + (f"\n# {comment}\n" if comment and frames else "")
    for frame, pose in (frames or {}).items():
        text += f"\n[frames.{frame}]\n{_pose(pose)}"
    for stream in streams:
        write_named(folder / f"{stream.name}.csv", stream.rows)
        text += describe_stream(stream)
    (folder / "recording.toml").write_text(text, encoding="utf-8")


def describe_recording(name: str, robot: str = "", **more: Any) -> str:
    """The first lines of a recording.toml: its name, its robot, and any `more` fields."""
    return _fields({"name": name, **({"robot": robot} if robot else {}), **more})


def describe_stream(stream: Stream) -> str:
    """The lines of a recording.toml on one stream.

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
    if np.array_equal(stream.mount, np.eye(4)):
        return text
    return f"{text}[streams.mount]\n{_pose(stream.mount)}"


def _fields(fields: Mapping[str, Any]) -> str:
    return "".join(f"{key} = {_value(value)}\n" for key, value in fields.items())


def _value(value: Any) -> str:
    """A value in TOML; a character that UTF-8 lacks becomes a question mark."""
    if isinstance(value, str):
        plain = value.encode("utf-8", "replace").decode().replace("\x7f", "?")
        return json.dumps(plain, ensure_ascii=False)
    return json.dumps(value.tolist() if isinstance(value, np.ndarray) else value)


def _pose(pose: Array) -> str:
    return _fields({"position": pose[:3, 3], "quaternion": se3.quaternion(pose[:3, :3])})
