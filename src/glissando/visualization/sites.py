"""Streams as pictures draw them: one batch of readings a site."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import CoilReadings, PoseReadings, PositionReadings

NEAR = 0.1
"""Seconds: a truth sample this close to a drawn time is drawn with it."""
_FIXED_SITES = 12  # a stream at more arclengths than this slides and is one row of errors
_POSITIONED = PoseReadings | CoilReadings | PositionReadings  # streams that see a position


def sites_of(streams: Sequence[Readings], grid: Grid, kind: Any = _POSITIONED) -> list[Readings]:
    """The streams of a kind, inside the grid and in time order, one batch a site.

    A stream at a few fixed arclengths is split into them; one that slides stays whole.
    """
    out: list[Readings] = []
    for stream in (s for s in streams if isinstance(s, kind)):
        inside: Readings = stream.inside(grid)
        inside = inside.select(np.argsort(inside.time, kind="stable"))
        near = inside.arclength.round(6)
        if np.unique(near).size > _FIXED_SITES:
            near[:] = 0.0
        out.extend(inside.select(near == site) for site in np.unique(near))
    return out


def seen_positions(readings: Readings) -> Array:
    """Positions (M, 3) in the world that a batch of `sites_of` reports, metres."""
    return readings.values[:, :3, 3] if readings.values.ndim == 3 else readings.values
