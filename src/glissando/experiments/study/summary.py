"""Summary of a study: error and coverage over each axis, with 95 % intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from glissando.experiments.statistics import bootstrap, interval
from glissando.experiments.study.plan import Study
from glissando.geometry.se3 import Array

_MEANS = {"nees_position": None, "coverage95_position": 1.0, "converged": 1.0}
"""Metrics of which the mean is taken, with their upper limits."""


def summarise(study: Study, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summarise the rows of the joined table of a study.

    Returns:
        Numbers of cells and failures, counts of failures by message, and under `axes` a list of
        points for each axis of two values or more, or else for 'seeds' alone. A point pools all
        cells with its `value`: RMSE (m, rad), NEES and coverage, each with a 95 % interval by
        resampling of seeds, as all cells of a seed have the same robot, tracker and noise. One seed
        has no interval.
    """
    errors = Counter(row["error"] for row in rows if row["error"] is not None)
    points = {
        name: [_point(value, [r for r in rows if r[name] == value]) for value in values]
        for name, values in study.axes.items()
        if len(values) > 1
    }
    return {
        "name": study.name,
        "cells": len(rows),
        "failed": errors.total(),
        "errors": dict(errors),
        "axes": points or {"seeds": [_point(f"{len(study.seeds)} seeds", rows)]},
    }


def _point(value: Any, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    succeeded = [row for row in rows if row["error"] is None]
    out = {"value": value, "cells": len(rows), "failed": len(rows) - len(succeeded)}
    if succeeded:
        seeds, seed_index = np.unique([row["seed"] for row in succeeded], return_inverse=True)
        draws, cells = bootstrap(seeds.size, 2000), np.bincount(seed_index)

        def mean(values: Array) -> Array:
            sums = np.bincount(seed_index, values)
            return sums[draws].sum(axis=1) / cells[draws].sum(axis=1)

        for name in ("position_rmse", "rotation_rmse"):
            rms = np.sqrt(mean(np.square([row[name] for row in succeeded])))
            out[name] = interval(rms, seeds.size)
        for name, most in _MEANS.items():
            values = mean(np.array([float(row[name]) for row in succeeded]))
            out[name] = interval(values, seeds.size, most)
    return out


def print_summary(summary: dict[str, Any], console: Console) -> None:
    """Print a table of the points of every axis, and the count of each failure's message."""
    title = f"{escape(summary['name'])}: {summary['cells']:,} cells, {summary['failed']:,} failed"
    look: dict[str, Any] = {"box": SIMPLE_HEAD, "pad_edge": False, "collapse_padding": True}
    table = Table(title=title, caption="in brackets 95 % intervals, seeds drawn again", **look)
    for heading in ("axis", "value"):
        table.add_column(heading, no_wrap=True)
    for heading in ("cells", "failed", "RMSE (mm)", "RMSE (°)", "NEES", "in 95 % (%)"):
        table.add_column(heading, justify="right", no_wrap=True)
    for axis, points in summary["axes"].items():
        for point in points:
            value = point["value"]
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            label = f"{value:g}" if number else str(value)
            table.add_row(escape(axis), escape(label), *_cells(point))
        table.add_section()
    console.print(table)
    for sentence, count in summary["errors"].items():
        console.print(f"  {count} failed: {sentence}", markup=False)


def _cells(point: dict[str, Any]) -> list[str]:
    counts = [f"{point['cells']:,}", f"{point['failed']:,}"]
    if "position_rmse" not in point:
        return [*counts, *("–",) * 4]
    millimetres = _interval(point["position_rmse"], 1e3, 2)
    degrees = f"{np.degrees(point['rotation_rmse']['value']):.2f}"
    nees = f"{point['nees_position']['value']:.2f}"
    return [*counts, millimetres, degrees, nees, _interval(point["coverage95_position"], 1e2, 0)]


def _interval(entry: dict[str, Any], scale: float, digits: int) -> str:
    if entry["low"] is None:
        return f"{scale * entry['value']:.{digits}f}"
    value, low, high = (f"{scale * entry[k]:.{digits}f}" for k in ("value", "low", "high"))
    return f"{value} ({low}–{high})"
