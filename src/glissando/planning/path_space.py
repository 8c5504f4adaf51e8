"""Paths that a stage can follow: B-splines that keep its limits by construction.

A path is a uniform quadratic B-spline in time, so its acceleration is constant between knots. Its
speed at the knots is the first difference of the control points, its acceleration their second
difference, and it never leaves their convex hull. Limits on the control points and their
differences therefore hold for the path at every instant; they form a convex polytope.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.given import require_kind
from glissando.geometry.se3 import Array
from glissando.model.slide_path import SlideLimits
from glissando.planning.optimize import Polytope

_SHARE = 1.0 - 1e-7  # share of a limit that is used, so that rounding does not exceed it
_TOUCH = 1e-10  # m, by which a path may pass the end of the slide


@dataclass(frozen=True)
class PathSpace:
    """All paths of a stage with a given initial position and speed that end at rest.

    Attributes:
        lower: Lowest arclength of the sensor, m.
        upper: Highest arclength of the sensor, m.
        speed: Largest speed, m/s.
        acceleration: Largest acceleration, m/s².
        step: Duration of a piece of the spline, s.
        steps: Number T of pieces.
        start: Initial arclength, m.
        start_speed: Initial speed, m/s.

    Raises:
        GlissandoError: The limits admit no path, or the sensor cannot stop within them.
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
        move = np.array(self.start_speed * self.step)
        low, high = self._bounds(np.array(self.start) + 0.5 * move, move, self.steps - 1)
        if low > high + 1e-9 * self._largest[1]:
            raise GlissandoError(
                f"At {self.start:g} m and {self.start_speed:g} m/s the slide cannot stop within "
                f"its limits; start slower, farther from its end, or plan farther ahead."
            )

    @property
    def duration(self) -> float:
        """Duration of a path, s."""
        return self.steps * self.step

    @property
    def times(self) -> Array:
        """Midpoints (T,) of the steps, s from the start, at which a path is evaluated."""
        return np.asarray((np.arange(self.steps) + 0.5) * self.step)

    @property
    def control_times(self) -> Array:
        """Times (T + 2,) of the control points, s from the start."""
        return np.asarray((np.arange(self.steps + 2) - 0.5) * self.step)

    @property
    def _largest(self) -> tuple[float, float]:
        """Largest first and second difference of control points, m."""
        return _SHARE * self.speed * self.step, _SHARE * self.acceleration * self.step**2

    def arclength(self, control: Array) -> Array:
        """Arclengths (…, T) at `times` of paths with control points (…, T + 2), m."""
        return (control[..., :-2] + 6.0 * control[..., 1:-1] + control[..., 2:]) / 8.0

    def knots(self, control: Array) -> tuple[Array, Array, Array]:
        """Times, arclengths and speeds (T + 1,) at knots with constant acceleration between."""
        place = 0.5 * (control[1:] + control[:-1])
        time = np.asarray(self.step * np.arange(self.steps + 1))
        return time, place, np.diff(control) / self.step

    def follow(self, target: Array) -> Array:
        """Control points (…, T + 2) of paths that follow targets as closely as the limits allow.

        The targets (…, T + 2) are at `control_times`. Each move towards the target is the longest
        from which the path can still stop before the end of the slide and of the time.
        """
        sharpest = self._largest[1]
        out = np.empty(target.shape)
        move = np.full(target.shape[:-1], self.start_speed * self.step)
        out[..., 0], out[..., 1] = self.start - 0.5 * move, self.start + 0.5 * move
        for j in range(1, self.steps + 1):
            gap = target[..., j + 1] - out[..., j]
            low, high = self._bounds(out[..., j], move, self.steps - j)
            wish = np.sign(gap) * _stoppable(np.abs(gap), sharpest)
            move = np.minimum(np.maximum(wish, low), np.maximum(low, high))
            out[..., j + 1] = out[..., j] + move
        return out

    def _bounds(self, place: Array, move: Array, left: int) -> tuple[Array, Array]:
        """Bounds of the next move from a control point, `left` moves before the end at rest."""
        fastest, sharpest = self._largest
        most = min(fastest, left * sharpest)
        low = np.maximum(move - sharpest, -most)
        high = np.minimum(move + sharpest, most)
        low = np.maximum(low, -_stoppable(place - self.lower, sharpest, -move))
        return low, np.minimum(high, _stoppable(self.upper - place, sharpest, move))

    @cached_property
    def polytope(self) -> Polytope:
        """Limits of the n = T − 1 free control points, the third to the last but one.

        The last control point equals the one before, so that the path ends at rest.
        """
        fastest, sharpest = self._largest
        full = np.eye(self.steps + 2)
        first, second = np.diff(full, axis=0), np.diff(full, 2, axis=0)
        rows = np.concatenate([full[2:-1], first[1:-1], second])
        counts = self.steps - 1, self.steps - 1, self.steps
        high = np.repeat([self.upper, fastest, sharpest], counts)
        low = np.repeat([self.lower, -fastest, -sharpest], counts)
        begun = self.control(np.zeros(1))[:2]
        move = begun[1] - begun[0]
        high[0] = min(high[0], begun[1] + _turning(self.upper - begun[1], move))
        low[0] = max(low[0], begun[1] - _turning(begun[1] - self.lower, -move))
        return _free(rows), 0.5 * (high + low) - rows[:, :2] @ begun, 0.5 * (high - low)

    def control(self, free: Array) -> Array:
        """All control points (T + 2,) of a path, m, from the free ones (n,)."""
        half = 0.5 * self.start_speed * self.step
        return np.concatenate([[self.start - half, self.start + half], free, free[-1:]])

    def free_gradient(self, by_place: Array, by_control: Array) -> Array:
        """Gradient (n,) with respect to the free control points.

        The value's partial gradients are `by_place` (T,), with respect to arclengths at `times`,
        and `by_control` (T + 2,), with respect to all control points.
        """
        total = by_control.copy()
        for i, share in enumerate((0.125, 0.75, 0.125)):
            total[i : i + self.steps] += share * by_place
        return _free(total)


