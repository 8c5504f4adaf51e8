"""Readings held by an online estimator, from one time on, to be linearised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from glissando.model.grid import Index
from glissando.model.sensors.compiled_readings import ReadingRows
from glissando.model.sensors.readings import Readings


@dataclass(frozen=True)
class HeldReadings:
    """Readings at and after a time.

    Attributes:
        streams: Readings of streams that are not stored as rows, none empty.
        rows: Readings that are stored as rows, of any time.
        which: Indices (M,) of the rows at and after the time.
        labels: Label and degrees of freedom of the streams in `rows`, by number of the stream.
    """

    streams: Sequence[Readings] = ()
    rows: ReadingRows = field(default_factory=ReadingRows)
    which: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    labels: Sequence[tuple[str, int]] = ()
