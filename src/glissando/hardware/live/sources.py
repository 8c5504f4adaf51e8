"""Where readings come from: each source gives what has come since it was last asked."""

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

    One whose readings come late for a reason, such as a stage that homes, may say so by an
    attribute `busy`; nobody loses patience while it is true.

    Attributes:
        name: What it is called in messages.
        first: Session time of its beginning, s, where it has one of its own, else None.
        clock: Session time, where the source alone can tell it, else None; once it is open.
    """

    name: str
    first: float | None

    @property
    def clock(self) -> SessionClock | None:
        """Session time."""

    @property
    def finished(self) -> bool:
        """Whether nothing more will come."""

    @property
    def counts(self) -> Counter[str]:
        """How often something went wrong, by its name."""

    def __enter__(self) -> Self:
        """Open the source."""

    def __exit__(self, *raised: object) -> None:
        """Close it."""

    def poll(self) -> None:
        """Take what has come out of its link, which may hold little, for `read`; never waits."""

    def read(self, clock: SessionClock) -> Sequence[Readings]:
        """Readings that have come since the last call, by session time; never waits."""

    @property
    def problem(self) -> str:
        """Why nothing comes, as a phrase; empty while all is well."""


class RecordingSource:
    """A recording at the pace at which it was recorded.

    Args:
        recording: Folder of the recording, or the recording.
        robot: Robot that states the noise of streams that do not.
        window: First and last time, s; the recording's own unless given.
        use: Names of streams; all but truth unless given.

    Raises:
        RecordingError: The recording, a stream or the window is wrong.
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
        self._last, self._given = span[1], -np.inf

    finished = property(lambda self: self._given >= self._last)
    problem, clock = "", None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        pass

    def poll(self) -> None:
        """Nothing waits in a link."""

    def read(self, clock: SessionClock) -> Sequence[Readings]:
        """The readings up to now."""
        since, self._given = self._given, min(clock.now(), self._last)
        some = [r.select((r.time > since) & (r.time <= self._given)) for r in self._readings]
        return [readings for readings in some if len(readings)]
