"""Streams as pictures draw them: one batch of readings for each site."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import CoilReadings, PoseReadings, PositionReadings

NEAR = 0.1
"""Largest time difference, s, between a drawn time and the truth sample drawn with it."""
_FIXED_SITES = 12  # a stream with more distinct arclengths than this counts as sliding
_SEEN = 2  # readings a site of a stream that does not slide, on average, unless simultaneous
_POSITIONED = PoseReadings | CoilReadings | PositionReadings  # streams that measure a position


def sites_of(streams: Sequence[Readings], grid: Grid, kind: Any = _POSITIONED) -> list[Readings]:
    """Split streams of a kind, inside the grid and in time order, into one batch for each site.

    A stream at a few fixed arclengths is split into one batch each; a sliding one stays whole, also
    where it has few readings.
    """
    out: list[Readings] = []
    for stream in (s for s in streams if isinstance(s, kind)):
        inside: Readings = stream.inside(grid)
        inside = inside.select(np.argsort(inside.time, kind="stable"))
        near = inside.arclength.round(6)
        if _slides(inside.time, near):
            near[:] = 0.0
        out.extend(inside.select(near == site) for site in np.unique(near))
    return out


def _slides(time: Array, arclength: Array) -> bool:
    """Whether readings (M,) are of one sensor that slides: at many places, or at each only once."""
    places = np.unique(arclength).size
    one_at_a_time = np.unique(time).size == time.size
    return places > _FIXED_SITES or (one_at_a_time and time.size < _SEEN * places)


def seen_positions(readings: Readings) -> Array:
    """Positions (M, 3) in the world frame measured by a batch of `sites_of`, m."""
    return readings.values[:, :3, 3] if readings.values.ndim == 3 else readings.values
