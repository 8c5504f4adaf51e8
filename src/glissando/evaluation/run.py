"""A recording estimated and compared with its truth: the run, its JSON and its files."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import (
    ImplausibleError,
    OtherTimesWarning,
    RecordingError,
    UnobservableError,
)
from glissando.estimation.batch import estimate
from glissando.estimation.channels import placed
from glissando.estimation.posterior import Posterior
from glissando.evaluation.consistency import Consistency, check, check_readings
from glissando.evaluation.metrics import Errors, errors_against, pool
from glissando.evaluation.plausibility.examine import (
    after_estimate,
    examine_recording,
    without_false_readings,
)
from glissando.evaluation.plausibility.finding import Finding, refuse
from glissando.io.csv_stream import Stream
from glissando.io.netcdf import save_posterior
from glissando.io.provenance import versions, write_report
from glissando.io.recording import Recording
from glissando.model.robot import Robot
from glissando.model.seconds import seconds
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.readings import Readings
from glissando.model.short_repr import ShortRepr
from glissando.solver.gauss_newton import Progress, SolverOptions

_PAUSE = 1.0  # s that readings pause
_OBSERVED = 0.98  # of what was stated of a sensor parameter: below it, readings determine it


@dataclass(frozen=True)
class Run(ShortRepr):
    """A recording estimated: what went in, the posterior, and its errors against truth.

    Attributes:
        recording: The recording.
        robot: The robot it was estimated as.
        window: First and last time that was estimated, s.
        readings: Streams that were used, inside the window.
        truth: Streams to compare with, put right by the robot file's sensor parameters.
        dropped: Rows that were not used, counted by stream and reason.
        posterior: The estimate.
        errors: Errors against each truth stream.
        findings: What is implausible about the readings or the estimate.
    """

    recording: Recording
    robot: Robot
    window: tuple[float, float]
    readings: list[Readings]
    truth: list[Readings]
    dropped: dict[str, dict[str, int]]
    posterior: Posterior
    errors: list[Errors]
    findings: list[Finding] = field(default_factory=list)

    def consistency(self) -> list[Consistency]:
        """Whether confidence is true: errors against truth, then innovations of the readings."""
        parameters = self.robot.sensor_parameters
        return [*check(self.errors), *check_readings(self.posterior, self.readings, parameters)]

    def sensor_parameters(self) -> list[dict[str, Any]]:
        """Every estimated sensor parameter: value and std at mid recording, RMS over time.

        Also whether readings determine any of it, or it is as uncertain as it was stated.
        """
        out = []
        for parameter, _ in self.posterior.sensor_parameters:
            values, cov = self.posterior.parameter(parameter.name)
            middle = len(values) // 2
            std = np.sqrt(np.diagonal(cov[middle]))
            out.append(
                {
                    "name": parameter.name,
                    "kind": parameter.kind,
                    "value": values[middle].tolist(),
                    "std": std.tolist(),
                    "observed": bool(np.any(std < _OBSERVED * np.maximum(parameter.std, 1e-12))),
                    "rms": np.sqrt(np.mean(values**2, axis=0)).tolist(),
                }
            )
        return out

    def refused(self) -> dict[str, list[float]]:
        """Times (s) of each stream's readings that all others refute, which were not used."""
        rows = self.posterior.solve.refused
        return {r.label: r.time[rows[r.label]].tolist() for r in self.readings if r.label in rows}

    def _log_evidence(self) -> float | None:
        """The log evidence (22), if the prior alone says enough of all states."""
        try:
            return self.posterior.log_evidence
        except (np.linalg.LinAlgError, UnobservableError):
            return None

    def as_json(self) -> dict[str, Any]:
        """The run's settings and results as JSON holds them, SI units and radians."""
        solve = self.posterior.solve
        return {
            "recording": self.recording.name,
            "robot": self.robot.name,
            "window": list(self.window),
            "prior": self.posterior.prior.kind,
            "nodes": list(self.posterior.grid.shape),
            "status": solve.status,
            "iterations": solve.iterations,
            "unknowns": solve.unknowns,
            "calibration": self.sensor_parameters(),
            "readings": {r.label: len(r) for r in self.readings},
            "log_evidence": self._log_evidence(),
            "suspects": solve.suspects,
            "doubt": solve.doubt,
            "refused": self.refused(),
            "seconds": solve.seconds,
            "dropped": self.dropped,
            "findings": [finding.as_json() for finding in self.findings],
            "overall": pool(self.errors).summary() if self.errors else None,
            "sites": [e.site_summary() for e in self.errors],
            "consistency": [c.as_json() for c in self.consistency()],
            "versions": versions(),
        }


