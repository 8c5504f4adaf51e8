"""A recording run through the online estimator as if it were live, and judged as it goes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import RecordingError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.posterior import StateEstimate
from glissando.evaluation.metrics import Answers, Errors, errors_against, joined, pool
from glissando.evaluation.run import checked_window, site_summary
from glissando.geometry.se3 import Array
from glissando.io.csv_stream import Rows
from glissando.io.journal import Journal
from glissando.io.recording import Recording, load_recording
from glissando.io.robot_file import Robot
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.readings import Readings

_NODES = 4  # in the window, unless a lag is asked for
_MEMORY = 30.0  # s of a journal that are gone through again before going on

Watch = Callable[[int, int, FixedLagSmoother], None]
"""Called after each update with its number, how many there will be, and the smoother."""


@dataclass(frozen=True)
class Replay:
    """What came of it: an estimate and a latency (s) each update, and errors against truth.

    `newest` judges the interval before each update by all readings up to it, `lagged` the interval
    that is about to leave the window.
    """

    recording: Recording
    robot: Robot
    window: tuple[float, float]
    nodes: int
    smoother: FixedLagSmoother
    time: Array
    latency: Array
    states: list[StateEstimate]
    nis: Array
    newest: list[Errors]
    lagged: list[Errors]

    @property
    def real_time_factor(self) -> float:
        """Seconds of recording estimated in a second of work."""
        return float((self.time[-1] - self.time[0]) / max(self.latency.sum(), 1e-9))

    def as_json(self) -> dict[str, Any]:
        """Everything a program wants to know, SI units and radians."""
        median, p99 = np.percentile(self.latency, [50, 99]).tolist()
        return {
            "recording": self.recording.name,
            "robot": self.robot.name,
            "window": list(self.window),
            "nodes": self.nodes,
            "updates": len(self.latency),
            "latency": {"median": median, "p99": p99, "max": float(self.latency.max())},
            "real_time_factor": self.real_time_factor,
            "newest": _judged(self.newest),
            "lagged": _judged(self.lagged),
            "dropped": {name: dict(why) for name, why in self.smoother.dropped.items()},
            "restarts": self.smoother.restarts,
            "nis": float(np.nanmean(self.nis)) if np.any(np.isfinite(self.nis)) else None,
        }


def _judged(errors: list[Errors]) -> dict[str, Any] | None:
    if not errors:
        return None
    return {"overall": pool(errors).summary(), "sites": [site_summary(e) for e in errors]}


def replay(
    recording: Recording,
    robot: Robot,
    *,
    window: tuple[float, float] | None = None,
    lag: float | None = None,
    use: Sequence[str] | None = None,
    truth: Sequence[str] | None = None,
    real_time: bool = False,
    journal: Path | None = None,
    watch: Watch | None = None,
) -> Replay:
    """Run a window of a recording through `FixedLagSmoother` at the robot's rate of time nodes.

    The estimator's window spans `lag` seconds, four nodes unless given; `real_time` waits until
    each update is due. Readings go to a `journal` folder before they are used; if it
    holds some already, the run goes on where they end. Raises RecordingError for an empty window.
    """
    first, last = checked_window(recording, window)
    names, judges = recording.choose(use, truth)
    readings, _ = recording.readings(names, robot, (first, last))
    if not sum(map(len, readings)):
        raise RecordingError(f"{recording.name} holds no readings from {first:g} to {last:g} s.")
    true, _ = recording.readings(judges, robot, (first, last), as_truth=True)
    times = np.linspace(first, last, max(2, round((last - first) * robot.time_rate) + 1))
    nodes = _NODES if lag is None else max(1, round(lag * robot.time_rate) + 1)
    smoother = FixedLagSmoother(
        robot.prior, robot.arclength_nodes, window=nodes, sensor_parameters=robot.sensor_parameters
    )
    run = _Run(smoother, [corrected(t, robot.sensor_parameters) for t in true if len(t)], watch)
    if journal is None:
        run.through(readings, times, real_time=real_time)
    else:
        readings, times = _continued(smoother, journal, recording.name, readings, times)
        with Journal(journal, recording.name) as log:
            run.through(readings, times, real_time=real_time, log=log)
    return Replay(
        recording, robot, (first, last), nodes, smoother, times,
        np.array(run.latency), run.states, np.array(run.nis), *run.judged(),
    )  # fmt: skip


def _continued(
    smoother: FixedLagSmoother, journal: Path, name: str, readings: list[Readings], times: Array
) -> tuple[list[Readings], Array]:
    """Tell the smoother what a journal holds; the readings and times that are still to come."""
    if not (journal / "recording.toml").exists():
        return readings, times
    before = load_recording(journal)
    if before.name != name:
        raise RecordingError(f"{journal} is a log of {before.name}; give another folder.")
    logged = [
        _as_before(r, before.streams[r.name].rows) for r in readings if r.name in before.streams
    ]
    if not logged:
        return readings, times
    end = max(float(r.time[-1]) for r in logged)
    past, ahead = times[times <= end], times[times > end]
    if ahead.size == 0:
        raise RecordingError(f"{journal} holds all of it already; give another folder.")
    past = past[past >= end - _MEMORY]
    since = past[0] if past.size else -np.inf
    _Run(smoother, [], None).through([r.select(r.time >= since) for r in logged], past)
    since = past[-1] if past.size else -np.inf
    for r in logged:
        smoother.add(r.select(r.time > since))
    ends = {r.name: r.time[-1] for r in logged}
    return [r.select(r.time > ends.get(r.name, -np.inf)) for r in readings], ahead


def _as_before(readings: Readings, rows: Rows) -> Readings:
    """A stream's readings as a journal has them."""
    return replace(readings, time=rows.time, arclength=rows.arclength, values=rows.values)


