"""CSV files of query points and of the estimates at them."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.posterior import Posterior
from glissando.estimation.state_estimate import StateEstimate
from glissando.geometry.se3 import Array
from glissando.io.atomic import write_table

QUERY_COLUMNS = [
    *("time", "arclength", "x", "y", "z", "qw", "qx", "qy", "qz"),
    *("nu_x", "nu_y", "nu_z", "u_x", "u_y", "u_z"),
    *("v_x", "v_y", "v_z", "w_x", "w_y", "w_z"),
    *(f"c_{i}_{j}" for i in range(6) for j in range(6)),
]
"""Columns of an estimate: point, pose, strain, velocity, covariance of the pose (body frame)."""


LOAD_COLUMNS = [f"{what}_{axis}" for what in ("n", "m", "std_n", "std_m") for axis in "xyz"]
"""Columns of an internal wrench: force and moment in the body frame, N and N m, and their std."""


def read_query(path: Path) -> tuple[Array, Array, list[int]]:
    """Read the points of a CSV file with the columns time and arclength.

    Args:
        path: The CSV file; other columns are ignored.

    Returns:
        Times (M,) in seconds, arclengths (M,) in metres, and the line number of each point.

    Raises:
        GlissandoError: The file cannot be read, or a time or an arclength is not a finite number.
    """
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
    return points[:, 0], points[:, 1], [number for number, _ in lines[1:]]


def write_query(
    posterior: Posterior, query: tuple[Array, Array], path: Path, *, loads: bool = False
) -> None:
    """Write the estimate at query points as CSV.

    Args:
        posterior: Posterior to evaluate.
        query: Times (M,) in seconds and arclengths (M,) in metres.
        path: File to write; its folder is created if it is missing.
        loads: Whether to add the internal wrench, in the columns LOAD_COLUMNS.

    Raises:
        GlissandoError: `loads` is true and the robot's prior has no mechanics.
    """
    time, arclength = query
    wrench = posterior.wrench(arclength, time) if loads else None
    more = None if wrench is None else np.hstack([wrench.wrench, wrench.std])
    write_states([(time, arclength, posterior.at(arclength, time))], path, more)


def write_states(
    states: Iterable[tuple[Array, Array, StateEstimate]], path: Path, loads: Array | None = None
) -> None:
    """Write estimates one after another as CSV with the columns QUERY_COLUMNS.

    Args:
        states: Batches of times (M,), s, arclengths (M,), m, and the estimates there.
        path: File to write.
        loads: Values (rows, 12) of the columns LOAD_COLUMNS; None to leave these out.
    """
    rows = [state_rows(*each) for each in states]
    table, names = np.concatenate(rows), QUERY_COLUMNS
    if loads is not None:
        table, names = np.hstack([table, loads]), [*names, *LOAD_COLUMNS]
    write_table(path, names, table)


def state_rows(time: Array, arclength: Array, at: StateEstimate) -> Array:
    """Estimates as numbers (M, C) in the order of QUERY_COLUMNS.

    Args:
        time: Times (M,), s.
        arclength: Arclengths (M,), m.
        at: Estimates at these M points.
    """
    columns = [time[:, None], arclength[:, None], at.position, at.quaternion, at.strain]
    return np.hstack([*columns, at.velocity, at.cov[:, :6, :6].reshape(len(time), 36)])