def checked_window(recording: Recording, window: tuple[float, float] | None) -> tuple[float, float]:
    """The window to estimate: as given, else the recording's own, else that of its sensors.

    Args:
        recording: The recording.
        window: First and last time, s.

    Raises:
        RecordingError: Unless the window is finite and longer than nothing.
    """
    sensors, _ = recording.choose(None, None)  # where truth goes on alone nothing is estimated
    first, last = window or recording.window or recording.span(sensors)
    if not (np.isfinite(first) and np.isfinite(last)):
        raise RecordingError(f"The window {first:g} to {last:g} s is not finite; give seconds.")
    if not first < last:
        advice = "give T0 < T1"
        if not (window or recording.window):
            advice = f"the recording has no length{_repeats(recording)}, give --window T0 T1"
        raise RecordingError(f"The window {seconds(first, last, decimals=6)} s is empty; {advice}.")
    return first, last


def _repeats(recording: Recording) -> str:
    """What to say of rows that were left out as repeats."""
    counts = {name: s.rows.dropped.get("repeated", 0) for name, s in recording.streams.items()}
    said = ", ".join(f"{n} rows of {name}" for name, n in counts.items() if n)
    return f" ({said} repeat the one before; keep_repeats = true keeps them)" if said else ""


def chosen_streams(
    recording: Recording,
    robot: Robot,
    window: tuple[float, float],
    use: Sequence[str] | None,
    truth: Sequence[str] | None,
) -> tuple[list[Readings], list[Readings], dict[str, dict[str, int]]]:
    """The streams to use and the truth to compare with, inside a window.

    Args:
        recording: The recording.
        robot: Its noise stands in where a stream states none; its known sensor parameters put
            truth right.
        window: First and last time, s.
        use: Names of streams to use; all but truth unless given.
        truth: Names of truth streams; those that are marked so unless given.

    Returns:
        Readings to use, truth that is not empty, and the rows dropped by stream and reason.

    Raises:
        RecordingError: If the recording has no such stream.
    """
    require_rows(recording, [*(use or ()), *(truth or ())], window)
    use, truth = recording.choose(use, truth)
    readings, dropped = recording.readings(use, robot, window)
    _warn_of_prediction(readings, window)
    references, _ = recording.readings(truth, robot, window, as_truth=True)
    for name, reference in zip(truth, references, strict=True):
        if not len(reference):
            _warn_of_other_times(recording.stream(name), window)
    return readings, [corrected(t, robot.sensor_parameters) for t in references if len(t)], dropped


def _warn_of_prediction(readings: Sequence[Readings], window: tuple[float, float]) -> None:
    """Warn of a window whose beginning or end is farther from any reading than a pause would be."""
    times = [r.time for r in readings if len(r)]
    if not times:
        return
    first, last = min(t.min() for t in times), max(t.max() for t in times)
    if max(first - window[0], window[1] - last) > _PAUSE:
        warnings.warn(
            f"Readings are of {seconds(first, last)} s, the window of {seconds(*window)} s: what "
            f"lies beyond them is predicted.",
            OtherTimesWarning,
            stacklevel=3,
        )


def _warn_of_other_times(truth: Stream, window: tuple[float, float]) -> None:
    """Warn that a truth stream has no reading inside a window, and so judges nothing."""
    times = truth.rows.time
    if times.size:
        span = seconds(float(times.min()), float(times.max()))
        warnings.warn(
            f"{truth.name} judges nothing: its truth is of {span} s, none inside "
            f"{seconds(*window)} s. If clocks differ, bring all streams to one.",
            OtherTimesWarning,
            stacklevel=3,
        )


