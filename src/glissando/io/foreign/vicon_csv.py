"""Import of CSV files of Vicon Tracker (objects) and Nexus (segments, trajectories).

A section has a title, a number, names, labels, units, a row a frame, and ends in an empty line.
[inferred], to be verified on an export of one's own: an object that is not visible has empty cells,
a short row or six zeros; rotations are helical (rotation vectors, whose length is the angle), which
Tracker exports by default and the file does not state; frame 1 is time 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.foreign.delimited import cells_of
from glissando.io.foreign.tracks import (
    LENGTHS,
    Track,
    as_numbers,
    plain_name,
    require_ahead,
)

TITLES = ("Objects", "Segments", "Trajectories")
_RATED = ("Segments", "Trajectories")  # sources disagree on the meaning of Tracker's line 2
_POSE, _POINT = ["RX", "RY", "RZ", "TX", "TY", "TZ"], ["X", "Y", "Z"]
_UNITS = {**LENGTHS, "rad": 1.0, "deg": np.pi / 180.0}


@dataclass(frozen=True)
class _Section:
    """Cells of a section: its header, and its rows with their line numbers."""

    title: str
    number: str
    names: list[str]
    labels: list[str]
    units: list[str]
    rows: list[tuple[int, list[str]]]


def read_vicon_csv(path: Path, rate: float | None) -> list[Track]:
    """Read the objects, segments and markers of a Tracker or Nexus CSV file.

    Args:
        path: CSV file.
        rate: Frames a second; None to take Nexus's own. For Tracker it must be given, as sources
            disagree on the meaning of the number in its files.

    Raises:
        RecordingError: The file has no objects, or its content is invalid.
    """
    tracks: list[Track] = []
    for section in _sections(path):
        hz = _rate(path, section, rate)
        frames, rows = _frames(path, section)
        tracks += [_track(path, section, c, frames / hz, rows) for c in _columns(section)]
    if not tracks:
        raise RecordingError(
            f"{path.name} holds no objects, segments or trajectories; export some of them."
        )
    return tracks


def _sections(path: Path) -> Iterator[_Section]:
    lines = cells_of(path)
    at = 0
    while at < len(lines):
        title = lines[at][1][0]
        end = at + 1
        while end < len(lines) and any(lines[end][1]):
            end += 1
        if title in TITLES:
            if end - at < 5:
                raise RecordingError(
                    f"{path.name} line {lines[at][0]}: {title} end before their units; export it "
                    f"again."
                )
            (number, names, labels, units) = (lines[at + k][1] for k in range(1, 5))
            yield _Section(title, number[0], names, labels, units, lines[at + 5 : end])
        at = end + 1


def _rate(path: Path, section: _Section, given: float | None) -> float:
    if given is not None:
        return given
    try:
        rate = float(section.number)
    except ValueError:
        rate = 0.0
    if section.title not in _RATED or not 0.0 < rate < np.inf:
        raise RecordingError(
            f"{path.name}: its frame rate cannot be trusted (line 2 says {section.number!r}); give "
            f"the one that was set in Tracker or Nexus with --rate HZ."
        )
    return rate


def _frames(path: Path, section: _Section) -> tuple[Array, list[tuple[int, list[str]]]]:
    """Frame numbers (M,) from 0, and the rows that are whole frames."""
    frames: list[float] = []
    rows = []
    for line, cells in section.rows:
        number = as_numbers(path, line, cells[:2] if len(cells) > 1 and cells[1] else cells[:1])
        if number is None or (number.size == 2 and number[1] != 0.0):
            continue
        require_ahead(path, line, frames[-1] + 1.0 if frames else -np.inf, number[0])
        frames.append(number[0] - 1.0)
        rows.append((line, cells))
    return np.array(frames), rows


def _columns(section: _Section) -> list[tuple[str, list[int]]]:
    """Names of the section's objects, and the columns of their rotation and position."""
    starts = [c for c, name in enumerate(section.names) if name and c >= 2]
    objects = []
    for start, end in pairwise([*starts, len(section.labels)]):
        labels = section.labels[start:end]
        wanted = _POSE if "RX" in labels else _POINT
        if all(label in labels for label in wanted):
            objects.append((section.names[start], [start + labels.index(w) for w in wanted]))
    return objects


def _track(
    path: Path,
    section: _Section,
    column: tuple[str, list[int]],
    time: Array,
    rows: list[tuple[int, list[str]]],
) -> Track:
    name, at = column
    try:
        scale = np.array([_UNITS[section.units[c]] for c in at])
    except (KeyError, IndexError):
        raise RecordingError(
            f"{path.name}: the units of {name!r} are not {', '.join(_UNITS)}; export in mm."
        ) from None
    values, seen = np.empty((len(rows), len(at))), np.zeros(len(rows), dtype=bool)
    for k, (line, cells) in enumerate(rows):
        numbers = as_numbers(path, line, [cells[c] for c in at]) if len(cells) > max(at) else None
        if numbers is not None and np.any(numbers != 0.0):
            values[k], seen[k] = scale * numbers, True
    values, missing = values[seen], int(np.sum(~seen))
    if len(at) == 3:
        return Track(_name(name), "position", time[seen], values, missing)
    pose = se3.pose(se3.so3_exp(values[:, :3]), values[:, 3:])
    return Track(_name(name), "pose", time[seen], pose, missing)


def _name(text: str) -> str:
    """Name of an object: 'Global Angle Tip:Tip' gives Tip, 'Snake:Tip' gives Snake_Tip."""
    subject, _, part = text.removeprefix("Global Angle ").partition(":")
    return plain_name(subject if part in ("", subject) else f"{subject}_{part}")
