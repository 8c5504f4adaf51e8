"""Whether a result computed again is the same, and what differs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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
    """

    key: str
    before: Any
    now: Any

    @property
    def size(self) -> float:
        """The difference of numbers, relative to the larger one; infinite for anything else."""
        if not (_is_number(self.before) and _is_number(self.now)):
            return np.inf
        largest = max(abs(self.before), abs(self.now))
        return abs(self.before - self.now) / largest if np.isfinite(largest) else np.inf


def differences(before: Any, now: Any, key: str = "") -> Iterator[Difference]:
    """The entries of two documents of JSON that are not equal.

    >>> [d.key for d in differences({"a": [1, 2], "b": 3}, {"a": [1, 4], "b": 3})]
    ['a.1']
    """
    if isinstance(before, dict) and isinstance(now, dict):
        pairs = {k: (before.get(k), now.get(k)) for k in (*before, *now)}
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = dict(enumerate(zip(before, now, strict=True)))
    else:
        both_nan = before != before and now != now
        if before != now and not both_nan:
            yield Difference(key, before, now)
        return
    for name, (then, here) in pairs.items():
        yield from differences(then, here, f"{key}.{name}".lstrip("."))


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
