"""The guard of a live session: checks the newest readings in a separate process."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from functools import reduce

import numpy as np

from glissando.evaluation.plausibility.examine import examine
from glissando.evaluation.plausibility.finding import Finding
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings

_SPAN = 20.0  # s of the newest readings that are checked
_ENDED_MESSAGE = "The process that looks at the readings has ended: they are not judged any more."


class PlausibilityMonitor:
    """Repeated plausibility checks of a running session, with one finding per check.

    Args:
        robot: The robot of the readings.
        executor: Runs the checks; an executor with processes, so that the session is not delayed.
        every: Time between checks, s.
    """

    def __init__(self, robot: Robot, executor: Executor, *, every: float = 10.0) -> None:
        self._robot, self._executor, self._every = robot, executor, every
        self._reported: set[str] = set()
        self._streams: dict[str, list[Readings]] = {}
        self._due: float | None = None
        self._looking: Future[list[Finding]] | None = None

    def take(self, arrived: Sequence[Readings], now: float) -> list[Finding]:
        """Add readings, and return the new findings of the last check that has ended.

        Args:
            arrived: Readings since the last call.
            now: Time of the session, s.
        """
        if self._due == np.inf:  # the process has ended
            return []
        for r in filter(len, arrived):
            self._streams.setdefault(r.label, []).append(r)
        self._due = now + self._every if self._due is None else self._due
        try:
            if now >= self._due and self._looking is None:
                self._due = now + self._every
                self._looking = self._executor.submit(
                    examine, self._robot, self._newest(now), allow=tuple(self._reported)
                )
            return self._collect()
        except BrokenExecutor:
            self._due = np.inf
            self._streams.clear()
            return [Finding("guard", _ENDED_MESSAGE, False)]

    def last(self, now: float) -> list[Finding]:
        """Check the newest readings at the end of a session, in the calling process.

        Args:
            now: Time of the session, s.

        Returns:
            Findings of checks without an earlier finding.
        """
        return self._new(examine(self._robot, self._newest(now), allow=tuple(self._reported)))

    def _newest(self, now: float) -> list[Readings]:
        """The newest readings of each stream; older ones are discarded."""
        for name, parts in self._streams.items():
            whole = reduce(lambda one, other: one.joined(other), parts)
            self._streams[name] = [whole.select(whole.time > now - _SPAN)]
        return [parts[0] for parts in self._streams.values()]

    def _collect(self) -> list[Finding]:
        """New findings of the submitted check if it has ended."""
        if self._looking is None or not self._looking.done():
            return []
        looking, self._looking = self._looking, None
        return self._new(looking.result())

    def _new(self, findings: Sequence[Finding]) -> list[Finding]:
        """First finding of each check that has not been reported; marks them as reported."""
        new = {f.name: f for f in reversed(findings) if f.name not in self._reported}
        self._reported |= new.keys()
        return list(new.values())