def path_space_of(
    limits: SlideLimits, upper: float, start: float, horizon: float, step: float = 0.1
) -> PathSpace:
    """Space of the paths of a stage from rest.

    Args:
        limits: Limits of the stage.
        upper: Arclength of the sensor at zero displacement of the stage, m.
        start: Initial arclength of the sensor, m.
        horizon: Duration of a path, s.
        step: Duration of a piece of the spline, s.

    Raises:
        GlissandoError: The horizon is shorter than two steps, or the limits admit no path.
    """
    require_kind(limits, SlideLimits, "limits of the slide", "give SlideLimits(…)")
    if not (0.0 < step < np.inf and 2.0 * step <= horizon * (1.0 + 1e-9) < np.inf):
        raise GlissandoError(
            f"{horizon:g} s ahead in steps of {step:g} s cannot be planned; give two steps or more."
        )
    steps = round(horizon / step)
    lower = upper - limits.stroke
    return PathSpace(lower, upper, limits.speed, limits.acceleration, step, steps, start)


def _free(by_control: Array) -> Array:
    """Columns (…, n) of the free control points, from columns (…, T + 2) of all."""
    out = by_control[..., 2:-1].copy()
    out[..., -1] += by_control[..., -1]
    return out


def _stoppable(distance: Array, sharpest: float, last: Array | float = 0.0) -> Array:
    """Longest next move that, shortened by `sharpest` each time, stops within a distance.

    A path that begins between the knots of another may have its second control point beyond the
    end, at a negative distance. It then has to turn back before the end, after the `last` move.
    """
    ratio = np.maximum(distance, 0.0) / sharpest
    count = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * ratio) - 1.0))
    move = (distance + 0.5 * sharpest * count * (count + 1.0)) / (count + 1.0)
    return np.where(distance < 0.0, _turning(distance, last), move)


def _turning(distance: Array, last: Array | float) -> Array:
    """Longest next move of a piece that turns back before the end of the slide.

    The curve begins half the `last` move before the second control point, with that move as its
    speed, so it turns after last² / (2 (last − next)), which must not pass the end of the slide.
    If the second control point lies before the end, `distance` > 0, the convex hull suffices.
    """
    room = np.maximum(distance + 0.5 * last, 0.0) + _TOUCH
    turned = np.minimum(distance, last - 0.5 * last**2 / room)
    return np.where((distance < 0.0) & (last > 0.0), turned, distance)
