"""Import of CSV files of OptiTrack Motive: rigid bodies and labelled markers.

A file has a line of settings in pairs, among them the rate, the units and the type of rotation;
then lines of types, names, identities, quantities and axes above the columns; then a row a frame.
[inferred], to be verified on an export of one's own: an object that is not visible has empty cells;
Euler angles are intrinsic, in degrees, in the order named by the type of rotation.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.foreign.delimited import Line, cells_of, samples
from glissando.io.foreign.tracks import Track, plain_name, unit_rotations

_LENGTHS = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3}
_TITLE = "format version"


def is_motive_header(cells: list[str]) -> bool:
    """Whether the cells of a first line are Motive's settings."""
    return cells[0].lower() == _TITLE


def read_motive_csv(path: Path, rate: float | None) -> list[Track]:
    """Read the rigid bodies and markers of a Motive CSV file.

    Args:
        path: CSV file.
        rate: Frames a second, to compute times from frame numbers; None to take the file's times.

    Raises:
        RecordingError: The file has no objects, or its content is invalid.
    """
    lines = cells_of(path)
    pairs = zip(lines[0][1][::2], lines[0][1][1::2], strict=False)
    settings = {name.lower(): value for name, value in pairs}
    scale = _LENGTHS.get(settings.get("length units", "meters").lower())
    if scale is None:
        raise RecordingError(
            f"{path.name}: its length units are {settings['length units']!r}; export in one of "
            f"{', '.join(_LENGTHS)}."
        )
    top = next((k for k, (_, c) in enumerate(lines) if c[0].lower() == "frame"), None)
    if top is None or top < 4:
        raise RecordingError(f"{path.name} has no line of columns Frame,Time; export it again.")
    heads = [_row(lines, top, "name"), lines[top - 1][1], lines[top][1]]
    rows = [(number, cells) for number, cells in lines[top + 1 :] if any(cells)]
    kind = settings.get("rotation type", "Quaternion")
    tracks = []
    for name, columns in _objects(heads).items():
        turn = [columns[key] for key in ("rX", "rY", "rZ", "rW") if key in columns]
        place = [columns[f"p{axis}"] for axis in "XYZ"]
        clock, seconds = (0, 1.0 / rate) if rate else (1, 1.0)
        seen = samples(path, rows, clock, [*place, *turn], seconds)
        at, what = scale * seen.values[:, :3], "position"
        values = at
        if turn:
            what, values = "pose", se3.pose(_rotations(path, kind, seen.values[:, 3:]), at)
        track = Track(plain_name(name), what, seen.time, values, seen.missing)
        tracks.append(replace(track, dropped=seen.dropped))
    if not tracks:
        raise RecordingError(f"{path.name} holds no rigid bodies or markers; export some of them.")
    return tracks


def _row(lines: list[Line], top: int, title: str) -> list[str]:
    """Line above the columns whose title, in its second cell, is `title`; else the third above."""
    matching = (c for _, c in lines[:top] if len(c) > 1 and c[1].lower() == title)
    return next(matching, lines[max(top - 3, 0)][1])


def _objects(heads: list[list[str]]) -> dict[str, dict[str, int]]:
    """Columns of each object's rotation (rX, …) and position (pX, …), by the object's name."""
    names, quantities, axes = heads
    out: dict[str, dict[str, int]] = {}
    for column in range(2, min(map(len, heads))):
        part = {"rotation": "r", "position": "p"}.get(quantities[column].lower())
        if part and names[column] and axes[column].upper() in ("X", "Y", "Z", "W"):
            out.setdefault(names[column], {}).setdefault(part + axes[column].upper(), column)
    return {name: c for name, c in out.items() if {"pX", "pY", "pZ"} <= c.keys()}


def _rotations(path: Path, kind: str, values: Array) -> Array:
    """Rotations (M, 3, 3) of Motive's quaternions x, y, z, w or Euler angles about x, y, z, deg."""
    if values.shape[1] == 4:
        return unit_rotations(path, values[:, [3, 0, 1, 2]])
    order = kind.strip()[:3].upper()
    if sorted(order) != ["X", "Y", "Z"] or values.shape[1] != 3:
        raise RecordingError(
            f"{path.name}: its rotation type is {kind!r}; export quaternions, or XYZ angles."
        )
    angles = values[:, ["XYZ".index(axis) for axis in order]]
    return np.asarray(Rotation.from_euler(order, angles, degrees=True).as_matrix())
