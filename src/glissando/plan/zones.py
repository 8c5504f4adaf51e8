"""Zones: where along the body and when confidence is wanted, fixed or moving, several, weighted."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from glissando.errors import GlissandoError
from glissando.se3 import Array

_PLACES = 5  # points of a zone across its arclengths
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TEXT = re.compile(
    rf"({_NUMBER}):({_NUMBER})(?:\.\.({_NUMBER}):({_NUMBER}))?"
    rf"(?:@({_NUMBER}):({_NUMBER}))?(?:\*({_NUMBER}))?"
)

Interval = tuple[float, float]


@dataclass(frozen=True)
class Zone:
    """Arclengths (m) from `arclength[0]` to `arclength[1]` during `time` (s), with a `weight`.

    A zone that moves gives `arclength` as a function of times (K,) that returns both ends (K,). No
    `time` means always. Raises GlissandoError for intervals that are empty.

    >>> Zone((0.6, 0.7), (2.0, 4.0)).points(np.array([1.0, 3.0]))[1]
    array([3., 3., 3., 3., 3.])
    """

    arclength: Interval | Callable[[Array], tuple[Array, Array]]
    time: Interval | None = None
    weight: float = 1.0

    def __post_init__(self) -> None:
        intervals = [self.time] + ([] if callable(self.arclength) else [self.arclength])
        for interval in (i for i in intervals if i is not None):
            if not (np.all(np.isfinite(interval)) and interval[0] <= interval[1]):
                raise GlissandoError(
                    f"A zone from {interval[0]:g} to {interval[1]:g} is empty; give the lower end "
                    f"first."
                )
        if not (np.isfinite(self.weight) and self.weight > 0.0):
            raise GlissandoError(f"A zone of weight {self.weight:g} cannot be; give one above 0.")

    def ends(self, time: Array) -> tuple[Array, Array]:
        """Both ends (K,) at times (K,)."""
        if callable(self.arclength):
            low, high = self.arclength(time)
        else:
            low, high = self.arclength
        return np.broadcast_to(low, time.shape), np.broadcast_to(high, time.shape)

    def middle(self, time: Array) -> Array:
        """Where the zone's middle is (K,), also at times when it does not count."""
        low, high = self.ends(time)
        return 0.5 * (low + high)

    def points(self, time: Array) -> tuple[Array, Array]:
        """Arclengths and times (M,) of points that stand for the zone at those of times (K,)."""
        if self.time is not None:
            inside = time[(time >= self.time[0]) & (time <= self.time[1])]
            time = inside if inside.size else np.array([0.5 * sum(self.time)])
        low, high = self.ends(time)
        count = _PLACES if np.any(high > low) else 1
        share = (np.arange(count) + 0.5) / count
        return (low[:, None] + share * (high - low)[:, None]).ravel(), np.repeat(time, count)


def zone_points(
    zones: Sequence[Zone], time: Array, length: float, last: float
) -> tuple[Array, Array, Array]:
    """Arclengths, times and weights (M,) of all zones' points; a zone's weight is shared by its.

    Weights add up to one. Raises GlissandoError when there is no zone, or one leaves the body of
    that `length` or the time ahead that ends at `last`.
    """
    if not zones:
        raise GlissandoError("There is no zone to be sure of; give one or more.")
    found = [(*zone.points(time), zone.weight) for zone in zones]
    arclength, at = (np.concatenate([f[i] for f in found]) for i in (0, 1))
    weight = np.concatenate([np.full(f[0].size, f[2] / f[0].size) for f in found])
    slack = 1e-9 * max(1.0, length)
    if arclength.min() < -slack or arclength.max() > length + slack:
        raise GlissandoError(
            f"A zone reaches from {arclength.min():g} to {arclength.max():g} m; the body from 0 to "
            f"{length:g} m. Give arclengths on it."
        )
    if at.min() < time[0] - 1.0 or at.max() > last + 1e-9:
        raise GlissandoError(
            f"A zone's time, {at.min():g} to {at.max():g} s, is not in the time ahead, which ends "
            f"at {last:g} s. Plan farther ahead, or give another time."
        )
    return np.clip(arclength, 0.0, length), at, weight / weight.sum()


def read_zone(text: str) -> Zone:
    """A zone from S0:S1, S0:S1@T0:T1, with ..S2:S3 for where it moves to and *W for its weight.

    Raises GlissandoError for anything else.

    >>> read_zone("0.1:0.2..0.5:0.6@0:10").middle(np.array([5.0]))
    array([0.35])
    """
    match = _TEXT.fullmatch(text.strip())
    if match is None:
        raise GlissandoError(
            f"Zone {text!r} is not understood; give S0:S1, S0:S1@T0:T1 or, if it moves, "
            f"S0:S1..S2:S3@T0:T1, in metres and seconds, with *WEIGHT if it has one."
        )
    low, high, low2, high2, start, stop, weight = (
        None if part is None else float(part) for part in match.groups()
    )
    assert low is not None
    assert high is not None
    time = None if start is None or stop is None else (start, stop)
    given = 1.0 if weight is None else weight
    if low2 is None or high2 is None:
        return Zone((low, high), time, given)
    if time is None or time[1] <= time[0]:
        raise GlissandoError(f"Zone {text!r} moves, so it needs times: add @T0:T1.")
    Zone((low, high)), Zone((low2, high2), time)  # their ends are in order

    def moving(at: Array) -> tuple[Array, Array]:
        return np.interp(at, time, (low, low2)), np.interp(at, time, (high, high2))

    return Zone(moving, time, given)
