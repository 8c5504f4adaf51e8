"""Bootstrap intervals of statistics over seeds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from glissando.geometry.se3 import Array

COLUMNS = ("position_rmse", "rotation_rmse", "nees_position", "coverage95_position", "converged")
"""Metrics of a trial, in the order of the columns of `summary`'s argument."""


def bootstrap(count: int, resamples: int) -> NDArray[np.intp]:
    """Indices (1 + R, S) of a sample of S and of R resamples of it, from a fixed seed."""
    draws = np.random.default_rng(0).integers(count, size=(resamples, count))
    return np.vstack([np.arange(count), draws])


def rms(values: Array) -> Array:
    """Root mean square along the last axis."""
    return np.sqrt(np.mean(values**2, axis=-1))


def interval(values: Array, count: int, most: float | None = None) -> dict[str, Any]:
    """Value of a statistic over seeds, and its 95 % interval.

    Resamples of few seeds vary too little: with two seeds, all lie between the two values, an
    interval that contains the true value half of the time. Distances of the resamples' quantiles
    from the value are therefore multiplied by √(S / (S − 1)) and by the ratio of the quantiles of
    Student's t and the normal distribution. For a positive statistic without an upper limit these
    are distances of logarithms, so that the interval stays positive.

    Args:
        values: A non-negative statistic (1 + R,) of the samples of `bootstrap`.
        count: Number of seeds.
        most: Upper limit of the statistic; None if there is none.

    Returns:
        `value`, `low` and `high`; for one seed both ends are None.
    """
    value = float(values[0])
    if count < 2:
        return {"value": value, "low": None, "high": None}
    by_log = most is None and bool(values.min() > 0.0)
    scaled = np.log(values) if by_log else values
    inflation = np.sqrt(count / (count - 1)) * stdtrit(count - 1, 0.975) / stdtrit(np.inf, 0.975)
    ends = scaled[0] + inflation * (np.quantile(scaled[1:], [0.025, 0.975]) - scaled[0])
    low, high = np.clip(np.exp(ends) if by_log else ends, 0.0, most)
    return {"value": value, "low": float(low), "high": float(high)}


def summary(outcomes: Array, fixed: Array | None = None) -> dict[str, Any]:
    """RMSE, NEES and coverage over seeds, and the change of RMSE against a fixed sensor.

    Args:
        outcomes: A row of COLUMNS (S, 5) for every seed.
        fixed: The same (S', 5) for the fixed sensor; rows of the same seed are compared.

    Returns:
        Number of seeds, share of converged estimates, and an interval for each of position (m),
        position_cm, rotation (rad), nees, coverage and, if `fixed` is given, position_change and
        rotation_change (%).
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
