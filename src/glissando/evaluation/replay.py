"""Replay of a recording through the fixed-lag smoother as if it were live, with its errors."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import GlissandoError, ImplausibleError, RecordingError
from glissando.estimation.channels import placed
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.posterior import Posterior
from glissando.estimation.reading_noise import StateSource
from glissando.estimation.state_estimate import StateEstimate
from glissando.evaluation.conformal import AdaptiveSet
from glissando.evaluation.metrics import (
    Errors,
    errors_against,
    joined,
    pool,
    prediction_scores,
)
from glissando.evaluation.plausibility.examine import (
    examine_recording,
    without_false_readings,
)
from glissando.evaluation.plausibility.finding import refuse
from glissando.evaluation.replay_request import (
    request_of,
    require_same_request,
    store_request,
)
from glissando.evaluation.run import checked_window, chosen_streams
from glissando.geometry.se3 import Array
from glissando.io.csv_stream import Rows
from glissando.io.journal import Journal
from glissando.io.recording import Recording
from glissando.io.recording_folder import load_recording
from glissando.model.robot import Robot
from glissando.model.seconds import seconds
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.short_repr import ShortRepr
from glissando.model.slide_track import slide_motion

_NODES = 4  # time nodes in the smoother's window by default
_MEMORY = 30.0  # s at the end of a journal that are estimated again before a run continues

Watch = Callable[[int, int, FixedLagSmoother], None]
"""Called after each update with its number from 1, the number of updates, and the smoother."""


@dataclass(frozen=True)
class Replay(ShortRepr):
    """Results of a replay: an estimate and a latency for each update, and errors against truth.

    Attributes:
        recording: The recording.
        robot: The robot of the estimate.
        window: First and last time that was replayed, s.
        nodes: Number of time nodes in the smoother's window.
        smoother: The smoother after the last update.
        time: Times (K,) of the updates, s.
        latency: Computing time (K,) of each update, s.
        states: Estimate of the newest node after each update.
        nis: Mean normalised innovation squared (K,) of each update; NaN if unknown.
        newest: Errors at each site in the interval before each update, given all readings up to it.
        lagged: Errors at each site in the oldest interval of the window after each update.
        adaptive: Adaptive prediction sets for the next reading of each stream, by its name.
        rows_dropped: Numbers of rows of the recording that were dropped, by stream and reason.
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
    adaptive: dict[str, AdaptiveSet] = field(default_factory=dict)
    rows_dropped: dict[str, dict[str, int]] = field(default_factory=dict)

    @property
    def real_time_factor(self) -> float:
        """Seconds of recording estimated per second of computing time."""
        return float((self.time[-1] - self.time[0]) / max(self.latency.sum(), 1e-9))

    def as_json(self) -> dict[str, Any]:
        """Settings and results of the replay as a JSON object, in SI units and radians."""
        median, p99 = np.percentile(self.latency, [50, 99]).tolist()
        return {
            "recording": self.recording.name,
            "robot": self.robot.name,
            "window": list(self.window),
            "judged_from": float(self.time[0]),
            "nodes": self.nodes,
            "updates": len(self.latency),
            "latency": {"median": median, "p99": p99, "max": float(self.latency.max())},
            "real_time_factor": self.real_time_factor,
            "newest": _summary(self.newest),
            "lagged": _summary(self.lagged),
            "rows_dropped": self.rows_dropped,
            "dropped": {name: dict(why) for name, why in self.smoother.dropped.items()},
            "restarts": self.smoother.restarts,
            "nis": float(np.nanmean(self.nis)) if np.any(np.isfinite(self.nis)) else None,
            "next_reading": {
                name: {
                    "count": s.count,
                    "miss_rate": s.miss_rate,
                    "bound": s.bound,
                    "level": s.level,
                }
                for name, s in self.adaptive.items()
                if s.count
            },
        }


