"""Readings that an online estimator holds: those of one span of time, to linearise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from glissando.model.grid import Index
from glissando.model.sensors.compiled_readings import ReadingRows
from glissando.model.sensors.readings import Readings


@dataclass(frozen=True)
class HeldReadings:
    """Readings of some time and after.

    Attributes:
        streams: Those that come stream by stream, none empty.
        rows: Those that come as rows, of any time.
        which: Rows (M,) of the time asked for.
        labels: Label and degrees of freedom of the streams of rows, by their numbers.
    """

    streams: Sequence[Readings] = ()
    rows: ReadingRows = field(default_factory=ReadingRows)
    which: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    labels: Sequence[tuple[str, int]] = ()
