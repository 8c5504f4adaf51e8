"""What a study says: error and confidence against each axis, with 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from glissando.experiments.study.plan import Study
from glissando.experiments.trials import interval
from glissando.geometry.se3 import Array

_RESAMPLES = 2000


def summarise(study: Study, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Counts, and a list of points for each axis of two values or more, or for 'seeds' alone.

    A point is `value`, `cells`, `failed`, and RMSE (m, rad), NEES and coverage over the cells that
    have this value, whatever the others; each with the 95 % interval of drawing the cells again.
    Rows are those of the joined table.
    """
    failed = [row for row in rows if row["error"] is not None]
    axes = {name: values for name, values in study.axes.items() if len(values) > 1}
    points = {
        name: [_point(value, [r for r in rows if r[name] == value]) for value in values]
        for name, values in axes.items()
    }
    return {
        "name": study.name,
        "cells": len(rows),
        "failed": len(failed),
        "errors": _counted([row["error"] for row in failed]),
        "axes": points or {"seeds": [_point(f"{len(study.seeds)} seeds", rows)]},
    }


def _counted(sentences: Sequence[str]) -> dict[str, int]:
    return {sentence: sentences.count(sentence) for sentence in dict.fromkeys(sentences)}


def _point(value: Any, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    sound = [row for row in rows if row["error"] is None]
    out = {"value": value, "cells": len(rows), "failed": len(rows) - len(sound)}
    if not sound:
        return out
    rng = np.random.default_rng(0)
    again = rng.integers(len(sound), size=(_RESAMPLES, len(sound)))
    draw = np.vstack([np.arange(len(sound)), again])
    for name in ("position_rmse", "rotation_rmse"):
        out[name] = interval(np.sqrt(np.mean(_column(sound, name)[draw] ** 2, axis=1)))
    for name in ("nees_position", "coverage95_position", "converged"):
        out[name] = interval(np.mean(_column(sound, name)[draw], axis=1))
    return out


def _column(rows: Sequence[dict[str, Any]], name: str) -> Array:
    return np.array([row[name] for row in rows], dtype=float)


def print_summary(told: dict[str, Any], console: Console) -> None:
    """A table of the points of every axis, and each sentence of what failed with its number."""
    title = f"{escape(told['name'])}: {told['cells']:,} cells, {told['failed']:,} failed"
    look: dict[str, Any] = {"box": SIMPLE_HEAD, "pad_edge": False, "collapse_padding": True}
    table = Table(title=title, caption="in brackets 95 % intervals, cells drawn again", **look)
    for heading in ("axis", "value"):
        table.add_column(heading, no_wrap=True)
    for heading in ("cells", "failed", "RMSE (mm)", "RMSE (°)", "NEES", "in 95 % (%)"):
        table.add_column(heading, justify="right", no_wrap=True)
    for axis, points in told["axes"].items():
        for point in points:
            table.add_row(escape(axis), escape(_label(point["value"])), *_cells(point))
        table.add_section()
    console.print(table)
    for sentence, count in told["errors"].items():
        console.print(f"  {count} failed: {sentence}", markup=False)


def _cells(point: dict[str, Any]) -> list[str]:
    counts = [f"{point['cells']:,}", f"{point['failed']:,}"]
    if "position_rmse" not in point:
        return [*counts, *("–",) * 4]
    millimetres = _interval(point["position_rmse"], 1e3, 2)
    degrees = f"{np.degrees(point['rotation_rmse']['value']):.2f}"
    nees = f"{point['nees_position']['value']:.2f}"
    return [*counts, millimetres, degrees, nees, _interval(point["coverage95_position"], 1e2, 0)]


def _interval(found: dict[str, float], scale: float, digits: int) -> str:
    value, low, high = (f"{scale * found[k]:.{digits}f}" for k in ("value", "low", "high"))
    return f"{value} ({low}–{high})"


def _label(value: Any) -> str:
    return f"{value:g}" if isinstance(value, (int, float)) and value is not True else str(value)
