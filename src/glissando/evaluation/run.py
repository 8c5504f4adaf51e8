"""Estimation of a recording and comparison with its truth: the run, its JSON and its files."""

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

_PAUSE = 1.0  # s, longest usual pause between readings
_OBSERVED = 0.98  # posterior over prior std of a sensor parameter, below which it is observed


@dataclass(frozen=True)
class Run(ShortRepr):
    """An estimate of a recording: input streams, posterior, and errors against truth.

    Attributes:
        recording: The recording.
        robot: The robot of the estimate.
        window: First and last time of the estimate, s.
        readings: Streams that were used, inside the window.
        truth: Streams to compare with, corrected by the robot file's sensor parameters.
        dropped: Numbers of rows that were not used, by stream and reason.
        posterior: The estimate.
        errors: Errors against each truth stream.
        findings: Findings of the plausibility checks on readings and estimate.
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
        """Consistency of the errors against truth, then of the innovations of the readings."""
        parameters = self.robot.sensor_parameters
        return [*check(self.errors), *check_readings(self.posterior, self.readings, parameters)]

    def sensor_parameters(self) -> list[dict[str, Any]]:
        """Every estimated sensor parameter: value and std at mid recording, RMS over time.

        "observed" is whether readings reduce the standard deviation of any of its components.
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
        """Times, s, of the readings rejected as contradicting all others, by stream."""
        rows = self.posterior.solve.refused
        return {r.label: r.time[rows[r.label]].tolist() for r in self.readings if r.label in rows}

    def _log_evidence(self) -> float | None:
        """Log evidence (22); None if the prior alone does not determine all states."""
        try:
            return self.posterior.log_evidence
        except (np.linalg.LinAlgError, UnobservableError):
            return None

    def as_json(self) -> dict[str, Any]:
        """Settings and results of the run as a JSON object, in SI units and radians."""
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
    """The window to estimate: as given, else the recording's own, else the span of its sensors.

    Args:
        recording: The recording.
        window: First and last time, s, or None.

    Raises:
        RecordingError: The window is not finite, or empty.
    """
    sensors, _ = recording.choose(None, None)  # times with truth alone are not estimated
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
    """Part of a sentence on rows that were left out as repeats; empty if there are none."""
    counts = {name: s.rows.dropped.get("repeated", 0) for name, s in recording.streams.items()}
    listed = ", ".join(f"{n} rows of {name}" for name, n in counts.items() if n)
    return f" ({listed} repeat the one before; keep_repeats = true keeps them)" if listed else ""


def chosen_streams(
    recording: Recording,
    robot: Robot,
    window: tuple[float, float],
    use: Sequence[str] | None,
    truth: Sequence[str] | None,
) -> tuple[list[Readings], list[Readings], dict[str, dict[str, int]]]:
    """Choose the streams to use and the truth to compare with, inside a window.

    Args:
        recording: The recording.
        robot: The robot; its file states the noise of streams that state none, and the sensor
            parameters that correct truth.
        window: First and last time, s.
        use: Names of streams to use; by default all but truth.
        truth: Names of truth streams; by default those marked as truth in the recording.

    Returns:
        Readings to use, truth streams that are not empty, and the numbers of rows dropped by
        stream and reason.

    Raises:
        RecordingError: The recording has no such stream, or a named stream has no rows in the
            window.
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
    """Warn if the window begins or ends more than a usual pause before or after all readings."""
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
    """Warn that a truth stream has no reading inside the window."""
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
    """Raise RecordingError unless the named streams exist and have rows in a window.

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
        window: First and last time, s; by default that of the recording.
        use: Names of streams to use; by default all but truth.
        truth: Names of truth streams; by default those marked as truth in the recording.
        progress: Called after each iteration, as by `estimate`.
        allow: Names of plausibility checks to skip, in addition to the recording's own.
        start: An earlier estimate of the same robot as initial states; by default the rest state.
        max_iterations: Largest number of iterations; by default that of `SolverOptions`.

    Raises:
        RecordingError: The window is empty, a stream is unknown, or there are no readings.
        ImplausibleError: Readings contradict their declared units, frames or clocks, or the robot,
            or the estimate fails numerically.
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
    """Write report.json and posterior.nc into a folder, reproducibly to the byte.

    Args:
        run: The run.
        folder: Output folder; created if missing.
        **more: Further entries of the report, such as the command's options.

    Returns:
        Paths of both files.
    """
    report, saved = folder / "report.json", folder / "posterior.nc"
    results = run.as_json() | more
    del results["seconds"]  # the computing time differs from run to run
    write_report(report, results)
    save_posterior(run.posterior, saved)
    return [report, saved]
