"""Whether a result computed again is the same, and what differs."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glissando.estimation.posterior import Posterior

SAME = 1e-9
"""Largest relative difference of numbers that count as the same: rounding of another BLAS."""


@dataclass(frozen=True)
class Difference:
    """An entry of a report that is not the same.

    Attributes:
        key: Where it is, keys and indices joined by dots.
        before: The value then; None if there was none.
        now: The value now; None if there is none.
        scale: The largest of the numbers in its list and of the deviations stated beside it.
    """

    key: str
    before: Any
    now: Any
    scale: float = 0.0

    @property
    def size(self) -> float:
        """The difference of numbers, relative to the largest; infinite for anything else."""
        if not (_is_number(self.before) and _is_number(self.now)):
            return np.inf
        largest = max(abs(self.before), abs(self.now), self.scale)
        return abs(self.before - self.now) / largest if np.isfinite(largest) else np.inf


def differences(before: Any, now: Any, key: str = "", scale: float = 0.0) -> Iterator[Difference]:
    """The entries of two documents of JSON that are not equal.

    >>> [d.key for d in differences({"a": [1, 2], "b": 3}, {"a": [1, 4], "b": 3})]
    ['a.1']
    """
    if isinstance(before, dict) and isinstance(now, dict):
        pairs, scale = {k: (before.get(k), now.get(k)) for k in (*before, *now)}, 0.0
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = dict(enumerate(zip(before, now, strict=True)))
        scale = max(scale, *_numbers(before), *_numbers(now), 0.0)
    else:
        both_nan = before != before and now != now
        if before != now and not both_nan:
            yield Difference(key, before, now, scale)
        return
    spread = max(_numbers(now.get("std")), default=0.0) if isinstance(now, dict) else scale
    for name, (then, here) in pairs.items():
        yield from differences(then, here, f"{key}.{name}".lstrip("."), max(scale, spread))


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
    found = 0.0
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
            found = max(found, largest if np.isfinite(largest) else np.inf)
    return found


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


def _numbers(value: Any) -> list[float]:
    """The sizes of the numbers in a list; none of anything else."""
    return [abs(x) for x in value if _is_number(x)] if isinstance(value, list) else []


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
