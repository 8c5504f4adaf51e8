"""Recordings: folders with one CSV a stream and a recording.toml, or the public layout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io import recording_toml
from glissando.io.atomic_folder import new_folder
from glissando.io.csv_stream import (
    TRUTH_KINDS,
    Rows,
    clean,
    read_named,
    read_public,
    steady,
    write_named,
)
from glissando.io.robot_file import Robot, load_robot, shipped_robots
from glissando.io.toml_table import Table, read_toml
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import (
    ROWS,
    CoilReadings,
    FbgReadings,
    GyroReadings,
    OrientationReadings,
    PoseReadings,
    PositionReadings,
    StrainReadings,
)

_TRUTH_STD = 1e-6  # noise of a truth stream that states none: negligible against any posterior
KINDS: dict[str, type[Readings]] = {
    "pose": PoseReadings,
    "coil": CoilReadings,
    "position": PositionReadings,
    "orientation": OrientationReadings,
    "gyro": GyroReadings,
    "strain": StrainReadings,
    "fbg": FbgReadings,
}
"""Readings by the name of their kind in a recording."""


@dataclass(frozen=True)
class Stream:
    """One sensor's rows with what its description says of it.

    `std` overrides the robot file's noise for this kind; `mount` (4, 4) is T_bc; `extra` holds the
    settings only its kind has (core_radius and core_angle of a fibre). `keep_repeats` takes rows
    that repeat the one before for readings, not for a tracker polled too fast.
    """

    name: str
    rows: Rows
    truth: bool
    std: Array | None
    mount: Array
    extra: dict[str, Array]
    keep_repeats: bool = False


@dataclass(frozen=True)
class Recording:
    """A recorded session: streams in the world frame and SI units, and the robot if it is named."""

    name: str
    folder: Path
    streams: dict[str, Stream]
    robot: Robot | None
    window: tuple[float, float] | None

    def readings(
        self,
        names: Sequence[str],
        robot: Robot,
        window: tuple[float, float],
        *,
        as_truth: bool = False,
    ) -> tuple[list[Readings], dict[str, dict[str, int]]]:
        """Readings of the named streams inside a window, and what was dropped from each.

        `as_truth` judges by them: a stream marked as truth that states no noise then counts as
        exact. Used as a sensor it needs noise like any other, its own or the robot file's.
        Raises RecordingError for an unknown name, a stream without noise, an arclength outside
        the robot.
        """
        out, dropped = [], {}
        for name in names:
            if name not in self.streams:
                raise RecordingError(
                    f"{self.name} has no stream {name!r}; it has {', '.join(self.streams)}."
                )
            stream = self.streams[name]
            rows = clean(stream.rows, robot.clip, stream.keep_repeats)
            if not as_truth and rows.kind in robot.sensor_rate:
                rows = steady(rows, robot.sensor_rate[rows.kind])
            _require_on_robot(name, rows, robot)
            found = _as_readings(replace(stream, rows=rows), robot, as_truth)
            inside = (found.time >= window[0]) & (found.time <= window[1])
            if rows.dropped:
                dropped[name] = rows.dropped
            out.append(found.select(inside))
        return out, dropped

    def choose(
        self, use: Sequence[str] | None, truth: Sequence[str] | None
    ) -> tuple[list[str], list[str]]:
        """Names of the streams to use and to judge by; by default as the recording marks them."""
        marked = [s.name for s in self.streams.values() if s.truth]
        chosen_truth = marked if truth is None else list(dict.fromkeys(truth))
        for name in chosen_truth:
            kind = self.streams[name].rows.kind if name in self.streams else TRUTH_KINDS[0]
            if kind not in TRUTH_KINDS:
                raise RecordingError(
                    f"Stream {name!r} is a {kind}; truth must be one of {', '.join(TRUTH_KINDS)}."
                )
        if use is None:
            use = [n for n in self.streams if n not in marked and n not in chosen_truth]
        both = set(use) & set(chosen_truth)
        if both:
            raise RecordingError(
                f"{', '.join(sorted(both))} cannot be used and be truth at once; name each stream "
                f"in --use or in --truth."
            )
        return list(dict.fromkeys(use)), chosen_truth

    def span(self) -> tuple[float, float]:
        """First and last time of any stream, seconds."""
        times = [s.rows.time for s in self.streams.values()]
        return min(float(t[0]) for t in times), max(float(t[-1]) for t in times)


def load_recording(folder: str | Path) -> Recording:
    """Read a recording folder. Raises RecordingError with the file, the line and what to do."""
    folder = Path(folder)
    if not folder.is_dir():
        raise RecordingError(
            f"There is no recording folder {str(folder)!r}; give a folder with one CSV a stream."
        )
    if (folder / "recording.toml").exists():
        return _described(folder)
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise RecordingError(
            f"{folder} holds no recording.toml and no CSV stream; is it the right folder?"
        )
    streams = {}
    for file in files:
        rows, truth = read_public(file)
        streams[file.stem] = Stream(file.stem, rows, truth, None, np.eye(4), {})
    return Recording(folder.resolve().name, folder, streams, _fitting_robot(streams), None)


def save_recording(recording: Recording, folder: Path, robot: str = "") -> None:
    """Write streams as they are, in the world frame, into a new folder that is a recording.

    `robot` is a shipped robot's name or a robot file's path. Raises RecordingError when the folder
    holds something.
    """
    with new_folder(folder, RecordingError) as building:
        parts = [recording_toml.head(recording.name, robot)]
        for stream in recording.streams.values():
            write_named(building / f"{stream.name}.csv", stream.rows)
            fields = {"name": stream.name, "kind": stream.rows.kind, "truth": stream.truth}
            fields |= {"keep_repeats": stream.keep_repeats}
            fields |= ({} if stream.std is None else {"std": stream.std}) | stream.extra
            parts.append(recording_toml.stream(fields, stream.mount))
        (building / "recording.toml").write_text("".join(parts), encoding="utf-8")


def _fitting_robot(streams: dict[str, Stream]) -> Robot | None:
    """The shipped robot whose tip is where the last sensor of a public recording sits."""
    reach = max(float(s.rows.arclength.max()) for s in streams.values())
    robots = [load_robot(name) for name in shipped_robots()]
    return next((r for r in robots if abs(r.length - reach) < 1e-6), None)


def _described(folder: Path) -> Recording:
    table = read_toml(folder / "recording.toml", RecordingError)
    name = table.text("name", folder.resolve().name)
    journal = table.flag("journal")
    robot_name = table.text("robot", "")
    robot = None
    if robot_name:
        beside = folder / robot_name
        robot = load_robot(beside if beside.is_file() else robot_name)
    window = None
    if table.peek("window") is not None:
        first, last = table.vector("window", 2)
        window = (float(first), float(last))
    frames = {"world": np.eye(4)}
    given = table.table("frames")
    for frame in given.names() if given else []:
        entry = given.table(frame) if given else None
        assert entry is not None
        frames[frame] = entry.pose()
        entry.close()
    streams = {}
    for entry in table.tables("streams"):
        stream = _stream(folder, entry, frames, journal)
        if journal and not len(stream.rows.time):
            continue  # described, and nothing came of it
        if stream.name in streams:
            raise entry.fail("name", f"{stream.name!r} is given twice; name each stream once.")
        streams[stream.name] = stream
    table.close()
    if not streams and not journal:
        raise RecordingError("recording.toml names no [[streams]]; add one for each CSV file.")
    return Recording(name, folder, streams, robot, window)


def _stream(folder: Path, entry: Table, frames: dict[str, Array], journal: bool) -> Stream:
    name = entry.text("name")
    kind = entry.text("kind", choices=ROWS)
    file = folder / entry.text("file", f"{name}.csv")
    truth, keep_repeats = entry.flag("truth"), entry.flag("keep_repeats")
    length_unit = {"m": 1.0, "mm": 1e-3}[entry.text("length_unit", "m", choices=("m", "mm"))]
    angle_unit = {"rad": 1.0, "deg": np.pi / 180.0}[
        entry.text("angle_unit", "rad", choices=("rad", "deg"))
    ]
    frame = entry.text("frame", "world", choices=frames)
    mount_table = entry.table("mount")
    mount = mount_table.pose() if mount_table else np.eye(4)
    std = entry.std(ROWS[kind]) if entry.peek("std") is not None else None
    extra: dict[str, Array] = {}
    if kind == "fbg":
        given = entry.peek("core_radius")
        if not isinstance(given, list) or not given:
            raise entry.fail("core_radius", "must be a list, one radius a core.")
        radius, angle = (entry.vector(key, len(given)) for key in ("core_radius", "core_angle"))
        extra = {"core_radius": radius * length_unit, "core_angle": angle * angle_unit}
    entry.close()
    cores = len(extra["core_radius"]) if extra else 0
    rows = read_named(file, kind, cores, length_unit, angle_unit, journal=journal)
    rows = clean(replace(rows, values=_to_world(rows, frames[frame])), None, keep_repeats)
    return Stream(name, rows, truth, std, mount, extra, keep_repeats)


def _to_world(rows: Rows, T_wf: Array) -> Array:
    if rows.kind in ("pose", "coil"):
        return T_wf @ rows.values
    if rows.kind == "position":
        return rows.values @ T_wf[:3, :3].T + T_wf[:3, 3]
    if rows.kind == "orientation":
        return T_wf[:3, :3] @ rows.values
    return rows.values


def _require_on_robot(name: str, rows: Rows, robot: Robot) -> None:
    excess = np.maximum(rows.arclength - robot.length, -rows.arclength)
    bad = np.flatnonzero(excess > 1e-9)
    if bad.size:
        places = ", ".join(f"{rows.arclength[i]:.4g}" for i in bad[:3])
        raise RecordingError(
            f"Stream {name!r}: {bad.size} rows lie outside robot {robot.name!r} of length "
            f"{robot.length:g} m: rows {', '.join(map(str, bad[:3]))} at {places} m, up to "
            f"{excess.max():.3g} m beyond. Choose another robot with --robot, or correct them."
        )


def _as_readings(stream: Stream, robot: Robot, as_truth: bool) -> Readings:
    rows = stream.rows
    std = stream.std if stream.std is not None else robot.sensor_std.get(rows.kind)
    if as_truth and stream.truth and stream.std is None:
        std = np.full(ROWS[rows.kind], _TRUTH_STD)
    if std is None:
        raise RecordingError(
            f"Stream {stream.name!r}: neither the recording nor robot {robot.name!r} states the "
            f"noise of a {rows.kind} sensor; add [sensors.{rows.kind}] std to the robot file."
        )
    settings: dict[str, Any] = dict(stream.extra)
    if rows.kind == "fbg":
        std = np.full(rows.values.shape[1], std[0])
    return KINDS[rows.kind](
        time=rows.time,
        arclength=rows.arclength,
        values=rows.values,
        cov=std**2,
        mount=stream.mount,
        loss=None if as_truth else robot.sensor_loss.get(rows.kind),
        name=stream.name,
        **settings,
    )
