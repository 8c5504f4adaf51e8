"""Writing tracks of foreign files as a recording folder."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glissando.errors import OtherTimesWarning, RecordingError
from glissando.geometry.se3 import Array
from glissando.io.atomic import new_folder
from glissando.io.csv_stream import Rows, Stream
from glissando.io.foreign.columns import EPOCH, read_path
from glissando.io.foreign.tracks import Track
from glissando.io.recording_writer import write_streams
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file, shipped_robots
from glissando.model.robot import Robot

_FEW = 0.1  # share of rows within the times of a path, below which units are checked
_LONGEST = 50.0  # largest arclength, m
_KINDS = ("pose", "coil"), ("position",)


@dataclass(frozen=True)
class Choices:
    """Information that the user adds to foreign files, by track name.

    Attributes:
        arclength: Arclength, m, or a file with the path of a sliding sensor.
        truth: Names of tracks that are ground truth.
        shift: Seconds added to a track's times.
        kind: Kind as which a track is read: pose, coil or position.
        robot: Name of a shipped robot, or a robot file; None to name no robot.
        columns: Mapping of the columns of a file with a path, by the file's name, see `read_path`.
    """

    arclength: Mapping[str, float | Path]
    truth: Sequence[str] = ()
    shift: Mapping[str, float] = field(default_factory=dict)
    kind: Mapping[str, str] = field(default_factory=dict)
    robot: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)


def write_recording(tracks: Sequence[Track], folder: Path, choices: Choices) -> list[str]:
    """Write a recording folder, whole or not at all; tracks without an arclength are left out.

    Args:
        tracks: Tracks of foreign files.
        folder: Folder to create.
        choices: Information that the user adds.

    Returns:
        A line for each track: its rows, or why it was left out.

    Warns:
        OtherTimesWarning: Some times count from 1970 and others from a zero of their own.

    Raises:
        RecordingError: A name in `choices` is not that of a track, no track with an arclength has
            rows, or the folder exists and is not empty.
    """
    tracks = _distinct(tracks)
    _require_known(tracks, choices)
    robot = load_robot(choices.robot) if choices.robot else None
    tracks = [replace(t, absolute=t.absolute and _since_1970(t.time)) for t in tracks]
    used = [t for t in tracks if t.time.size and _is_used(t, choices)]
    start = min((float(t.time[0]) for t in used if t.absolute), default=0.0)
    _warn_of_two_clocks(used, choices, start)
    streams, lines = [], []
    for track in tracks:
        rows = _rows_of(track, choices, start, robot)
        if rows is None or not rows.time.size:
            why = "no arclength was given" if rows is None else _why_empty(rows)
            lines.append(f"{track.name}: left out, {why}")
            continue
        truth = track.name in choices.truth
        streams.append(
            Stream(track.name, rows, truth, keep_repeats=track.numbered, frame=track.frame)
        )
        lines.append(_line(track, rows))
    if not streams:
        cure = "say where on the robot each one sits with --arclength NAME=METRES,…"
        if all(track.name in choices.arclength for track in tracks):
            cure = "correct the files, or their clocks with --shift NAME=S,…"
        raise RecordingError(f"Nothing is left to write ({'; '.join(lines)}); {cure}")
    named: str | Path = choices.robot or ""
    if named:
        named = named if named in shipped_robots() else robot_file(named)
    frames = dict.fromkeys(sorted({s.frame for s in streams} - {"world"}))
    with new_folder(folder, RecordingError) as building:
        name = folder.resolve().name
        write_streams(building, name, streams, robot=named, frames=frames)
    return lines


def _distinct(tracks: Sequence[Track]) -> list[Track]:
    """Tracks with distinct names: a number is appended to a name that several have."""
    names = [track.name for track in tracks]
    used, out = {name for name in names if names.count(name) == 1}, []
    for track in tracks:
        numbered = (f"{track.name}_{number}" for number in count(1))
        several = names.count(track.name) > 1
        name = next(name for name in numbered if name not in used) if several else track.name
        used.add(name)
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


def _is_used(track: Track, choices: Choices) -> bool:
    """Whether a track's arclength is known, so that it is written."""
    return track.name in choices.arclength or track.kind == "tendon"


def _warn_of_two_clocks(used: Sequence[Track], choices: Choices, start: float) -> None:
    """Warn if some times count from 1970, and others do not and have no shift."""
    since = [t.name for t in used if t.absolute]
    own = [t.name for t in used if not t.absolute and t.name not in choices.shift]
    if since and own:
        warnings.warn(
            f"Times of {', '.join(since)} count from 1970, those of {', '.join(own)} from a zero "
            f"of their own, taken to be at {start:.6f} s, the first reading of the others. Say "
            f"with --shift {own[0]}=S how many seconds later it lies, below 0 where earlier.",
            OtherTimesWarning,
            stacklevel=3,
        )


