"""Import of ROS 1 and ROS 2 bags: topics of stamped poses, and the frames of /tf."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import GlissandoError, RecordingError, needing
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.foreign.columns import EPOCH
from glissando.io.foreign.frame_tree import FrameTree
from glissando.io.foreign.tracks import SAME_TIME, Track, plain_name
from glissando.io.plain_file import largest_unpacked, require_plain

_TREES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_KINDS = {
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (
        m.pose.pose.position,
        m.pose.pose.orientation,
    ),
    "geometry_msgs/msg/TransformStamped": lambda m: (
        m.transform.translation,
        m.transform.rotation,
    ),
}
_KINDS |= dict.fromkeys(_TREES, _KINDS["geometry_msgs/msg/TransformStamped"])
_WORK = 1 << 28  # bytes that reading needs in addition to the unpacked bag
_SHOWN = 8  # topics named in an error
_WORLDS = ("", "world", "map")


def read_bag(path: Path, topics: Sequence[str]) -> list[Track]:
    """Read the pose topics of a ROS 1 bag file or ROS 2 bag folder, and the moving frames of /tf.

    Poses of a frame are expressed in the root frame of its tree, through the transforms of
    /tf_static and of the moving frames between, which are interpolated at the frame's times.

    Times are the stamps in headers, or the log times of messages without a stamp. A stamp of zero
    counts as missing, except on a clock that begins at zero, such as a simulator's.

    Args:
        path: File or folder of the bag.
        topics: Names of topics; empty for all with poses.

    Raises:
        RecordingError: The bag cannot be read or has no such topics.
        GlissandoError: rosbags is not installed.
    """
    with needing("Reading ROS bags needs rosbags", "ros"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    known = get_typestore(Stores.ROS2_HUMBLE)  # for bags that do not carry their types
    files = [path] if path.is_file() else [f for f in path.rglob("*") if not f.is_dir()]
    try:
        for file in files:
            require_plain(file, 1 << 40)
        size = sum(file.stat().st_size for file in files)
        with _bounded_memory(size), AnyReader([path], default_typestore=known) as bag:
            types = {c.topic: c.msgtype for c in bag.connections}
            chosen = _chosen_topics(path, types, topics)
            static = [topic for topic, kind in types.items() if _is_static(topic, kind)]
            return _tracks(bag, types, chosen, static)
    except GlissandoError:
        raise
    except MemoryError:
        raise RecordingError(
            f"{path} cannot be read as a ROS bag (it announces more than a file of its size holds)."
        ) from None
    except Exception as problem:  # whatever damaged bytes make the reader raise
        what = str(problem) or type(problem).__name__
        raise RecordingError(f"{path} cannot be read as a ROS bag ({what[:200]}).") from None


@contextmanager
def _bounded_memory(size: int) -> Iterator[None]:
    """Limit the growth of this process's memory to the need of a bag of `size` bytes, on Linux.

    The reader unpacks a bag before its unpacked size can be checked.
    """
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (ImportError, OSError):  # Windows, macOS
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + _WORK + largest_unpacked(size)
    most = most if before[0] == resource.RLIM_INFINITY else min(most, before[0])
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _chosen_topics(path: Path, types: dict[str, str], topics: Sequence[str]) -> list[str]:
    wrong = [topic for topic in topics if types.get(topic) not in _KINDS]
    usable = [t for t, kind in types.items() if kind in _KINDS and not _is_static(t, kind)]
    if wrong or not usable:
        shown = ", ".join(usable) or "none"
        raise RecordingError(
            f"{path.name} has {'no pose topic ' + wrong[0] if wrong else 'no pose topics'}; those "
            f"with stamped poses or transforms are: {shown}.{'' if usable else _contents(types)}"
        )
    return list(topics) or usable


def _contents(types: dict[str, str]) -> str:
    """A sentence on the topics of a bag without poses, with a remedy."""
    held = [f"{topic} ({kind})" for topic, kind in types.items()]
    more = f" and {len(held) - _SHOWN} more" if len(held) > _SHOWN else ""
    return (
        f" It holds {', '.join(held[:_SHOWN]) or 'no topics'}{more}; record each body's poses as "
        f"PoseStamped or on /tf, or write them to a text file, which --columns reads."
    )


def _is_static(topic: str, kind: str) -> bool:
    """Whether a topic carries static transforms."""
    return kind in _TREES and topic.rpartition("/")[2] == "tf_static"


@dataclass
class _Poses:
    """Poses of a topic or of one of its frames.

    `read` holds (stamp, log time, [qw, qx, qy, qz, x, y, z]) with times in ns; `frames` and
    `children` the names of parent and child frames; `missing` counts invalid poses.
    """

    read: list[tuple[int, int, list[float]]] = field(default_factory=list)
    frames: set[str] = field(default_factory=set)
    children: set[str] = field(default_factory=set)
    missing: int = 0


def _tracks(
    bag: Any, types: dict[str, str], chosen: Sequence[str], static: Sequence[str]
) -> list[Track]:
    """Tracks of the chosen topics, and of each frame of those with transforms."""
    fixed: dict[str, tuple[str, Array]] = {}
    for topic in static:
        for child, poses in _poses(bag, topic, each=True).items():
            track = _track(f"{topic} {child}", poses)
            if track.time.size:
                fixed[_frame_name(child)] = track.frame, track.values[-1]
    out: list[Track] = []
    for topic in chosen:
        every = _poses(bag, topic, each=types[topic] in _TREES)
        if types[topic] not in _TREES:
            out += [_track(topic, poses) for poses in every.values()]
            continue
        moving = {_frame_name(child): _track(f"{topic} {child}", of) for child, of in every.items()}
        tree = FrameTree(fixed, moving)
        out += [tree.at_root(child) for child in moving]
    return out


def _poses(bag: Any, topic: str, *, each: bool) -> dict[str, _Poses]:
    """Poses of a topic by child frame if `each`, else all of them under the empty name."""
    out: dict[str, _Poses] = {} if each else {"": _Poses()}
    for connection, logged, raw in bag.messages([c for c in bag.connections if c.topic == topic]):
        message = bag.deserialize(raw, connection.msgtype)
        for part in message.transforms if each else [message]:
            p, q = _KINDS[connection.msgtype](part)
            child = getattr(part, "child_frame_id", "")
            of = out.setdefault(child, _Poses()) if each else out[""]
            of.frames.add(part.header.frame_id)
            of.children.add(child)
            stamp, numbers = part.header.stamp, [q.w, q.x, q.y, q.z, p.x, p.y, p.z]
            if np.all(np.isfinite(numbers)) and np.linalg.norm(numbers[:4]) > 0.5:
                at = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
                of.read.append((at, logged, numbers))
            else:
                of.missing += 1
    return out


def _track(topic: str, poses: _Poses) -> Track:
    """Track of a topic's poses, sorted by stamp; of those with the same stamp, the first."""
    for names in (poses.frames, poses.children):
        names.discard("")
        if len(names) > 1:
            raise RecordingError(
                f"Topic {topic} has poses of several frames, {', '.join(sorted(names))}; record "
                f"each on a topic of its own."
            )
    begins = _begins_at_zero([at for at, _, _ in poses.read])
    rows: dict[int, list[float]] = {}
    for at, logged, numbers in poses.read:
        rows.setdefault(at if at or begins else logged, numbers)
    stamps, frame = sorted(rows), _frame_name(next(iter(poses.frames), ""))
    table = np.array([rows[t] for t in stamps]).reshape(-1, 7)
    pose = se3.pose(se3.rotation_from_quaternion(table[:, :4]), table[:, 4:])
    name = plain_name(topic.replace("/", "_").strip("_"))
    time = np.array([1e-9 * t for t in stamps])
    track = Track(name, "pose", time, pose, poses.missing, frame, absolute=True, numbered=False)
    return replace(track, dropped={SAME_TIME: len(poses.read) - len(rows)})


def _frame_name(frame: str) -> str:
    """Name of a frame in tracks."""
    return "world" if frame.strip("/") in _WORLDS else plain_name(frame)


def _begins_at_zero(stamps: Sequence[int]) -> bool:
    """Whether stamps, ns, are of a clock from zero, such as a simulator's, so that 0 is a time."""
    return 0 < max(stamps, default=0) <= 1e9 * EPOCH