def _summary(errors: list[Errors]) -> dict[str, Any] | None:
    if not errors:
        return None
    return {"overall": pool(errors).summary(), "sites": [e.site_summary() for e in errors]}


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
    allow: Sequence[str] = (),
) -> Replay:
    """Run a window of a recording through `FixedLagSmoother` at the robot's rate of time nodes.

    Args:
        recording: The recording.
        robot: The robot with its prior, grid and sensor parameters.
        window: First and last time, s; by default that of the recording.
        lag: Length of the smoother's window, s; by default four time nodes, 0 for a filter.
        use: Names of streams to use; by default all but truth.
        truth: Names of truth streams; by default those marked as truth in the recording.
        real_time: Whether to wait until each update is due.
        journal: Folder to which readings are written before they are used. If it contains readings
            of a run with the same settings, that run is continued.
        watch: Called after each update.
        allow: Names of plausibility checks to skip, in addition to the recording's own.

    Raises:
        RecordingError: The window is empty, a stream is unknown, or the journal is of another run.
        ImplausibleError: Readings contradict their declared units, frames or clocks, or the robot.
    """
    first, last = checked_window(recording, window)
    readings, references, dropped = chosen_streams(recording, robot, (first, last), use, truth)
    if not sum(map(len, readings)):
        raise RecordingError(f"{recording.name} holds no readings from {seconds(first, last)} s.")
    refuse(examine_recording(recording, robot, readings, references, (first, last), allow))
    readings = without_false_readings(robot, readings, dropped, {*recording.allow, *allow})
    times = np.linspace(first, last, max(2, round((last - first) * robot.time_rate) + 1))
    nodes = _NODES if lag is None else max(1, round(lag * robot.time_rate) + 1)
    smoother = FixedLagSmoother(
        robot.prior, robot.arclength_nodes, window=nodes, sensor_parameters=robot.sensor_parameters
    )
    known = [p for p in robot.sensor_parameters if p.known]
    run = _Run(smoother, references, watch, known)
    rest = readings, times
    if journal is not None:
        request = request_of(recording.name, robot, readings, times, nodes)
        rest = _continued(smoother, journal, request, readings, times)
    if journal is None or not rest[1].size:  # nothing is to be logged
        run.through(readings, times, wait=real_time)
    else:
        times = rest[1]
        with Journal(journal, recording.name, robot) as log:
            store_request(journal, request)
            run.through(*rest, log, wait=real_time)
    return Replay(
        recording, robot, (first, last), nodes, smoother, times, np.array(run.latency), run.states,
        np.array(run.nis), _by_site(run.newest), _by_site(run.lagged), run.adaptive, dropped,
    )  # fmt: skip


def _when_and_where(rows: Rows) -> dict[str, Any]:
    """Fields of readings for the time and place of rows."""
    slide = slide_motion(rows.time, rows.arclength)
    return {"time": rows.time, "arclength": rows.arclength, **slide}


def _continued(
    smoother: FixedLagSmoother,
    journal: Path,
    request: dict[str, object],
    readings: list[Readings],
    times: Array,
) -> tuple[list[Readings], Array]:
    """Pass a journal's readings to the smoother; returns remaining readings and update times.

    If the journal is complete, the smoother gets no readings and no update time remains.
    """
    if not (journal / "recording.toml").exists():
        return readings, times
    before = load_recording(journal)
    if before.streams:
        require_same_request(journal, request)
    rows = {name: stream.rows for name, stream in before.streams.items()}
    logged = [
        replace(r, values=o.values, **_when_and_where(o))
        for r in readings
        if (o := rows.get(r.name)) is not None
    ]
    if not logged:
        return readings, times
    end = max(float(r.time[-1]) for r in logged)
    past, future = times[times <= end], times[times > end]
    if future.size == 0:
        return [], future
    past = past[past >= end - _MEMORY]
    since = past[0] if past.size else -np.inf
    _Run(smoother, [], None).through([r.select(r.time >= since) for r in logged], past)
    since = past[-1] if past.size else -np.inf
    for r in logged:
        smoother.add(r.select(r.time > since))
    ends = {r.name: r.time[-1] for r in logged}
    return [r.select(r.time > ends.get(r.name, -np.inf)) for r in readings], future


def _by_site(intervals: list[list[Errors]]) -> list[Errors]:
    """Errors of each site over all intervals; sites without samples are left out."""
    sites = [joined(parts) for parts in zip(*intervals, strict=True)]
    return [site for site in sites if site.arclength.size]


