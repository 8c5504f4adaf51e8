"""The text of a recording.toml, the same from all who write recordings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array


def head(name: str, robot: str = "", **more: Any) -> str:
    """What a recording.toml begins with: a name, a shipped robot or a robot file, anything more."""
    return _fields({"name": name, **({"robot": robot} if robot else {}), **more})


def frame(name: str, pose: Array) -> str:
    """The frame of a tracker, a pose (4, 4) in the world."""
    return f"\n[frames.{name}]\n{_pose(pose)}"


def stream(fields: Mapping[str, Any], mount: Array | None = None) -> str:
    """A stream with its fields in order, and the pose (4, 4) of its sensor on the robot.

    >>> print(stream({"name": "tip", "kind": "gyro", "std": np.full(3, 0.2)}), end="")
    <BLANKLINE>
    [[streams]]
    name = "tip"
    kind = "gyro"
    std = [0.2, 0.2, 0.2]
    """
    text = "\n[[streams]]\n" + _fields(fields)
    return text if mount is None else f"{text}[streams.mount]\n{_pose(mount)}"


def _fields(fields: Mapping[str, Any]) -> str:
    return "".join(f"{key} = {_value(value)}\n" for key, value in fields.items())


def _value(value: Any) -> str:
    """A value as TOML has it; what UTF-8 has no letter for becomes a question mark."""
    if isinstance(value, str):
        plain = value.encode("utf-8", "replace").decode().replace("\x7f", "?")
        return json.dumps(plain, ensure_ascii=False)
    return json.dumps(value.tolist() if isinstance(value, np.ndarray) else value)


def _pose(pose: Array) -> str:
    return _fields({"position": pose[:3, 3], "quaternion": se3.quaternion(pose[:3, :3])})
