"""Every path a slide can take from where it is, and nothing but: limits kept by construction.

A path is a uniform quadratic B-spline in time, so its acceleration is constant between knots. Its
speed at the knots is the difference of neighbouring control points, its acceleration their second
difference, and it never leaves the hull of its control points: limits on these are limits on the
path at every instant. They bound a convex body of control points, in which a planner may move.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.slide_path import SlideLimits

_KEPT = 1.0 - 1e-7  # of a limit, so that rounding does not break it


@dataclass(frozen=True)
class PathSpace:
    """Paths of `steps` pieces of `step` seconds from arclength `start` at `start_speed` m/s.

    The sensor stays between the arclengths `lower` and `upper`, m, no faster and no sharper than
    `speed` and `acceleration`, and is at rest in the end. Raises GlissandoError when it cannot.
    """

    lower: float
    upper: float
    speed: float
    acceleration: float
    step: float
    steps: int
    start: float
    start_speed: float = 0.0

    def __post_init__(self) -> None:
        positive = self.speed, self.acceleration, self.step, self.upper - self.lower
        if not (np.all(np.isfinite(positive)) and min(positive) > 0.0 and self.steps >= 2):
            raise GlissandoError(
                f"A slide from {self.lower:g} to {self.upper:g} m at {self.speed:g} m/s and "
                f"{self.acceleration:g} m/s² for {self.steps} steps of {self.step:g} s has nowhere "
                f"to go; give numbers above zero, and two steps or more."
            )
        if not self.lower - 1e-9 <= self.start <= self.upper + 1e-9:
            raise GlissandoError(
                f"The sensor is at {self.start:g} m, off its slide from {self.lower:g} to "
                f"{self.upper:g} m; give a start on it."
            )
        way = np.array(self.start_speed * self.step)
        low, high = self._bounds(np.array(self.start) + 0.5 * way, way, self.steps - 1)
        if low > high + 1e-9 * self._most[1]:
            raise GlissandoError(
                f"At {self.start:g} m and {self.start_speed:g} m/s the slide cannot stop within "
                f"its limits; start slower, farther from its end, or plan farther ahead."
            )

    @property
    def times(self) -> Array:
        """Middles (T,) of the steps, seconds from the start: where a path is judged."""
        return np.asarray((np.arange(self.steps) + 0.5) * self.step)

    @property
    def lasts(self) -> float:
        """How long a path is, seconds."""
        return self.steps * self.step

    @property
    def control_times(self) -> Array:
        """Times (T + 2,) that control points stand for."""
        return np.asarray((np.arange(self.steps + 2) - 0.5) * self.step)

    @property
    def _most(self) -> tuple[float, float]:
        """Largest first and second difference of control points, metres."""
        return _KEPT * self.speed * self.step, _KEPT * self.acceleration * self.step**2

    def places(self, control: Array) -> Array:
        """Arclengths (…, T) at `times` of paths with control points (…, T + 2)."""
        return (control[..., :-2] + 6.0 * control[..., 1:-1] + control[..., 2:]) / 8.0

    def knots(self, control: Array) -> tuple[Array, Array, Array]:
        """Times, arclengths and speeds (T + 1,) at the knots, constant acceleration between."""
        place = 0.5 * (control[1:] + control[:-1])
        time = np.asarray(self.step * np.arange(place.size))
        return time, place, np.diff(control) / self.step

    def follow(self, wanted: Array) -> Array:
        """Control points (…, T + 2) of the paths that go where `wanted` (…, T + 2) as they can.

        Each step is the longest that leads there and can still be stopped before the slide or the
        time ends.
        """
        sharpest = self._most[1]
        out = np.empty(wanted.shape)
        way = np.full(wanted.shape[:-1], self.start_speed * self.step)
        out[..., 0], out[..., 1] = self.start - 0.5 * way, self.start + 0.5 * way
        for j in range(1, self.steps + 1):
            here = out[..., j]
            gap = wanted[..., j + 1] - here
            low, high = self._bounds(here, way, self.steps - j)
            wish = np.sign(gap) * _stoppable(np.abs(gap), sharpest)
            way = np.minimum(np.maximum(wish, low), np.maximum(low, high))
            out[..., j + 1] = here + way
        return out

    def _bounds(self, here: Array, way: Array, left: int) -> tuple[Array, Array]:
        """Least and largest next step at a control point reached by a step, `left` before rest."""
        fastest, sharpest = self._most
        most = min(fastest, left * sharpest)
        low = np.maximum(way - sharpest, -most)
        high = np.minimum(way + sharpest, most)
        low = np.maximum(low, -_stoppable(here - self.lower, sharpest))
        return low, np.minimum(high, _stoppable(self.upper - here, sharpest))

    @cached_property
    def body(self) -> tuple[Array, Array, Array]:
        """A (m, n), centre (m,) and half width (m,) with |A c − centre| ≤ width, c the free points.

        Free are the n = T − 1 control points from the third on; the last two are the same.
        """
        fastest, sharpest = self._most
        full = np.eye(self.steps + 2)
        first, second = np.diff(full, axis=0), np.diff(full, 2, axis=0)
        rows = np.concatenate([full[2:-1], first[1:-1], second])
        half = 0.5 * (self.upper - self.lower)
        counts = self.steps - 1, self.steps - 1, self.steps
        middle = np.repeat([0.5 * (self.upper + self.lower), 0.0, 0.0], counts)
        fixed = rows[:, :2] @ self.whole(np.zeros(1))[:2]
        return self.free(rows), middle - fixed, np.repeat([half, fastest, sharpest], counts)

    @staticmethod
    def free(slope: Array) -> Array:
        """Slopes (…, n) by the free control points of those (…, T + 2) by all."""
        out = slope[..., 2:-1].copy()
        out[..., -1] += slope[..., -1]
        return out

    def whole(self, free: Array) -> Array:
        """All control points (T + 2,) of the free ones (n,)."""
        way = 0.5 * self.start_speed * self.step
        return np.concatenate([[self.start - way, self.start + way], free, free[-1:]])

    def slope(self, by_place: Array) -> Array:
        """Slope (T + 2,) by control points of that (T,) by the places at `times`."""
        out = np.zeros(self.steps + 2)
        for i, share in enumerate((0.125, 0.75, 0.125)):
            out[i : i + self.steps] += share * by_place
        return out


def track_of(
    limits: SlideLimits, upper: float, start: float, horizon: float, step: float = 0.1
) -> PathSpace:
    """What a stage can do in `horizon` seconds with the sensor at `upper` m when drawn out."""
    steps = max(2, round(horizon / step))
    lower = upper - limits.stroke
    return PathSpace(lower, upper, limits.speed, limits.acceleration, step, steps, start)


def _stoppable(room: Array, sharpest: float) -> Array:
    """Longest first step that, shortened by `sharpest` each time, stops within `room`, if any."""
    ratio = np.maximum(room, 0.0) / sharpest
    count = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * ratio) - 1.0))
    step = (room + 0.5 * sharpest * count * (count + 1.0)) / (count + 1.0)
    return np.where(room < 0.0, room, step)
