"""Tracks of foreign files become a recording folder."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import RecordingError
from glissando.evaluation.run import read_query
from glissando.geometry.se3 import Array
from glissando.io import recording_toml
from glissando.io.atomic_folder import new_folder
from glissando.io.csv_stream import Rows, write_named
from glissando.io.foreign.tracks import Track
from glissando.io.robot_file import load_robot, robot_file, shipped_robots

_FRAMES = "# Fill in where each frame stands in the world; quaternions are w, x, y, z.\n"


@dataclass(frozen=True)
class Choices:
    """What foreign files do not say, by track name.

    `arclength` is metres, or a CSV file with the columns time,arclength of a sensor that slides.
    `shift` is added to a track's times, seconds. `kind` is pose, coil or position.
    """

    arclength: Mapping[str, float | Path]
    truth: Sequence[str] = ()
    shift: Mapping[str, float] = field(default_factory=dict)
    kind: Mapping[str, str] = field(default_factory=dict)
    robot: str | None = None


def write_recording(tracks: Sequence[Track], folder: Path, choices: Choices) -> list[str]:
    """Write a recording folder, whole or not at all; returns a line a track on what became of it.

    Tracks without an arclength are left out. Raises RecordingError for a name that no track has,
    when no track has an arclength, and when the folder holds something already.
    """
    tracks = _distinct(tracks)
    _require_known(tracks, choices)
    start = min((float(t.time[0]) for t in tracks if t.absolute and t.time.size), default=0.0)
    streams, told = {}, []
    for track in tracks:
        rows = _placed(track, choices, start)
        if rows is None or not rows.time.size:
            why = "no arclength was given" if rows is None else "it was never seen"
            told.append(f"{track.name}: left out, {why}")
            continue
        streams[track.name] = track, rows
        told.append(_line(track, rows))
    if not streams:
        raise RecordingError(
            f"Nothing is left to write ({'; '.join(told)}); say where on the robot each one sits "
            f"with --arclength NAME=METRES,…"
        )
    with new_folder(folder, RecordingError) as building:
        for name, (_, rows) in streams.items():
            write_named(building / f"{name}.csv", rows)
        text = _description(folder, building, [t for t, _ in streams.values()], choices)
        (building / "recording.toml").write_text(text, encoding="utf-8")
    return told


def _distinct(tracks: Sequence[Track]) -> list[Track]:
    """Tracks with a number behind the names that several have."""
    names = [track.name for track in tracks]
    out = []
    for k, track in enumerate(tracks):
        again = names[:k].count(track.name)
        name = f"{track.name}_{again + 1}" if names.count(track.name) > 1 else track.name
        out.append(replace(track, name=name))
    return out


def _require_known(tracks: Sequence[Track], choices: Choices) -> None:
    names = [track.name for track in tracks]
    for given in (choices.arclength, choices.truth, choices.shift, choices.kind):
        for name in given:
            if name not in names:
                raise RecordingError(
                    f"The files hold no {name!r}; they hold {', '.join(names)}. Correct the name."
                )


def _placed(track: Track, choices: Choices, start: float) -> Rows | None:
    """Rows of a track where it sat and when, None when nobody says where that is."""
    place = choices.arclength.get(track.name)
    if place is None:
        return None
    time = track.time - (start if track.absolute else 0.0) + choices.shift.get(track.name, 0.0)
    kind = choices.kind.get(track.name, track.kind)
    if (kind == "position") != (track.kind == "position") or kind not in (
        *("pose", "coil", "position"),
    ):
        raise RecordingError(f"{track.name} is a {track.kind}; it cannot be read as {kind!r}.")
    if not isinstance(place, Path):
        return Rows(kind, time, np.full(time.size, place), track.values, {})
    at, arclength = _slide(place)
    inside = (time >= at[0]) & (time <= at[-1])
    dropped = {"outside its path": int(np.sum(~inside))} if not inside.all() else {}
    where = np.interp(time[inside], at, arclength)
    return Rows(kind, time[inside], where, track.values[inside], dropped)


def _slide(path: Path) -> tuple[Array, Array]:
    time, arclength = read_query(path)
    if not np.all(np.diff(time) > 0.0):
        raise RecordingError(f"{path.name}: its times must increase; sort its rows.")
    return time, arclength


def _line(track: Track, rows: Rows) -> str:
    span = f"{rows.time[0]:.3f} to {rows.time[-1]:.3f} s"
    places = dict.fromkeys(f"{s:g}" for s in (rows.arclength.min(), rows.arclength.max()))
    lost = {"not seen": track.missing, **rows.dropped}
    gaps = "".join(f", {count} {why}" for why, count in lost.items() if count)
    return f"{track.name}: {rows.time.size} of {rows.kind}, {span}, at {'…'.join(places)} m{gaps}"


def _description(folder: Path, building: Path, tracks: Sequence[Track], choices: Choices) -> str:
    """The text of recording.toml; a robot file of the user's own is copied beside it."""
    robot = choices.robot or ""
    if robot:
        load_robot(robot)
        if robot not in shipped_robots():
            shutil.copy(robot_file(robot), building / "robot.toml")
            robot = "robot.toml"
    text = recording_toml.head(folder.resolve().name, robot)
    frames = sorted({t.frame for t in tracks} - {"world"})
    if frames:
        text += "\n" + _FRAMES + "".join(recording_toml.frame(name, np.eye(4)) for name in frames)
    for track in tracks:
        kind = choices.kind.get(track.name, track.kind)
        fields: dict[str, Any] = {"name": track.name, "kind": kind, "frame": track.frame}
        fields |= {"truth": track.name in choices.truth, "keep_repeats": track.numbered}
        text += recording_toml.stream(fields)
    return text
