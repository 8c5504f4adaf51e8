"""Comparison of a recomputed result with a stored one."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glissando.estimation.posterior import Posterior

SAME = 1e-8
"""Largest relative difference of numbers that count as equal. It allows for the rounding of another
BLAS, which is largest in the standard deviations of constants, whose nodes are tied by large
weights."""


@dataclass(frozen=True)
class Difference:
    """An entry of a report that has changed.

    Attributes:
        key: Keys and indices of the entry, joined by dots.
        before: Stored value; None if there is none.
        now: New value; None if there is none.
        std: Standard deviation of the entry in the report; 0 if none is stated.
    """

    key: str
    before: Any
    now: Any
    std: float = 0.0

    @property
    def size(self) -> float:
        """Difference of two numbers over the largest of both and their standard deviation.

        Infinite for other values.
        """
        if not (_is_number(self.before) and _is_number(self.now)):
            return np.inf
        largest = max(abs(self.before), abs(self.now), self.std)
        return abs(self.before - self.now) / largest if np.isfinite(largest) else np.inf


def differences(before: Any, now: Any, key: str = "", std: Any = 0.0) -> Iterator[Difference]:
    """Yield the entries in which two JSON documents differ.

    A list "std" in the same object holds the standard deviations of all lists of its length there.

    >>> [d.key for d in differences({"a": [1, 2], "b": 3}, {"a": [1, 4], "b": 3})]
    ['a.1']
    """
    if isinstance(before, dict) and isinstance(now, dict):
        for name in dict.fromkeys((*before, *now)):
            stds = now.get("std") if name != "std" else None
            yield from differences(before.get(name), now.get(name), _within(key, name), stds)
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        each = std if isinstance(std, list) and len(std) == len(now) else [0.0] * len(now)
        for i, (old, new) in enumerate(zip(before, now, strict=True)):
            yield from differences(old, new, _within(key, i), each[i])
    elif before != now and not (before != before and now != now):  # both may be no number
        yield Difference(key, before, now, std if _is_number(std) else 0.0)


def _within(key: str, name: object) -> str:
    """Key of an entry inside the entry `key`."""
    return f"{key}.{name}".lstrip(".")


def table_difference(before: Path, now: Path) -> float:
    """Largest difference of numbers in two CSV files, relative to the largest in their column.

    Args:
        before: The stored file.
        now: The new file.

    Returns:
        The relative difference; infinite if the tables' sizes or cells other than numbers differ.
    """
    tables = []
    for path in (before, now):
        with path.open(encoding="utf-8", newline="") as file:
            tables.append(list(csv.reader(file)))
    if len({tuple(map(len, table)) for table in tables}) > 1:
        return np.inf
    difference = 0.0
    for old, new in zip(*(zip(*table, strict=True) for table in tables), strict=True):
        pairs = [pair for pair in zip(old, new, strict=True) if pair[0] != pair[1]]
        if pairs:
            try:
                column = np.array([_number(cell) for cell in new])
                differing = [abs(float(a) - float(b)) for a, b in pairs]
            except ValueError:
                return np.inf
            size = float(np.nanmax(np.abs(column), initial=0.0))
            largest = max(differing) / size if size > 0.0 else np.inf
            difference = max(difference, largest if np.isfinite(largest) else np.inf)
    return difference


def _number(cell: str) -> float:
    """The number in a cell; NaN for text such as a heading."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def posterior_difference(before: Posterior, now: Posterior) -> tuple[float, float] | None:
    """Difference of two posteriors on one grid.

    Args:
        before: The stored posterior.
        now: The new posterior.

    Returns:
        The largest difference of means in standard deviations, and the largest relative difference
        of standard deviations, at the nodes; None if the grids or state dimensions differ.
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
    equal = all(np.array_equal(old, new) for old, new in fields)
    step = 0.0 * std if equal else before.state.difference(now.state).reshape(std.shape)
    return float(np.max(np.abs(step) / std)), float(np.max(np.abs(former / std - 1.0)))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