def _tendon_rows(track: Track, time: Array, robot: Robot | None) -> Rows:
    """Rows of tendon displacements, in the order and with the channels of the robot's tendons."""
    tendons = None if robot is None else robot.tendons
    if tendons is None or len(tendons) != track.values.shape[1]:
        count = 0 if tendons is None else len(tendons)
        raise RecordingError(
            f"{track.name} has {track.values.shape[1]} tendons, the robot {count}; name a robot "
            f"file with their [tendons] by --robot."
        )
    lacking = [name for name in tendons.names if name not in track.columns]
    if tendons.named and track.columns and lacking:
        raise RecordingError(
            f"{track.name} has no column {lacking[0]!r} that [tendons] names of the robot states; "
            f"it has {', '.join(track.columns)}. Correct the names."
        )
    order = np.arange(len(tendons))
    if tendons.named and track.columns:
        order = np.array([track.columns.index(name) for name in tendons.names])
    place = np.full(time.size, tendons.end.max())
    return Rows("tendon", time, place, track.values[:, order], {}, tendons.settings())


def _rows_of(track: Track, choices: Choices, start: float, robot: Robot | None) -> Rows | None:
    """Rows of a track with arclengths, and absolute times since `start`; None without arclength."""
    if track.kind == "tendon":
        shift = choices.shift.get(track.name, 0.0)
        return _tendon_rows(track, track.time - start * track.absolute + shift, robot)
    place = choices.arclength.get(track.name)
    if isinstance(place, float | int) and abs(place) > _LONGEST:
        raise RecordingError(
            f"--arclength {track.name}={place:g} m is on no robot; give metres, not millimetres."
        )
    if place is None:
        return None
    time = track.time - (start if track.absolute else 0.0) + choices.shift.get(track.name, 0.0)
    kind = choices.kind.get(track.name, track.kind)
    possible = next((kinds for kinds in _KINDS if track.kind in kinds), (track.kind,))
    if kind not in possible:
        raise RecordingError(f"{track.name} is a {track.kind}; it cannot be read as {kind!r}.")
    if not isinstance(place, Path):
        return Rows(kind, time, np.full(time.size, place), track.values, {})
    path_time, path_arclength = read_path(place, choices.columns.get(place.name, ""))
    path_time = path_time - (start if _since_1970(path_time) else 0.0)
    inside = (time >= path_time[0]) & (time <= path_time[-1])
    _require_one_clock(track.name, time, path_time, inside)
    reason = "outside its path"
    if time.size and not inside.any():
        reason = (
            f"at {time[0]:.6g} to {time[-1]:.6g} s, outside its path, which goes from "
            f"{path_time[0]:.6g} to {path_time[-1]:.6g} s"
        )
    dropped = {reason: int(np.sum(~inside))} if not inside.all() else {}
    row_arclength = np.interp(time[inside], path_time, path_arclength)
    return Rows(kind, time[inside], row_arclength, track.values[inside], dropped)


def _require_one_clock(name: str, time: Array, path: Array, inside: NDArray[np.bool_]) -> None:
    """Raise RecordingError if one of times and path lasts about a thousand times the other."""
    spans = float(np.ptp(time)) if time.size else 0.0, float(np.ptp(path))
    if not all(spans) or not inside.any():
        return
    what = ""
    if inside.mean() < _FEW and 300.0 < spans[0] / spans[1] < 3000.0:
        what = "its times"
    elif 900.0 < spans[1] / spans[0] < 1100.0:
        what = "those of its path"
    if what:
        raise RecordingError(
            f"{name} was read from {time[0]:.6g} to {time[-1]:.6g} s, and its path goes from "
            f"{path[0]:.6g} to {path[-1]:.6g} s: {what} are probably in milliseconds; say so by "
            f"clock=ms among its --columns."
        )


def _since_1970(time: Array) -> bool:
    """Whether times count from 1970, rather than from a zero such as a simulator's."""
    return bool(time.size and time[0] > EPOCH)


def _why_empty(rows: Rows) -> str:
    """Reason why no rows are left."""
    return "".join(f"{n} rows {why}" for why, n in rows.dropped.items()) or "it was never seen"


def _line(track: Track, rows: Rows) -> str:
    span = f"{rows.time[0]:.3f} to {rows.time[-1]:.3f} s"
    places = dict.fromkeys(f"{s:g}" for s in (rows.arclength.min(), rows.arclength.max()))
    lost = {"not seen": track.missing, **track.dropped, **rows.dropped}
    gaps = "".join(f", {count} {why}" for why, count in lost.items() if count)
    return f"{track.name}: {rows.time.size} of {rows.kind}, {span}, at {'…'.join(places)} m{gaps}"
