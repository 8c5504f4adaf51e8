"""What a replay was asked to do, stored beside its log: only the same is gone on with."""

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
    """What decides the states of a replay, as JSON holds it.

    Args:
        name: Name of the recording.
        robot: The robot; one of a file by its bytes, else by its name.
        readings: All readings that it is given.
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
    """Write what was asked beside the log in a folder."""
    write_text(folder / _FILE, json.dumps(request, indent=2) + "\n")


def require_same_request(folder: Path, request: dict[str, object]) -> None:
    """Make sure that the log in a folder is of a run that was asked the same.

    Raises:
        RecordingError: It is of another recording, robot, window, lag, or of other readings.
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
