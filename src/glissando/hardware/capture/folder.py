"""A session log becomes a recording: a coil's arclength is where the slide was at its frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.capture.setup import Rig
from glissando.io.csv_stream import Rows, Stream
from glissando.io.recording_writer import write_streams
from glissando.io.robot_file import load_robot
from glissando.io.session_log import RawSession, Topic
from glissando.io.shipped_robots import robot_file, shipped_robots

_GAP = 0.5  # s without a pose that is reported
_MOCAP_STD = np.repeat([3e-4, 5e-3], 3)  # m, rad: a marker body of some centimetres


def write_recording(session: RawSession, rig: Rig, folder: Path) -> list[str]:
    """Write the streams of a session as a recording.

    Times begin at the slide's first reading. Messages before the slide's first reading and after
    its last, and frames without a pose, are left out.

    Args:
        session: The log.
        rig: The rig it was logged with.
        folder: Where the recording goes.

    Returns:
        Sentences on bodies that were never seen, and on gaps.

    Raises:
        RecordingError: Nothing is left.
    """
    length = load_robot(robot_file(rig.robot)).length
    slide = session.topics.get("/slide")
    if slide and slide.messages:
        slide_time, travel = slide.column("time"), slide.column("travel")
        zero, span = float(slide_time[0]), (slide_time[0], slide_time[-1])
    else:
        slide_time, travel = np.zeros(1), np.zeros(1)
        begins = [topic.time_ns[0] for topic in session.topics.values() if topic.time_ns.size]
        zero, span = 1e-9 * float(min(begins, default=0.0)), (-np.inf, np.inf)
    warnings: list[str] = []
    streams: list[Stream] = []

    def seen(topic: str, name: str) -> tuple[Array, Array]:
        time, poses = _poses(session.topics.get(f"/{topic}/{name}"), span)
        gaps = _gaps(name, time, span, zero) if time.size else [f"{name} was never seen"]
        warnings.extend(gaps)
        return time, poses

    for coil in rig.coils:
        time, poses = seen("tracker", coil.name)
        if time.size:
            arclength = coil.arclengths(np.interp(time, slide_time, travel))
            arclength = np.clip(arclength, 0.0, length)
            rows = Rows("coil", time - zero, arclength, poses, {})
            streams.append(Stream(coil.name, rows, frame="tracker"))
    for body in rig.bodies:
        time, poses = seen("mocap", body.name)
        if time.size:
            rows = Rows("pose", time - zero, np.full(time.size, body.arclength), poses, {})
            streams.append(Stream(body.name, rows, True, _MOCAP_STD, body.mount))
    if not streams:
        raise RecordingError(
            f"{folder} holds no pose of any device ({'; '.join(warnings)}); record again."
        )
    robot = rig.robot if rig.robot in shipped_robots() else str(Path(rig.robot).resolve())
    write_streams(folder, rig.name, streams, robot=robot, frames={"tracker": rig.frame})
    return warnings


def _poses(topic: Topic | None, span: tuple[float, float]) -> tuple[Array, Array]:
    """Times (M,) in a span and poses (M, 4, 4) of the messages that have one, in order of time."""
    if topic is None or not topic.messages or topic.column("position").ndim != 2:  # never seen
        return np.zeros(0), np.zeros((0, 4, 4))
    time, position, quaternion = map(topic.column, ("time", "position", "quaternion"))
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
