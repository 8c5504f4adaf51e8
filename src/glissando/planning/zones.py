"""Zones: arclength and time intervals of the body whose position should be known accurately."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.given import require_list
from glissando.geometry.se3 import Array
from glissando.model.field_checks import is_number

_POINTS = 5  # points along the arclengths of a zone
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TEXT = re.compile(
    rf"({_NUMBER}):({_NUMBER})(?:\.\.({_NUMBER}):({_NUMBER}))?"
    rf"(?:@({_NUMBER}):({_NUMBER}))?(?:\*({_NUMBER}))?"
)

Interval = tuple[float, float]


@dataclass(frozen=True)
class MovingInterval:
    """An interval of arclength that moves at constant speed from one place to another.

    Attributes:
        time: Start and end of the movement, s.
        first: Lower and upper end of the interval before the movement, m.
        last: Lower and upper end after the movement, m.

    >>> MovingInterval((0.0, 10.0), (0.1, 0.2), (0.5, 0.6))(np.array([5.0]))
    (array([0.3]), array([0.4]))
    """

    time: Interval
    first: Interval
    last: Interval

    def __post_init__(self) -> None:
        for interval in (self.time, self.first, self.last):
            _require_interval(interval)
        if not self.time[0] < self.time[1]:
            raise GlissandoError(f"A zone cannot move within {self.time!r} s; give T0 < T1.")

    def __call__(self, time: Array) -> tuple[Array, Array]:
        """Lower and upper ends (K,), m, at times (K,), s."""
        low, high = (np.interp(time, self.time, e) for e in zip(self.first, self.last, strict=True))
        return low, high


@dataclass(frozen=True)
class Zone:
    """An interval of the body whose position should be known accurately for some time.

    Attributes:
        arclength: Lower and upper end, m; for a moving zone a function of times (K,), s, that
            returns both ends (K,), for instance `MovingInterval`.
        time: Start and end of the time in which the zone counts, s; None for always.
        weight: Weight relative to other zones.

    Raises:
        GlissandoError: An interval is empty or the weight is not positive.

    >>> Zone((0.6, 0.7)).points(np.array([3.0]))[0]
    array([0.61, 0.63, 0.65, 0.67, 0.69])
    """

    arclength: Interval | Callable[[Array], tuple[Array, Array]]
    time: Interval | None = None
    weight: float = 1.0

    def __post_init__(self) -> None:
        if not callable(self.arclength):
            _require_interval(self.arclength)
        if self.time is not None:
            _require_interval(self.time)
        if not (is_number(self.weight) and 0.0 < self.weight < np.inf):
            raise GlissandoError(f"A zone of weight {self.weight!r} cannot be; give one above 0.")

    def ends(self, time: Array) -> tuple[Array, Array]:
        """Lower and upper ends (K,), m, at times (K,), s, including times outside `time`."""
        ends = self.arclength(time) if callable(self.arclength) else self.arclength
        low, high = (np.broadcast_to(np.asarray(end, dtype=float), time.shape) for end in ends)
        return low, high

    def overlap(self, first: float, last: float) -> Interval | None:
        """Intersection of the zone's time with the interval [first, last], s; None if empty."""
        if self.time is None:
            return first, last
        begin, end = max(self.time[0], first), min(self.time[1], last)
        return (begin, end) if begin <= end else None

    def points(self, time: Array) -> tuple[Array, Array]:
        """Arclengths, m, and times, s, (M,) of points spread over the zone at times (K,)."""
        low, high = self.ends(time)
        count = _POINTS if np.any(high > low) else 1
        share = (np.arange(count) + 0.5) / count
        return (low[:, None] + share * (high - low)[:, None]).ravel(), np.repeat(time, count)


def _require_interval(given: object) -> None:
    """Raise GlissandoError unless `given` is the lower and upper end of an interval."""
    try:
        low, high = (float(end) for end in given)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        raise GlissandoError(
            f"A zone from {given!r} cannot be; give both ends as (0.6, 0.7), in metres or seconds, "
            f"or read_zone('0.6:0.7')."
        ) from None
    if not (np.isfinite([low, high]).all() and low <= high):
        raise GlissandoError(f"A zone from {low:g} to {high:g} is empty; give the lower end first.")


def zone_points(
    zones: Sequence[Zone], time: Array, span: Interval, length: float
) -> tuple[Array, Array, Array]:
    """Points that represent all zones; a zone's weight is divided evenly among its points.

    Args:
        zones: One zone or more.
        time: Times (K,) at which zones are evaluated, s.
        span: Start and end of the planning horizon, s.
        length: Length of the body, m.

    Returns:
        Arclengths, m, times, s, and weights (M,) of the points; the weights add up to one.

    Raises:
        GlissandoError: There is no zone, or a zone leaves the body or the horizon.
    """
    require_list(zones, Zone, "zones")
    if not zones:
        raise GlissandoError(
            f"No zone counts between {span[0]:g} and {span[1]:g} s; give one that does."
        )
    points = []
    for zone in zones:
        overlap = zone.overlap(*span)
        if overlap is None:
            assert zone.time is not None
            raise GlissandoError(
                f"A zone lasts from {zone.time[0]:g} to {zone.time[1]:g} s, the time ahead from "
                f"{span[0]:g} to {span[1]:g} s. Plan farther ahead, or give another time."
            )
        inside = time[(time >= overlap[0]) & (time <= overlap[1])]
        inside = inside if inside.size else np.array([0.5 * sum(overlap)])
        low, high = (float(end) for end in (zone.ends(inside)[0].min(), zone.ends(inside)[1].max()))
        if low < -1e-9 or high > length + 1e-9:
            raise GlissandoError(
                f"A zone reaches from {low:g} to {high:g} m; the body from 0 to {length:g} m. Give "
                f"arclengths on it."
            )
        place, at = zone.points(inside)
        points.append((place, at, np.full(at.size, zone.weight / at.size)))
    place, at, weight = (np.concatenate(part) for part in zip(*points, strict=True))
    return np.clip(place, 0.0, length), at, weight / weight.sum()


def read_zone(text: str) -> Zone:
    """Parse a zone: S0:S1, S0:S1@T0:T1 or S0:S1..S2:S3@T0:T1, with *W for a weight.

    Raises:
        GlissandoError: The text has another form, or the zone is invalid.

    >>> np.mean(read_zone("0.1:0.2..0.5:0.6@0:10").ends(np.array([5.0])), axis=0)
    array([0.35])
    """
    match = _TEXT.fullmatch(text.strip())
    if match is None:
        raise GlissandoError(
            f"Zone {text!r} is not understood; give S0:S1, S0:S1@T0:T1 or, if it moves, "
            f"S0:S1..S2:S3@T0:T1, in metres and seconds, with *WEIGHT if it has one."
        )
    numbers = match.groups()
    first, last, time = (
        None if low is None else (float(low), float(high))
        for low, high in zip(numbers[:6:2], numbers[1:6:2], strict=True)
    )
    assert first is not None
    zone = Zone(first, time, float(match[7] or 1.0))
    if last is None:
        return zone
    if time is None or time[1] <= time[0]:
        raise GlissandoError(f"Zone {text!r} moves, so it needs times: add @T0:T1.")
    Zone(last)  # checks the order of the ends
    return replace(zone, arclength=MovingInterval(time, first, last))
