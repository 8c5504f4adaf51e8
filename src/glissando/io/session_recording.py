"""A session log as a recording; the slide's travel at a frame's time gives a coil's arclength."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.csv_stream import Rows, Stream
from glissando.io.robot_file import load_robot
from glissando.io.session_log import RawSession, Topic
from glissando.io.shipped_robots import beside, robot_file
from glissando.model.table import Table
from glissando.model.tendons.channel import Channel, ends_of

LOG = "session.mcap"
"""Name of a session's log in its folder."""
ARCLENGTH_STD = 2e-3
"""Standard deviation, m, of a coil's arclength measured by hand, unless the setup states one."""
_GAP = 0.5  # s without a pose from which a gap is reported
_MOCAP_STD = np.repeat([3e-4, 5e-3], 3)  # m, rad: a marker body of some centimetres


@dataclass(frozen=True)
class SessionStreams:
    """Streams of a session log, for a recording.

    Attributes:
        name: Name of the rig.
        robot: Name of a shipped robot, or path of a robot file.
        streams: Streams; those of coils are in the frame 'tracker'.
        frame: Pose (4, 4) of the tracker in the world; None if the setup does not state it.
        warnings: Sentences on devices without any pose, and on gaps.
    """

    name: str
    robot: str
    streams: list[Stream]
    frame: Array | None
    warnings: list[str]


def session_setup(session: RawSession) -> dict[str, Any]:
    """Setup of the rig, as stated in the metadata of a session log.

    Raises:
        RecordingError: The log has no setup, or the setup is not a JSON object.
    """
    text = session.metadata.get("setup")
    if text is None:
        raise RecordingError(
            "The session has no 'setup' in its metadata; it says where coil and bodies sit, see "
            "docs/calibration.md."
        )
    try:
        setup = json.loads(text)
    except (ValueError, RecursionError) as problem:
        raise RecordingError(f"The session's setup is not JSON ({problem}); correct it.") from None
    if not isinstance(setup, dict):
        raise RecordingError("The session's setup is not a JSON object; give one, {…}.")
    return setup


def session_streams(
    session: RawSession, setup: Mapping[str, Any], folder: Path = Path()
) -> SessionStreams:
    """Streams of a session log, which may have been cut off.

    Time zero is the slide's first reading. Messages outside the times at which the slide was read,
    frames of a coil outside those of the stage that moves it, and frames without a pose are left
    out.

    Args:
        session: Session log.
        setup: Setup of the rig, as of `session_setup`.
        folder: Folder of the session, which may contain its robot's file.

    Raises:
        RecordingError: No device has a pose, or the setup is invalid.
    """
    table = Table(dict(setup), "setup", RecordingError)
    robot = table.text("robot")
    length = load_robot(robot_file(beside(folder, robot))).length
    slide_travel, zero, span = _slide_travel(session)
    warnings: list[str] = []
    streams: list[Stream] = []

    def seen(topic: str, name: str, first: float, last: float) -> tuple[Array, Array]:
        time, poses = seen_poses(session.topics.get(f"/{topic}/{name}"))
        inside = (time >= first) & (time <= last)
        time, poses = time[inside], poses[inside]
        gaps = _gaps(name, time, (first, last), zero) if time.size else [f"{name} was never seen"]
        warnings.extend(gaps)
        return time, poses

    for name, (origin, direction, moved_by, channel) in _coils(session, table).items():
        travel, interval = slide_travel, span
        if moved_by:
            travel = _stage_travel(session, moved_by)
            interval = max(span[0], travel[0][0]), min(span[1], travel[0][-1])
        time, poses = seen("tracker", name, *interval)
        if time.size:
            arclength = origin + direction * np.interp(time, *travel)
            rows = Rows(
                "coil", time - zero, np.clip(arclength, *ends_of(channel, length)), poses, {}
            )
            streams.append(Stream(name, rows, frame="tracker", channel=channel))
    for name, body in table.named_tables("bodies"):
        if body.flag("slides"):  # on the sliding tube, not on the robot
            continue
        time, poses = seen("mocap", name, *span)
        if time.size:
            place = body.number("arclength", positive=False)
            rows = Rows("pose", time - zero, np.full(time.size, place), poses, {})
            streams.append(Stream(name, rows, True, _MOCAP_STD, body.pose()))
    if not streams:
        raise RecordingError(
            f"The session holds no pose of any device ({'; '.join(warnings)}); record again."
        )
    frame = table.table("frame")
    pose = frame.pose() if frame else None
    return SessionStreams(table.text("name", "session"), robot, streams, pose, warnings)


