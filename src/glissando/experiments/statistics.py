"""Bootstrap intervals over seeds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from glissando.geometry.se3 import Array

COLUMNS = ("position_rmse", "rotation_rmse", "nees_position", "coverage95_position", "converged")
"""Metrics of a trial that `summary` takes, in the order of its columns."""


def bootstrap(count: int, resamples: int) -> NDArray[np.intp]:
    """Indices (1 + R, S) of a sample of S, then of R samples drawn from it; the same every time."""
    draws = np.random.default_rng(0).integers(count, size=(resamples, count))
    return np.vstack([np.arange(count), draws])


def rms(values: Array) -> Array:
    """Root mean square along the last axis."""
    return np.sqrt(np.mean(values**2, axis=-1))


def interval(values: Array, count: int, most: float | None = None) -> dict[str, Any]:
    """The value of a sample of seeds, and its 95 % interval.

    Samples drawn again from a few seeds are too alike: of two seeds every one lies between both,
    where the truth is half of the time. The resamples are therefore spread about the value as
    Student's t is, by logarithms where no number is zero, so that the interval stays positive.

    Args:
        values: A statistic (1 + R,) of the samples of `bootstrap`, from zero up.
        count: Number of seeds.
        most: The largest value there can be, if there is one.

    Returns:
        `value`, `low` and `high`; one seed has None for both ends.
    """
    value = float(values[0])
    if count < 2:
        return {"value": value, "low": None, "high": None}
    by_log = most is None and bool(values.min() > 0.0)
    scaled = np.log(values) if by_log else values
    wider = np.sqrt(count / (count - 1)) * stdtrit(count - 1, 0.975) / stdtrit(np.inf, 0.975)
    ends = scaled[0] + wider * (np.quantile(scaled[1:], [0.025, 0.975]) - scaled[0])
    low, high = np.clip(np.exp(ends) if by_log else ends, 0.0, most)
    return {"value": value, "low": float(low), "high": float(high)}


def summary(outcomes: Array, fixed: Array | None = None) -> dict[str, Any]:
    """RMSE, NEES and coverage over seeds, and the change of RMSE against a fixed sensor.

    Args:
        outcomes: A row of COLUMNS (S, 5) for every seed.
        fixed: The same (S', 5) for the fixed sensor; rows of the same seed are compared.

    Returns:
        The number of seeds, the share that converged, and an interval each for position (m),
        position_cm, rotation (rad), position_change and rotation_change (%), nees and coverage.
    """
    seeds = len(outcomes) if fixed is None else min(len(outcomes), len(fixed))
    rows = bootstrap(seeds, 4000)
    out: dict[str, Any] = {"seeds": seeds, "converged": float(np.mean(outcomes[:, 4]))}
    for column, name in enumerate(("position", "rotation")):
        ours = rms(outcomes[rows, column])
        out[name] = interval(ours, seeds)
        if name == "position":
            out["position_cm"] = interval(100.0 * ours, seeds)
        if fixed is not None:
            ratio = interval(ours / rms(fixed[rows, column]), seeds)
            change = {at: None if of is None else 100.0 * (of - 1.0) for at, of in ratio.items()}
            out[f"{name}_change"] = change
    for column, name, most in ((2, "nees", None), (3, "coverage", 1.0)):
        out[name] = interval(np.mean(outcomes[rows, column], axis=1), seeds, most)
    return out
