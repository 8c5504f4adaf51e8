"""One run of `estimate` on a recording, and its results as JSON, as a table, and as files."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from glissando.errors import GlissandoError, RecordingError
from glissando.estimation.batch import Progress, estimate
from glissando.estimation.posterior import Posterior, StateEstimate
from glissando.evaluation.consistency import Consistency, check, check_readings
from glissando.evaluation.environment import versions
from glissando.evaluation.metrics import Errors, errors_against, pool
from glissando.geometry.se3 import Array
from glissando.io.recording import Recording
from glissando.io.robot_file import Robot
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings

QUERY_COLUMNS = [
    *("time", "arclength", "x", "y", "z", "qw", "qx", "qy", "qz"),
    *("nu_x", "nu_y", "nu_z", "u_x", "u_y", "u_z"),
    *("v_x", "v_y", "v_z", "w_x", "w_y", "w_z"),
    *(f"c_{i}_{j}" for i in range(6) for j in range(6)),
]


@dataclass(frozen=True)
class Run:
    """A recording estimated: what went in, the posterior, and its errors against truth."""

    recording: Recording
    robot: Robot
    window: tuple[float, float]
    readings: list[Readings]
    truth: list[Readings]
    dropped: dict[str, dict[str, int]]
    posterior: Posterior
    errors: list[Errors]

    def consistency(self) -> list[Consistency]:
        """Whether confidence is true: errors against truth, then innovations of the readings."""
        return [*check(self.errors), *check_readings(self.posterior, self.readings)]

    def as_json(self) -> dict[str, Any]:
        """Everything a program wants to know, SI units and radians."""
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
            "calibration": [
                _unknown(self.posterior, u) for u, _ in self.posterior.sensor_parameters
            ],
            "readings": {r.label: len(r) for r in self.readings},
            "log_evidence": solve.log_evidence,
            "suspects": solve.suspects,
            "seconds": solve.seconds,
            "dropped": self.dropped,
            "overall": pool(self.errors).summary() if self.errors else None,
            "sites": [site_summary(e) for e in self.errors],
            "consistency": [c.as_json() for c in self.consistency()],
            "versions": versions(),
        }


def _unknown(posterior: Posterior, unknown: SensorParameter) -> dict[str, Any]:
    """Value and standard deviation of an unknown at mid recording."""
    values, cov = posterior.unknown(unknown.name)
    middle = len(values) // 2
    return {
        "name": unknown.name,
        "kind": unknown.kind,
        "value": values[middle].tolist(),
        "std": np.sqrt(np.diagonal(cov[middle])).tolist(),
        "rms": np.sqrt(np.mean(values**2, axis=0)).tolist(),
    }


def site_summary(errors: Errors) -> dict[str, Any]:
    """Errors at a site as a report tells them, SI units and radians."""
    return {
        "name": errors.name,
        "arclength": float(np.mean(errors.arclength)),
        "samples": int(errors.arclength.size),
        **errors.summary(),
    }


def checked_window(recording: Recording, window: tuple[float, float] | None) -> tuple[float, float]:
    """The window to estimate: as given, else the recording's own, else all of it.

    Raises RecordingError unless it is finite and longer than nothing.
    """
    first, last = window or recording.window or recording.span()
    if not (np.isfinite(first) and np.isfinite(last)):
        raise RecordingError(f"The window {first:g} to {last:g} s is not finite; give seconds.")
    if not first < last:
        given = window or recording.window
        advice = "give T0 < T1" if given else "the recording has no length, give --window T0 T1"
        raise RecordingError(f"The window {first:g} to {last:g} s is empty; {advice}.")
    return first, last


def run_estimate(
    recording: Recording,
    robot: Robot,
    *,
    window: tuple[float, float] | None,
    use: Sequence[str] | None,
    truth: Sequence[str] | None,
    progress: Progress | None = None,
) -> Run:
    """Estimate a window of a recording and judge it against its truth streams.

    Raises RecordingError for an empty window or an unknown stream.
    """
    window, span = checked_window(recording, window), recording.span()
    names, truth_names = recording.choose(use, truth)
    if not names:
        raise RecordingError(f"{recording.name} has no stream to use; name some with --use.")
    readings, dropped = recording.readings(names, robot, window)
    if sum(len(r) for r in readings) == 0:
        raise RecordingError(
            f"The window {window[0]:g} to {window[1]:g} s holds no readings; the recording runs "
            f"from {span[0]:.3f} to {span[1]:.3f} s. Choose a window inside it."
        )
    true, _ = recording.readings(truth_names, robot, window, as_truth=True)
    true = [corrected(t, robot.sensor_parameters) for t in true if len(t)]
    grid = robot.grid(*window)
    posterior = estimate(
        robot.prior, grid, readings, sensor_parameters=robot.sensor_parameters, progress=progress
    )
    errors = [errors_against(posterior, t) for t in true]
    return Run(recording, robot, window, readings, true, dropped, posterior, errors)


def print_table(run: Run, console: Console) -> None:
    """A readable table of the run: one row a truth site, then all of them together."""
    solve = run.posterior.solve
    console.print(
        f"[bold]{escape(run.recording.name)}[/bold] on {escape(run.robot.name)}, "
        f"{run.window[0]:g} to {run.window[1]:g} s: {solve.status}, "
        f"{solve.iterations} iterations, {solve.unknowns:,} unknowns, "
        f"{sum(len(r) for r in run.readings):,} readings, {solve.seconds['total']:.2f} s of CPU"
    )
    for name, reasons in run.dropped.items():
        counted = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
        console.print(f"  {escape(name)}: {counted} rows dropped in the whole recording")
    for found in (_unknown(run.posterior, u) for u, _ in run.posterior.sensor_parameters):
        pairs = zip(found["value"], found["std"], strict=True)
        told = ", ".join(f"{value:.3g} ± {std:.2g}" for value, std in pairs)
        console.print(f"  {escape(found['name'])} ({found['kind']}): {told}")
    if not run.errors:
        console.print("No truth streams: nothing to compare with. Name some with --truth.")
        return
    table = Table("site", title="Error against truth, and whether its confidence is true")
    for heading in (
        "arclength (m)",
        "samples",
        "position RMSE (mm)",
        "rotation RMSE (deg)",
        "NEES / dof",
        "inside 95 %",
    ):
        table.add_column(heading, justify="right")
    for errors in run.errors:
        _add_row(table, errors, f"{np.mean(errors.arclength):.4f}")
    table.add_section()
    _add_row(table, pool(run.errors), "all")
    console.print(table)


def _add_row(table: Table, errors: Errors, place: str) -> None:
    found = errors.summary()

    def shown(key: str, scale: float, pattern: str) -> str:
        value = found[key]
        return "–" if value is None else pattern.format(scale * value)

    table.add_row(
        escape(errors.name),
        place,
        str(errors.arclength.size),
        shown("position_rmse", 1e3, "{:.2f}"),
        shown("rotation_rmse", 180.0 / np.pi, "{:.2f}"),
        shown("nees_position", 1.0, "{:.2f}"),
        shown("coverage95_position", 100.0, "{:.1f} %"),
    )


def write_run(run: Run, folder: Path) -> list[Path]:
    """Write posterior.nc, report.json and the figures into a folder; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    report = folder / "report.json"
    report.write_text(json.dumps(run.as_json(), indent=2) + "\n", encoding="utf-8")
    saved = folder / "posterior.nc"
    run.posterior.save(saved)
    from glissando.visualization.figures import save_figures

    return [report, saved, *save_figures(run.posterior, run.readings, run.truth, folder)]