def _slide_travel(session: RawSession) -> tuple[tuple[Array, Array], float, tuple[float, float]]:
    """Times (M,), s, and travels (M,), m, of the slide; the zero of times; the slide's time span.

    Without a slide, travel is 0, time zero is the first message, and the span is unbounded.
    """
    time, travel = seen_travels(session.topics.get("/slide"))
    if time.size:
        return (time, travel), float(time[0]), (time[0], time[-1])
    begins = [topic.time_ns[0] for topic in session.topics.values() if topic.time_ns.size]
    zero = 1e-9 * float(min(begins, default=0.0))
    return (np.zeros(1), np.zeros(1)), zero, (-np.inf, np.inf)


def _stage_travel(session: RawSession, name: str) -> tuple[Array, Array]:
    """Times (M,), s, and travels (M,), m, of a further stage. Raises RecordingError without any."""
    time, travel = seen_travels(session.topics.get(f"/slide/{name}"))
    if not time.size:
        raise RecordingError(f"The session holds no travel of the stage {name!r}; record again.")
    return time, travel


_Coil = tuple[float, float, str, Channel | None]
"""Arclength at travel zero, m, its derivative by travel (−1, 0, 1), stage's name, channel."""


def _coils(session: RawSession, setup: Table) -> dict[str, _Coil]:
    """Coils by name, from the setup's [coils], or the only one from its older keys."""
    coils = dict(setup.named_tables("coils"))
    if coils:
        return {
            name: (
                coil.number("arclength", positive=False),
                -1.0 if coil.flag("slides") else 0.0,
                coil.text("slide", ""),
                coil.channel(),
            )
            for name, coil in coils.items()
        }
    names = [t.removeprefix("/tracker/") for t in session.topics if t.startswith("/tracker/")]
    name = setup.text("coil", names[0] if len(names) == 1 else None) if names else ""
    if not name:
        return {}
    direction = setup.number("direction", -1.0, positive=False)
    return {name: (setup.number("coil_arclength", positive=False), direction or -1.0, "", None)}


def seen_poses(topic: Topic | None) -> tuple[Array, Array]:
    """Times (M,), s, and measured poses (M, 4, 4), sorted by time, each frame once.

    Raises:
        RecordingError: Positions do not have 3 entries, or quaternions not 4.
    """
    if topic is None:
        return np.zeros(0), np.zeros((0, 4, 4))
    time, frame = topic.column("time"), topic.column("frame")
    position, quaternion = topic.column("position"), topic.column("quaternion")
    if position.ndim != 2 or quaternion.ndim != 2:  # no pose was ever measured
        return np.zeros(0), np.zeros((0, 4, 4))
    if position.shape[1] != 3 or quaternion.shape[1] != 4:
        raise RecordingError(
            f"Topic {topic.name!r}: give positions of 3 numbers and quaternions [w, x, y, z]."
        )
    seen = np.isfinite(time) & np.all(np.isfinite(np.hstack([position, quaternion])), axis=1)
    seen &= np.abs(np.linalg.norm(quaternion, axis=1) - 1.0) < 0.01
    rows = np.flatnonzero(seen)
    rows = rows[np.argsort(time[rows], kind="stable")]
    repeated = np.append(False, frame[rows][1:] == frame[rows][:-1]) if rows.size else rows > 0
    rows = rows[~repeated]
    rotation = se3.rotation_from_quaternion(quaternion[rows])
    return time[rows], se3.pose(rotation, position[rows])


def seen_travels(topic: Topic | None) -> tuple[Array, Array]:
    """Increasing times (M,), s, and travels (M,), m, of a stage."""
    if topic is None:
        return np.zeros(0), np.zeros(0)
    time, travel = topic.column("time"), topic.column("travel")
    rows = np.flatnonzero(np.isfinite(time) & np.isfinite(travel))
    time, first = np.unique(time[rows], return_index=True)
    return time, travel[rows][first]


def _gaps(name: str, time: Array, span: tuple[float, float], zero: float) -> list[str]:
    """A sentence for each gap in the times of a device, with the span's ends if it is bounded."""
    ends = np.concatenate([span[:1], time, span[1:]]) if np.isfinite(span[0]) else time
    return [
        f"{name} was not seen from {ends[k] - zero:.1f} to {ends[k + 1] - zero:.1f} s"
        for k in np.flatnonzero(np.diff(ends) > _GAP)
    ]