def require_rows(recording: Recording, names: Sequence[str], window: tuple[float, float]) -> None:
    """Raise RecordingError unless streams that were asked for are there and have rows in a window.

    Args:
        recording: The recording.
        names: Names of streams.
        window: First and last time, s.
    """
    for name in names:
        time = recording.stream(name).rows.time
        if np.any((time >= window[0]) & (time <= window[1])):
            continue
        span = f"they go from {seconds(time.min())} to {seconds(time.max())} s" if time.size else ""
        raise RecordingError(
            f"{recording.name}: stream {name!r} has no rows from {seconds(window[0])} to "
            f"{seconds(window[1])} s; {span or 'it is empty'}. Choose another window, or bring all "
            f"streams to one clock."
        )


def run_estimate(
    recording: Recording,
    robot: Robot,
    *,
    window: tuple[float, float] | None,
    use: Sequence[str] | None,
    truth: Sequence[str] | None,
    progress: Progress | None = None,
    allow: Sequence[str] = (),
    start: Posterior | None = None,
    max_iterations: int | None = None,
) -> Run:
    """Estimate a window of a recording and compare it with its truth streams.

    Args:
        recording: The recording.
        robot: The robot with its prior, grid and sensor parameters.
        window: First and last time, s; the recording's own unless given.
        use: Names of streams to use; all but truth unless given.
        truth: Names of truth streams; those that are marked so unless given.
        progress: Called after each iteration, as `estimate` does.
        allow: Checks of plausibility that are left out, besides the recording's own.
        start: An earlier estimate of the same robot to start from, instead of rest.
        max_iterations: Most iterations, unless the solver's own.

    Raises:
        RecordingError: For an empty window, an unknown stream, or nothing to use.
        ImplausibleError: Readings cannot be what they are said to be, or the estimate broke down.
    """
    window = checked_window(recording, window)
    readings, references, dropped = chosen_streams(recording, robot, window, use, truth)
    _require_readings(recording, readings, window)
    findings = examine_recording(recording, robot, readings, references, window, allow)
    refuse(findings)
    readings = without_false_readings(robot, readings, dropped, {*recording.allow, *allow})
    parameters, grid = robot.sensor_parameters, robot.grid(*window, readings)
    try:
        posterior = estimate(
            robot.prior,
            grid,
            readings,
            sensor_parameters=parameters,
            initial=None if start is None else start.states_on(grid),
            options=SolverOptions(max_iterations or SolverOptions.max_iterations),
            progress=progress,
        )
        readings, references = placed(readings, posterior), placed(references, posterior)
        after = after_estimate(posterior, readings, parameters)
        errors = [errors_against(posterior, t) for t in references]
    except np.linalg.LinAlgError:
        raise ImplausibleError(
            f"The estimate of {recording.name} broke down: readings and robot contradict each "
            f"other beyond what can be computed. Check units, frames and single false readings."
        ) from None
    findings += [f for f in after if f.name not in {*recording.allow, *allow}]
    return Run(recording, robot, window, readings, references, dropped, posterior, errors, findings)


def _require_readings(
    recording: Recording, readings: list[Readings], window: tuple[float, float]
) -> None:
    if not readings:
        raise RecordingError(f"{recording.name} has no stream to use; name some with --use.")
    if sum(map(len, readings)) == 0:
        first, last = recording.span()
        raise RecordingError(
            f"The window {seconds(*window)} s holds no readings; the "
            f"recording runs from {first:.3f} to {last:.3f} s. Choose a window inside it."
        )


def write_run(run: Run, folder: Path, **more: Any) -> list[Path]:
    """Write report.json and posterior.nc into a folder: the same bytes for the same run.

    Args:
        run: The run.
        folder: Where to write; made if it is missing.
        **more: Further entries of the report, such as what was asked for.

    Returns:
        Paths of both files.
    """
    report, saved = folder / "report.json", folder / "posterior.nc"
    results = run.as_json() | more
    del results["seconds"]  # which differ from run to run
    write_report(report, results)
    save_posterior(run.posterior, saved)
    return [report, saved]