@dataclass
class _Run:
    """A smoother on its way through readings, and what was seen of it."""

    smoother: FixedLagSmoother
    truth: list[Readings]
    watch: Watch | None
    latency: list[float] = field(default_factory=list)
    states: list[StateEstimate] = field(default_factory=list)
    nis: list[float] = field(default_factory=list)
    _newest: list[list[Errors]] = field(default_factory=list)
    _lagged: list[list[Errors]] = field(default_factory=list)

    def through(
        self,
        readings: list[Readings],
        times: Array,
        *,
        real_time: bool = False,
        log: Journal | None = None,
    ) -> None:
        """Update at every time with the readings since the one before."""
        began = time.monotonic() - (times[0] if times.size else 0.0)
        since = self.smoother.time or -np.inf
        for k, now in enumerate(times):
            came = [r.select((r.time > since) & (r.time <= now)) for r in readings]
            if real_time:  # as if each came when it was measured
                time.sleep(max(0.0, began + now - time.monotonic()))
            self._update([r for r in came if len(r)], float(now), log)
            self._judge(float(since), times, k)
            if self.watch is not None:
                self.watch(k + 1, len(times), self.smoother)
            since = now

    def _update(self, came: list[Readings], now: float, log: Journal | None) -> None:
        start = time.perf_counter()
        for readings in came:
            if log is not None:
                log.write(readings)
            self.smoother.add(readings)
        self.states.append(self.smoother.advance(now))
        self.latency.append(time.perf_counter() - start)
        self.nis.append(np.nan if self.smoother.nis is None else self.smoother.nis)

    def _judge(self, since: float, times: Array, k: int) -> None:
        """Judge the newest interval, and the one that leaves the window next."""
        lag, done = self.smoother.lag, k + 1 == len(times)
        if lag == 1:  # a filter knows its newest node alone: judge what it foretells
            if not done:
                self._newest.append(self._errors(self.smoother, times[k], times[k + 1]))
            return
        posterior = self.smoother.posterior()
        self._newest.append(self._errors(posterior, since, times[k]))
        oldest = max(0, k - lag + 1)
        if done or k >= lag - 1:
            until = times[k if done else oldest + 1]
            self._lagged.append(self._errors(posterior, times[oldest], until))

    def _errors(self, found: Answers, after: float, until: float) -> list[Errors]:
        """Errors in an interval, those of each truth stream."""
        chosen = [t.select((t.time > after) & (t.time <= until)) for t in self.truth]
        return [errors_against(found, t) for t in chosen]

    def judged(self) -> tuple[list[Errors], list[Errors]]:
        """Errors of the newest and of the lagged estimates, a site each that has any."""
        both = []
        for intervals in (self._newest, self._lagged):
            sites = [joined(parts) for parts in zip(*intervals, strict=True)]
            both.append([site for site in sites if site.arclength.size])
        return both[0], both[1]
