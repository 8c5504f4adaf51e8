"""Checks of the arrays given to readings: numbers, rotations, and repeated rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glissando.errors import SensorError
from glissando.geometry.se3 import Array


def numbers(label: str, name: str, value: Any) -> Array:
    """Convert to an array of numbers. Raises SensorError for text, dates, complex, masked rows."""
    try:
        given = np.asanyarray(value)
        if given.dtype.kind not in "mMc":
            given = given.astype(float)
    except (TypeError, ValueError):
        raise SensorError(f"{label}: {name} is {value!r}; give numbers.") from None
    if np.ma.is_masked(given):
        row = np.argwhere(np.ma.getmaskarray(given))[0, 0]
        raise SensorError(f"{label}: {name} of row {row} is masked; drop masked rows.")
    if given.dtype.kind in "mMc":
        raise SensorError(
            f"{label}: {name} is of type {given.dtype}; give numbers, times in seconds (of "
            f"dates, as in (t - t[0]) / np.timedelta64(1, 's'))."
        )
    return np.asarray(given, dtype=float)


def require_rotations(label: str, values: Array) -> None:
    """Raise SensorError unless values (M, 4, 4) or (M, 3, 3) are poses or rotations."""
    rotation = values[:, :3, :3]
    gap = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(axis=(-1, -2), initial=0)
    sound = (gap <= 1e-3) & (np.linalg.det(rotation) > 0.0)
    if values.shape[-1] == 4:
        sound &= np.all(values[:, 3] == [0.0, 0.0, 0.0, 1.0], axis=-1)
    if not np.all(sound):
        raise SensorError(
            f"{label}: row {int(np.argmin(sound))} is not a rigid motion; give rotation matrices "
            f"(orthonormal, right-handed), poses with a last row 0 0 0 1."
        )


def repeats_at_place(columns: Array, arclength: Array) -> NDArray[np.bool_]:
    """Mask (M,) of rows of columns (M, C) that repeat the last row at the same arclength (M,)."""
    repeats = np.zeros(len(columns), dtype=bool)
    order = np.argsort(arclength, kind="stable")
    same_place = np.diff(arclength[order]) == 0.0
    repeats[order[1:]] = same_place & np.all(columns[order[1:]] == columns[order[:-1]], axis=1)
    return repeats
