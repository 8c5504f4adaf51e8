"""Settings of a replay, stored beside its log, so that only the same replay is continued."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.atomic import write_text
from glissando.io.plain_file import plain_text
from glissando.io.provenance import digests
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings

_FILE = "request.json"


def request_of(
    name: str, robot: Robot, readings: Sequence[Readings], times: Array, nodes: int
) -> dict[str, object]:
    """Settings that determine the states of a replay, as a JSON object.

    Args:
        name: Name of the recording.
        robot: The robot, identified by the digest of its file, or by name if it has none.
        readings: All readings of the replay, identified by a digest.
        times: Times of the updates (K,), s.
        nodes: Number of time nodes in the smoother's window.
    """
    every = hashlib.sha256()
    for r in readings:
        shared = [getattr(r, name, None) for name in (*r.settings, *r.optional_settings)]
        every.update(f"{r.label} {r.kind} {r.channel} {shared} ".encode())
        for part in (r.time, r.arclength, r.values, r.cov, r.mount):
            every.update(np.ascontiguousarray(part).tobytes())
    return {
        "recording": name,
        "robot": digests([robot.file])[robot.file.name] if robot.file else robot.name,
        "window": [float(times[0]), float(times[-1])],
        "lag": nodes,
        "readings": every.hexdigest(),
    }


def store_request(folder: Path, request: dict[str, object]) -> None:
    """Write the settings of a replay to the folder of its log."""
    write_text(folder / _FILE, json.dumps(request, indent=2) + "\n")


def require_same_request(folder: Path, request: dict[str, object]) -> None:
    """Raise unless the log in a folder is of a replay with the same settings.

    Raises:
        RecordingError: Recording, robot, window, lag or readings differ.
    """
    try:
        stored = dict(json.loads(plain_text(folder / _FILE)))
    except (OSError, ValueError, TypeError, RecursionError):
        stored = {}
    other = [key for key, value in request.items() if stored.get(key) != value]
    if other:
        raise RecordingError(
            f"{folder} is a log of another run, which differs in: {', '.join(other)}; repeat that "
            f"run's options, or give another folder."
        )
