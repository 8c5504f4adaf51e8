"""Recordings: folders with one CSV a stream and a recording.toml, or the public layout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.atomic_folder import new_folder
from glissando.io.csv_stream import Rows, Stream, clean, read_named, read_public, scale_of, steady
from glissando.io.plain_file import file_stem
from glissando.io.provenance import require_readable
from glissando.io.recording_writer import write_streams
from glissando.io.robot_file import load_robot
from glissando.io.session_log import read_session
from glissando.io.session_recording import LOG, session_setup, session_streams
from glissando.io.shipped_robots import beside, shipped_robots
from glissando.io.toml_table import read_toml
from glissando.model.brief import Brief
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.readings import SENSORS, Readings
from glissando.model.sensors.sensors import sensor_class, sensor_kinds
from glissando.model.slide_track import slide_motion
from glissando.model.table import Table
from glissando.model.tendons.channel import Channel, ends_of

_TRUTH_STD = 1e-6  # noise of a truth stream that states none: negligible against any posterior


@dataclass(frozen=True)
class Recording(Brief):
    """A recorded session.

    Attributes:
        name: Name of the recording.
        folder: The folder it was read from.
        streams: Streams by name, in the world frame and SI units.
        robot: The robot, where the recording names it.
        window: First and last time (s) to estimate, where the recording states them.
        frames: Poses T_wf (4, 4) of the frames that streams came in, by stream; the world's
            streams are not there.
        allow: Names of checks of plausibility that are switched off.
        unknown_frames: Frames whose place in the world is not known; their streams stay in them.
    """

    name: str
    folder: Path
    streams: dict[str, Stream]
    robot: Robot | None
    window: tuple[float, float] | None
    frames: dict[str, Array] = field(default_factory=dict)
    allow: tuple[str, ...] = ()
    unknown_frames: frozenset[str] = frozenset()

    def readings(
        self,
        names: Sequence[str],
        robot: Robot,
        window: tuple[float, float],
        *,
        as_truth: bool = False,
    ) -> tuple[list[Readings], dict[str, dict[str, int]]]:
        """Readings of the named streams inside a window, and the rows dropped from each.

        Args:
            names: Names of streams.
            robot: Robot that states the noise of streams that do not.
            window: First and last time, s.
            as_truth: Whether estimates are judged by them; a truth stream without noise then counts
                as exact, while as a sensor it needs noise like any other.

        Returns:
            Readings of each stream, and the counts of dropped rows by stream and reason.

        Raises:
            RecordingError: A name is unknown, a stream has no noise, an arclength is off the robot,
                or nothing says where the stream's frame is.
        """
        out, dropped = [], {}
        moving = [p for p in robot.sensor_parameters if p.known and p.moves]
        for name in names:
            stream = self.stream(name)
            kind = stream.rows.kind
            self._require_frame(stream, robot)
            rows = clean(stream.rows, robot.sensor_range.get(kind), stream.keep_repeats)
            if not as_truth and kind in robot.sensor_rate:
                rows = steady(rows, robot.sensor_rate[kind])
            _require_on_robot(name, rows, robot, stream.channel)
            if rows.dropped:
                dropped[name] = rows.dropped
            readings = _as_readings(replace(stream, rows=rows), robot, as_truth)
            stamped, made = rows.time, corrected(readings, moving).time
            inside = np.minimum(stamped, made) >= window[0]
            out.append(readings.select(inside & (np.maximum(stamped, made) <= window[1])))
        return out, dropped

    def stream(self, name: str) -> Stream:
        """The stream of a name.

        Raises:
            RecordingError: There is none.
        """
        if name not in self.streams:
            raise RecordingError(
                f"{self.name} has no stream {name!r}; it has {', '.join(self.streams)}."
            )
        return self.streams[name]

    def _require_frame(self, stream: Stream, robot: Robot) -> None:
        """Raise RecordingError unless the frame of a stream is known or will be estimated."""
        estimated = [p.streams for p in robot.sensor_parameters if p.kind == "frame"]
        if stream.frame in self.unknown_frames and not any(stream.name in s for s in estimated):
            raise RecordingError(
                f"Stream {stream.name!r} is in the frame {stream.frame!r}, whose place in the "
                f"world is not known: run glissando calibrate {self.folder}, which finds it from "
                f"motion capture, with mount, delay and arclength, or state it in "
                f"[frames.{stream.frame}] of recording.toml."
            )

    def choose(
        self, use: Sequence[str] | None, truth: Sequence[str] | None
    ) -> tuple[list[str], list[str]]:
        """Names of the streams to use and to judge by; by default as the recording marks them.

        Raises:
            RecordingError: A stream is both, or its kind cannot be truth.
        """
        marked = [s.name for s in self.streams.values() if s.truth]
        chosen_truth = marked if truth is None else list(dict.fromkeys(truth))
        for name in chosen_truth:
            if name in self.streams and not self.streams[name].rows.sensor.tracker:
                trackers = ", ".join(kind for kind, sensor in SENSORS.items() if sensor.tracker)
                raise RecordingError(
                    f"Stream {name!r} is a {self.streams[name].rows.kind}; truth must be one of "
                    f"{trackers}."
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

    def span(self, names: Sequence[str] = ()) -> tuple[float, float]:
        """First and last time of any of these streams, of all unless given, seconds.

        Raises:
            RecordingError: They have no rows, as those of a journal whose sources were silent.
        """
        times = [self.streams[name].rows.time for name in names or self.streams]
        times = [time for time in times if time.size]
        if not times:
            of = f" of {', '.join(names)}" if names else ""
            raise RecordingError(
                f"{self.folder} holds no readings{of}; see that its sensors send, and record again."
            )
        return min(float(t[0]) for t in times), max(float(t[-1]) for t in times)


def load_recording(folder: str | Path) -> Recording:
    """Read a recording folder, or the log of a session, also of one that was killed.

    Raises:
        RecordingError: Something is wrong in it, with the file, the line and what to do.
    """
    folder = Path(folder)
    if folder.suffix == ".mcap" and folder.is_file():
        return _of_log(folder)
    if not folder.is_dir():
        raise RecordingError(
            f"There is no recording folder {str(folder)!r}; give a folder with one CSV a stream."
        )
    if (folder / "recording.toml").exists():
        return _described(folder)
    if (folder / LOG).is_file():
        return _of_log(folder / LOG)
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise RecordingError(
            f"{folder} holds no recording.toml and no CSV stream; is it the right folder?"
        )
    streams = {}
    for file in files:
        rows, truth = read_public(file)
        streams[file.stem] = Stream(file.stem, rows, truth)
    return Recording(folder.resolve().name, folder, streams, _fitting_robot(streams), None)


def _of_log(path: Path) -> Recording:
    """The recording that a session log holds, also one that was killed."""
    session = read_session(path)
    require_readable(session.metadata.get("format"), "session", path, RecordingError)
    logged = session_streams(session, session_setup(session), path.parent)
    robot = load_robot(beside(path.parent, logged.robot))
    frame = np.eye(4) if logged.frame is None else logged.frame
    unknown = frozenset({"tracker"} if logged.frame is None else ())
    streams = {}
    for stream in logged.streams:
        if stream.frame not in unknown and stream.frame != "world":
            values = stream.rows.sensor.in_frame(stream.rows.values, frame)
            stream = replace(stream, rows=replace(stream.rows, values=values), frame="world")
        streams[stream.name] = replace(stream, rows=clean(stream.rows, None, stream.keep_repeats))
    return Recording(logged.name, path.parent, streams, robot, None, unknown_frames=unknown)


def save_recording(
    recording: Recording,
    folder: Path,
    robot: str | Path = "",
    calibration: Mapping[str, Mapping[str, Any]] | None = None,
) -> None:
    """Write streams as they are, in the world frame, into a new folder that is a recording.

    Args:
        recording: Recording to write.
        folder: Folder to make.
        robot: Text that names the robot, or a robot file, which is copied into the folder.
        calibration: Value, std and unit of each constant that was found and applied.

    Raises:
        RecordingError: The folder holds something.
    """
    with new_folder(folder, RecordingError) as building:
        write_streams(
            building,
            recording.name,
            recording.streams.values(),
            robot=robot,
            frames=dict.fromkeys(sorted(recording.unknown_frames)),
            calibration=calibration,
            **({"window": list(recording.window)} if recording.window else {}),
            **({"allow": list(recording.allow)} if recording.allow else {}),
        )


def _fitting_robot(streams: dict[str, Stream]) -> Robot | None:
    """The shipped robot whose tip is where the last sensor of a public recording sits."""
    reach = max(float(s.rows.arclength.max()) for s in streams.values())
    robots = [load_robot(name) for name in shipped_robots()]
    return next((r for r in robots if abs(r.length - reach) < 1e-6), None)


def _described(folder: Path) -> Recording:
    file = folder / "recording.toml"
    table = read_toml(file, RecordingError)
    require_readable(table.text("format", ""), "recording", file, RecordingError)
    name = table.text("name", folder.resolve().name)
    journal = table.flag("journal")
    robot_name = table.text("robot", "")
    robot = load_robot(beside(folder, robot_name)) if robot_name else None
    window = None
    if table.peek("window") is not None:
        first, last = table.vector("window", 2).tolist()
        window = first, last
    allow = tuple(table.texts("allow")) if table.peek("allow") is not None else ()
    frames, streams, unknown = {"world": np.eye(4)}, {}, set()
    for frame, entry in table.named_tables("frames"):
        if entry.flag("unknown"):
            unknown.add(frame)
        frames[frame] = entry.pose() if frame not in unknown else np.eye(4)
        entry.close()
    for key in ("calibration", "made_by", "seed"):  # for the reader
        table.skip(key)
    came_in = {}
    for entry in table.tables("streams"):
        frame = entry.peek("frame")
        stream = _stream(folder, entry, frames, unknown, journal)
        if journal and not len(stream.rows.time):
            continue  # described, but nothing was written to it
        if stream.name in streams:
            raise entry.fail("name", f"{stream.name!r} is given twice; name each stream once.")
        streams[stream.name] = stream
        if frame not in (None, "world", *unknown):
            came_in[stream.name] = frames[frame]
    table.close()
    if not streams and not journal:
        raise RecordingError("recording.toml names no [[streams]]; add one for each CSV file.")
    return Recording(name, folder, streams, robot, window, came_in, allow, frozenset(unknown))


def _stream(
    folder: Path, entry: Table, frames: dict[str, Array], unknown: set[str], journal: bool
) -> Stream:
    name = entry.text("name")
    kind = entry.kind(sensor_kinds())
    sensor = sensor_class(kind)
    file = folder / entry.text("file", "")
    if file == folder:
        file = folder / f"{file_stem(name, RecordingError)}.csv"
    truth, keep_repeats = entry.flag("truth"), entry.flag("keep_repeats")
    length = {"m": 1.0, "mm": 1e-3}[entry.text("length_unit", "m", choices=("m", "mm"))]
    angle = {"rad": 1.0, "deg": np.pi / 180.0}[
        entry.text("angle_unit", "rad", choices=("rad", "deg"))
    ]
    frame = entry.text("frame", "world", choices=frames)
    mount_table = entry.table("mount")
    mount = mount_table.pose() if mount_table else np.eye(4)
    channel = entry.channel(length, angle)
    std = entry.std(sensor.rows) if entry.peek("std") is not None else None
    settings = {
        key: scale_of(unit, length, angle) * entry.numbers(key)
        for key, unit in {**sensor.settings, **sensor.optional_settings}.items()
        if key in sensor.settings or entry.peek(key) is not None
    }
    entry.close()
    rows = read_named(file, kind, settings, length_unit=length, angle_unit=angle, journal=journal)
    rows = replace(rows, values=sensor.in_frame(rows.values, frames[frame]))
    left = frame if frame in unknown else "world"
    rows = clean(rows, None, keep_repeats)
    return Stream(name, rows, truth, std, mount, keep_repeats, left, channel)


def _require_on_robot(name: str, rows: Rows, robot: Robot, channel: Channel | None) -> None:
    low, high = ends_of(channel, robot.length)
    excess = np.maximum(rows.arclength - high, low - rows.arclength)
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
        std = np.full(rows.sensor.rows, _TRUTH_STD)
    if std is None:
        raise RecordingError(
            f"Stream {stream.name!r}: neither the recording nor robot {robot.name!r} states the "
            f"noise of a {rows.kind} sensor; add [sensors.{rows.kind}] std to the robot file."
        )
    return rows.sensor(
        time=rows.time,
        arclength=rows.arclength,
        values=rows.values,
        cov=std**2 if std.size > 1 else std[0] ** 2,
        mount=stream.mount,
        channel=stream.channel,
        loss=None if as_truth else robot.sensor_loss.get(rows.kind),
        name=stream.name,
        **slide_motion(rows.time, rows.arclength),
        **rows.settings,
    )
