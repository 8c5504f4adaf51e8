"""Reading and writing recordings: folders with a CSV a stream, public data, session logs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.atomic import new_folder
from glissando.io.csv_stream import Stream, clean, read_named, read_public, scale_of
from glissando.io.plain_file import file_stem
from glissando.io.provenance import require_readable
from glissando.io.recording import Recording
from glissando.io.recording_writer import write_streams
from glissando.io.robot_file import load_robot
from glissando.io.session_log import read_session
from glissando.io.session_recording import LOG, session_setup, session_streams
from glissando.io.shipped_robots import beside, shipped_robots
from glissando.io.toml_table import read_toml
from glissando.model.robot import Robot
from glissando.model.sensors.sensors import sensor_class, sensor_kinds
from glissando.model.table import Table


def load_recording(folder: str | Path) -> Recording:
    """Read a recording folder, or the log of a session, which may have been cut off.

    Raises:
        RecordingError: The recording is invalid; the message names the file, the line and a remedy.
    """
    if not isinstance(folder, str | PathLike):
        raise RecordingError(f"load_recording was given {folder!r}; give a recording's folder.")
    folder = Path(folder)
    if folder.suffix == ".mcap" and folder.is_file():
        return _read_log(folder)
    if not folder.is_dir():
        raise RecordingError(
            f"There is no recording folder {str(folder)!r}; give a folder with one CSV a stream."
        )
    if (folder / "recording.toml").exists():
        return _read_described(folder)
    if (folder / LOG).is_file():
        return _read_log(folder / LOG)
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise RecordingError(
            f"{folder} holds no recording.toml and no CSV stream; is it the right folder?"
        )
    streams = {}
    for file in files:
        rows, truth = read_public(file)
        streams[file.stem] = Stream(file.stem, rows, truth)
    return Recording(folder.resolve().name, folder, streams, _matching_robot(streams), None)


def _read_log(path: Path) -> Recording:
    """Recording of a session log, which may have been cut off."""
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
    """Write a recording into a new folder, with its streams in their present frames.

    Args:
        recording: Recording to write.
        folder: Folder to create.
        robot: Name of a robot, or path of a robot file, which is copied into the folder.
        calibration: Value, std and unit of each calibrated constant applied to the streams.

    Raises:
        RecordingError: The folder exists and is not empty.
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


def _matching_robot(streams: dict[str, Stream]) -> Robot | None:
    """The shipped robot as long as the largest arclength of a public recording, or None."""
    reach = max(float(s.rows.arclength.max()) for s in streams.values())
    robots = [load_robot(name) for name in shipped_robots()]
    return next((r for r in robots if abs(r.length - reach) < 1e-6), None)


def _read_described(folder: Path) -> Recording:
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
    recorded_in = {}
    for entry in table.tables("streams"):
        frame = entry.peek("frame")
        stream = _stream(folder, entry, frames, unknown, journal)
        if journal and not len(stream.rows.time):
            continue  # described, but nothing was written to it
        if stream.name in streams:
            raise entry.fail("name", f"{stream.name!r} is given twice; name each stream once.")
        streams[stream.name] = stream
        if frame not in (None, "world", *unknown):
            recorded_in[stream.name] = frames[frame]
    table.close()
    if not streams and not journal:
        raise RecordingError("recording.toml names no [[streams]]; add one for each CSV file.")
    return Recording(name, folder, streams, robot, window, recorded_in, allow, frozenset(unknown))


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
    remaining_frame = frame if frame in unknown else "world"
    rows = clean(rows, None, keep_repeats)
    return Stream(name, rows, truth, std, mount, keep_repeats, remaining_frame, channel)