@dataclass
class _Run:
    """Updates a smoother with readings, and stores the results of each update."""

    smoother: FixedLagSmoother
    truth: list[Readings]
    watch: Watch | None
    known: Sequence[SensorParameter] = ()
    latency: list[float] = field(default_factory=list)
    states: list[StateEstimate] = field(default_factory=list)
    nis: list[float] = field(default_factory=list)
    newest: list[list[Errors]] = field(default_factory=list)
    lagged: list[list[Errors]] = field(default_factory=list)
    adaptive: dict[str, AdaptiveSet] = field(default_factory=dict)

    def through(
        self, readings: list[Readings], times: Array, log: Journal | None = None, wait: bool = False
    ) -> None:
        """Update at every time with the readings since the last; `wait` until each is due."""
        began = time.monotonic() - (times[0] if times.size else 0.0)
        since = self.smoother.time or -np.inf
        for k, now in enumerate(times):
            arrived = [r.select((r.time > since) & (r.time <= now)) for r in readings]
            if wait:
                time.sleep(max(0.0, began + now - time.monotonic()))
            self._predict([r for r in arrived if len(r)])
            self._update([r for r in arrived if len(r)], float(now), log)
            self._compare(float(since), times, k)
            if self.watch is not None:
                self.watch(k + 1, len(times), self.smoother)
            since = now

    def _predict(self, arrived: list[Readings]) -> None:
        """Update the adaptive sets with the prediction scores of readings before their use."""
        since = self.smoother.time
        if since is None:
            return
        for readings in (r for r in arrived if r.reads_one_state):
            ahead = corrected(readings.select(readings.time > since), self.known)
            adaptive = self.adaptive.setdefault(readings.label, AdaptiveSet())
            try:
                ahead = self.smoother.placed(ahead)
                scores = prediction_scores(self.smoother, ahead) if len(ahead) else np.zeros(0)
            except (np.linalg.LinAlgError, GlissandoError):
                scores = np.full(len(ahead), np.nan)
            for score in scores:
                adaptive.update(float(score))

    def _update(self, arrived: list[Readings], now: float, log: Journal | None) -> None:
        start = time.perf_counter()
        for readings in arrived:
            if log is not None:
                log.write(readings)
            self.smoother.add(readings)
        try:
            self.states.append(self.smoother.advance(now))
        except np.linalg.LinAlgError:
            raise ImplausibleError(
                f"The update at {seconds(now)} s broke down: readings and robot contradict each "
                f"other beyond what can be computed. Check units, frames and single false readings."
            ) from None
        self.latency.append(time.perf_counter() - start)
        self.nis.append(np.nan if self.smoother.nis is None else self.smoother.nis)

    def _compare(self, since: float, times: Array, k: int) -> None:
        """Compare the newest and the oldest interval of the window with truth."""
        lag, done = self.smoother.lag, k + 1 == len(times)
        if lag == 1:  # a filter has its newest node alone: compare its prediction
            if not done:
                self.newest.append(self._errors(self.smoother, times[k], times[k + 1]))
            return
        posterior = self.smoother.posterior()
        self.newest.append(self._errors(posterior, since, times[k]))
        oldest = max(0, k - lag + 1)
        if done or k >= lag - 1:
            until = times[k if done else oldest + 1]
            self.lagged.append(self._errors(posterior, times[oldest], until))

    def _errors(self, estimate: StateSource, after: float, until: float) -> list[Errors]:
        """Errors of each truth stream in the interval from `after` to `until`, s."""
        if isinstance(estimate, Posterior) and (begins := float(estimate.grid.time[0])) > after:
            if np.isfinite(after):  # the window was restarted after a gap in the readings
                estimate = _HeldBefore(self.smoother, begins)
            else:
                after = np.nextafter(begins, -np.inf)
        inside = [t.select((t.time > after) & (t.time <= until)) for t in self.truth]
        if isinstance(estimate, Posterior):
            inside = placed(inside, estimate)
        else:
            inside = [self.smoother.placed(t) for t in inside]
        return [errors_against(estimate, t) for t in inside]


@dataclass(frozen=True)
class _HeldBefore:
    """A smoother restarted at rest, whose first state also stands for earlier times."""

    smoother: FixedLagSmoother
    begins: float

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """State and covariance at arclengths, m, and times, s, but not before `begins`."""
        return self.smoother.at(arclength, np.maximum(time, self.begins))
