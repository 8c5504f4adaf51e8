"""A session log becomes a recording: a coil's arclength is where the slide was at its frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.capture.setup import Rig
from glissando.io import recording_toml
from glissando.io.csv_stream import Rows, write_named
from glissando.io.robot_file import load_robot, robot_file, shipped_robots
from glissando.io.session_log import RawSession, Topic

_GAP = 0.5  # s unseen that is worth a word
_MOCAP_STD = [3e-4, 3e-4, 3e-4, 5e-3, 5e-3, 5e-3]  # m, rad: a marker body of some centimetres


def write_recording(session: RawSession, rig: Rig, folder: Path) -> list[str]:
    """Write the streams of a session into `folder` as a recording; returns what is amiss.

    Times begin at the slide's first reading. What came before the slide was read and after, and
    frames without a pose, are left out. Raises RecordingError when nothing is left.
    """
    length = load_robot(robot_file(rig.robot)).length
    slide = session.topics.get("/slide")
    moved = _columns(slide, "time", "travel") if slide and slide.messages else None
    zero = _begin(session) if moved is None else float(moved[0][0])
    amiss: list[str] = []
    streams: list[dict[str, Any]] = []
    span = (-np.inf, np.inf) if moved is None else (moved[0][0], moved[0][-1])
    for coil in rig.coils:
        time, poses = _seen(session.topics.get(f"/tracker/{coil.name}"), span)
        travel = np.zeros(time.size) if moved is None else np.interp(time, moved[0], moved[1])
        if not time.size:
            amiss.append(f"{coil.name} was never seen")
            continue
        amiss += _gaps(coil.name, time, span, zero)
        place = np.clip(coil.places(travel), 0.0, length)
        rows = Rows("coil", time - zero, place, poses, {})
        write_named(folder / f"{coil.name}.csv", rows)
        streams.append({"name": coil.name, "kind": "coil", "frame": "tracker"})
    for body in rig.bodies:
        time, poses = _seen(session.topics.get(f"/mocap/{body.name}"), span)
        if not time.size:
            amiss.append(f"{body.name} was never seen")
            continue
        amiss += _gaps(body.name, time, span, zero)
        rows = Rows("pose", time - zero, np.full(time.size, body.arclength), poses, {})
        write_named(folder / f"{body.name}.csv", rows)
        streams.append(
            {"name": body.name, "kind": "pose", "truth": True, "std": _MOCAP_STD}
            | {"mount": body.mount}
        )
    if not streams:
        raise RecordingError(f"{folder}: no device said where anything is; {'; '.join(amiss)}.")
    (folder / "recording.toml").write_text(_described(rig, streams), encoding="utf-8")
    return amiss


def _begin(session: RawSession) -> float:
    begun = [t.time_ns[0] for t in session.topics.values() if t.time_ns.size]
    return 1e-9 * float(min(begun)) if begun else 0.0


def _columns(topic: Topic, *keys: str) -> list[Array]:
    return [topic.column(key) for key in keys]


def _seen(topic: Topic | None, span: tuple[float, float]) -> tuple[Array, Array]:
    """Times (M,) in a span and poses (M, 4, 4) of the messages that have one, in order of time."""
    if topic is None or not topic.messages:
        return np.zeros(0), np.zeros((0, 4, 4))
    time, position, quaternion = _columns(topic, "time", "position", "quaternion")
    if position.ndim != 2:  # never seen
        return np.zeros(0), np.zeros((0, 4, 4))
    seen = np.all(np.isfinite(position), axis=1) & (time >= span[0]) & (time <= span[1])
    order = np.flatnonzero(seen)[np.argsort(time[seen], kind="stable")]
    poses = np.tile(np.eye(4), (order.size, 1, 1))
    poses[:, :3, :3] = se3.rotation_from_quaternion(quaternion[order])
    poses[:, :3, 3] = position[order]
    return time[order], poses


def _gaps(name: str, time: Array, span: tuple[float, float], zero: float) -> list[str]:
    """A sentence on each stretch of the recording in which something was not seen."""
    ends = np.concatenate([span[:1], time, span[1:]]) if np.isfinite(span[0]) else time
    return [
        f"{name} was not seen from {ends[k] - zero:.1f} to {ends[k + 1] - zero:.1f} s"
        for k in np.flatnonzero(np.diff(ends) > _GAP)
    ]


def _described(rig: Rig, streams: list[dict[str, Any]]) -> str:
    robot = rig.robot if rig.robot in shipped_robots() else str(Path(rig.robot).resolve())
    parts = [recording_toml.head(rig.name, robot), recording_toml.frame("tracker", rig.frame)]
    for stream in streams:
        mount = stream.pop("mount", None)
        parts.append(recording_toml.stream(stream, mount))
    return "".join(parts)
