"""c3d files: the points that motion capture labelled."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from glissando.errors import GlissandoError, RecordingError
from glissando.io.foreign.tracks import LENGTHS, Track, plain_name


def read_c3d(path: Path, rate: float | None) -> list[Track]:
    """Points of a c3d file as positions; a residual below zero is a gap.

    Args:
        path: The file.
        rate: Frames a second, which override POINT:RATE.

    Raises:
        RecordingError: The file cannot be read, or states no units or rate.
        GlissandoError: ezc3d is not installed.
    """
    try:
        import ezc3d
    except ImportError:
        raise GlissandoError(
            "Reading c3d files needs the package ezc3d; run pip install 'glissando[hardware]'."
        ) from None
    try:
        file = ezc3d.c3d(str(path))
    except (OSError, ValueError, RuntimeError) as problem:
        raise RecordingError(f"{path.name} cannot be read as c3d ({problem}).") from None
    point = file["parameters"]["POINT"]
    units = "".join(point["UNITS"]["value"]).strip().lower() if "UNITS" in point else ""
    hz = rate or float(file["header"]["points"]["frame_rate"])
    if units not in LENGTHS or not hz > 0.0:
        raise RecordingError(
            f"{path.name}: points at {hz:g} Hz in {units!r}; give POINT:UNITS as one of "
            f"{', '.join(LENGTHS)}, and the rate with --rate HZ where there is none."
        )
    points = LENGTHS[units] * file["data"]["points"][:3]  # (3, points, frames)
    gap = file["data"]["meta_points"]["residuals"][0] < 0.0
    time = (file["header"]["points"]["first_frame"] + np.arange(points.shape[2])) / hz
    tracks = []
    for k, label in enumerate(point["LABELS"]["value"][: points.shape[1]]):
        seen = np.all(np.isfinite(points[:, k]), axis=0) & ~gap[k]
        values = points[:, k, seen].T
        tracks.append(Track(plain_name(label), "position", time[seen], values, int(np.sum(~seen))))
    if not tracks:
        raise RecordingError(f"{path.name} holds no labelled points; label some and save again.")
    return tracks
