"""Sources of readings: each returns the readings that have arrived since the last call."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, Self

import numpy as np

from glissando.evaluation.run import checked_window, chosen_streams
from glissando.hardware.live.clock import SessionClock
from glissando.io.recording import Recording
from glissando.io.recording_folder import load_recording
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings


class Source(Protocol):
    """A source of readings; a context manager.

    A source whose readings are late for a known reason, such as a stage that homes, may have an
    attribute `busy`; while it is true, the session's `patience` does not elapse.

    Attributes:
        name: Name of the source in messages.
        first: Session time at which the source begins, s; None for a source in real time.
        clock: Session clock, defined once the source is open, if the source has its own; else None.
    """

    name: str
    first: float | None

    @property
    def clock(self) -> SessionClock | None:
        """Session clock of the source, or None."""

    @property
    def finished(self) -> bool:
        """Whether no further readings will arrive."""

    @property
    def counts(self) -> Counter[str]:
        """Number of messages received and of failures, by name."""

    def __enter__(self) -> Self:
        """Open the source."""

    def __exit__(self, *raised: object) -> None:
        """Close the source."""

    def poll(self) -> None:
        """Receive waiting data for the next `read`, so that the link's buffer does not overflow."""

    def read(self, clock: SessionClock) -> Sequence[Readings]:
        """Readings (in session time) that have arrived since the last call; does not wait."""

    @property
    def problem(self) -> str:
        """Reason, as a phrase, why no readings arrive; empty without a problem."""


class RecordingSource:
    """Replays a recording in real time.

    Args:
        recording: Recording, or its folder.
        robot: Robot that defines the noise of streams without noise of their own.
        window: First and last time, s; those of the recording if None.
        use: Names of the streams to replay; all except the truth if None.

    Raises:
        RecordingError: The recording, a stream or the window is invalid.
    """

    def __init__(
        self,
        recording: Recording | Path | str,
        robot: Robot,
        *,
        window: tuple[float, float] | None = None,
        use: Sequence[str] | None = None,
    ) -> None:
        if not isinstance(recording, Recording):
            recording = load_recording(recording)
        self.name, self.counts = recording.name, Counter[str]()
        span = checked_window(recording, window)
        self._readings = chosen_streams(recording, robot, span, use, None)[0]
        self.first: float | None = span[0]
        self._last, self._until = span[1], -np.inf

    finished = property(lambda self: self._until >= self._last)
    problem, clock = "", None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        pass

    def poll(self) -> None:
        """Do nothing: a recording has no link."""

    def read(self, clock: SessionClock) -> Sequence[Readings]:
        """Readings since the last call, up to the present session time."""
        since, self._until = self._until, min(clock.now(), self._last)
        selected = [r.select((r.time > since) & (r.time <= self._until)) for r in self._readings]
        return [readings for readings in selected if len(readings)]
