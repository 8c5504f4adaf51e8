"""Whether a result computed again is the same, and what differs."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glissando.estimation.posterior import Posterior

SAME = 1e-8
"""Largest relative difference of numbers that count as the same: rounding of another BLAS, by which
the standard deviations of constants differ most, as what ties their nodes is large."""


@dataclass(frozen=True)
class Difference:
    """An entry of a report that is not the same.

    Attributes:
        key: Where it is, keys and indices joined by dots.
        before: The value then; None if there was none.
        now: The value now; None if there is none.
        std: The standard deviation that the report states for it, 0 if it states none.
    """

    key: str
    before: Any
    now: Any
    std: float = 0.0

    @property
    def size(self) -> float:
        """The difference of numbers by the largest of them and of their standard deviation.

        Infinite for anything else.
        """
        if not (_is_number(self.before) and _is_number(self.now)):
            return np.inf
        largest = max(abs(self.before), abs(self.now), self.std)
        return abs(self.before - self.now) / largest if np.isfinite(largest) else np.inf


def differences(before: Any, now: Any, key: str = "", std: Any = 0.0) -> Iterator[Difference]:
    """The entries of two documents of JSON that are not equal.

    Lists beside one named "std" of the same length have its entries as their standard deviations.

    >>> [d.key for d in differences({"a": [1, 2], "b": 3}, {"a": [1, 4], "b": 3})]
    ['a.1']
    """
    if isinstance(before, dict) and isinstance(now, dict):
        for name in dict.fromkeys((*before, *now)):
            beside = now.get("std") if name != "std" else None
            yield from differences(before.get(name), now.get(name), _within(key, name), beside)
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        each = std if isinstance(std, list) and len(std) == len(now) else [0.0] * len(now)
        for i, (then, here) in enumerate(zip(before, now, strict=True)):
            yield from differences(then, here, _within(key, i), each[i])
    elif before != now and not (before != before and now != now):  # both may be no number
        yield Difference(key, before, now, std if _is_number(std) else 0.0)


def _within(key: str, name: object) -> str:
    """The key of an entry of what a key names."""
    return f"{key}.{name}".lstrip(".")


def table_difference(before: Path, now: Path) -> float:
    """The largest difference of numbers of two CSV files, relative to the largest of their column.

    Args:
        before: The file then.
        now: The file now.

    Returns:
        The difference, infinite if other cells than numbers differ, or the size of the tables.
    """
    tables = []
    for path in (before, now):
        with path.open(encoding="utf-8", newline="") as file:
            tables.append(list(csv.reader(file)))
    if len({tuple(map(len, table)) for table in tables}) > 1:
        return np.inf
    difference = 0.0
    for then, here in zip(*(zip(*table, strict=True) for table in tables), strict=True):
        pairs = [pair for pair in zip(then, here, strict=True) if pair[0] != pair[1]]
        if pairs:
            try:
                column = np.array([_number(cell) for cell in here])
                apart = [abs(float(a) - float(b)) for a, b in pairs]
            except ValueError:
                return np.inf
            size = float(np.nanmax(np.abs(column), initial=0.0))
            largest = max(apart) / size if size > 0.0 else np.inf
            difference = max(difference, largest if np.isfinite(largest) else np.inf)
    return difference


def _number(cell: str) -> float:
    """A cell's number, or nan for a heading."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def posterior_difference(before: Posterior, now: Posterior) -> tuple[float, float] | None:
    """How far two posteriors of one grid are apart; None if their grids are not the same.

    Args:
        before: The posterior then.
        now: The posterior now.

    Returns:
        The largest distance of means in standard deviations, and the largest relative difference
        of standard deviations, at the nodes.
    """
    grids = before.grid, now.grid
    if before.state.dof != now.state.dof or any(
        not np.array_equal(*(getattr(grid, axis) for grid in grids))
        for axis in ("arclength", "time")
    ):
        return None
    size = now.state.pose.shape[1] * now.state.dof
    std, former = (
        np.sqrt(np.einsum("kii->ki", p.marginals.cov[:, :size, :size])) for p in (now, before)
    )
    fields = zip(before.state.fields(), now.state.fields(), strict=True)
    equal = all(np.array_equal(then, here) for then, here in fields)
    step = 0.0 * std if equal else before.state.difference(now.state).reshape(std.shape)
    return float(np.max(np.abs(step) / std)), float(np.max(np.abs(former / std - 1.0)))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