def read_query(path: Path) -> tuple[Array, Array]:
    """Times and arclengths (M,) of a CSV file with the columns time and arclength."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, row) for row in reader if row]
    except OSError as problem:
        raise GlissandoError(f"Query {path} cannot be read ({problem.strerror}).") from None
    except (UnicodeDecodeError, csv.Error):
        raise GlissandoError(f"Query {path} is not a CSV text in UTF-8.") from None
    head = [name.strip() for name in lines[0][1]] if lines else []
    if "time" not in head or "arclength" not in head or len(lines) < 2:
        raise GlissandoError(
            f"Query {path.name} must have the columns time,arclength and a row for each point."
        )
    points = np.empty((len(lines) - 1, 2))
    for point, (number, row) in zip(points, lines[1:], strict=True):
        try:
            point[:] = [float(row[head.index(name)]) for name in ("time", "arclength")]
        except (IndexError, ValueError):
            point[:] = np.nan
        if not np.all(np.isfinite(point)):
            raise GlissandoError(
                f"{path.name} line {number}: give a number for time and one for arclength."
            )
    return points[:, 0], points[:, 1]


def write_query(posterior: Posterior, query: tuple[Array, Array], path: Path) -> None:
    """Write the estimate at query points as CSV; covariance in the body frame."""
    time, arclength = query
    path.parent.mkdir(parents=True, exist_ok=True)
    write_states([(time, arclength, posterior.at(arclength, time))], path)


def write_states(states: Iterable[tuple[Array, Array, StateEstimate]], path: Path) -> None:
    """Write estimates at times and arclengths (M,) each, one after another, as CSV."""
    rows = []
    for time, arclength, at in states:
        columns = [time[:, None], arclength[:, None], at.position, at.quaternion, at.strain]
        columns += [at.velocity, at.cov[:, :6, :6].reshape(len(time), 36)]
        rows.append(np.hstack(columns))
    header = ",".join(QUERY_COLUMNS)
    np.savetxt(path, np.concatenate(rows), "%.12g", ",", header=header, comments="")
