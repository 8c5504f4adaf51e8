"""Arclength intervals of a rod with known mechanics: errors, states inside, and their rates.

The error of an interval is the deviation of its end from that of an undisturbed rod, r =
[log(T̂₁⁻¹ T₁); ε₁ − ε̂₁], in pose and strain; at known stiffness strain and internal wrench are
equivalent. A node has 24 components, [pose, strain, velocity, strain rate], and with inertia 30:
[acceleration, its rate] follow, which act as weight does. Source: (26), (27) and (32).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from glissando._kernels import rod_intervals as kernels
from glissando._kernels.arrays import whole
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.priors.intervals import strain_rate_of
from glissando.model.priors.mechanical.flow import Flow, Section, flow
from glissando.model.state import State


@dataclass(frozen=True)
class Intervals:
    """Lengths and mechanics of intervals (M,), and stiffness beyond their ends.

    Attributes:
        step: Lengths (M,), m.
        section: Stiffness, rest strain, weight and noise along them.
        end_stiffness: Stiffness (M, 6) beyond their ends.
        end_rest: Rest strain (M, 6) beyond their ends.
        jump: Variances (M, 6) of a point load at their ends, N² and N² m².
        mass: Mass per metre (M,), kg/m.
    """

    step: Array
    section: Section
    end_stiffness: Array
    end_rest: Array
    jump: Array
    mass: Array

    def take(self, index: np.ndarray) -> Intervals:
        """Intervals with the given indices."""
        others = (self.end_stiffness[index], self.end_rest[index], self.jump[index])
        return Intervals(self.step[index], self.section.take(index), *others, self.mass[index])

    def accelerated(self, start: State, end: State) -> Intervals:
        """Intervals with the inertial force between two nodes added to the weight. Source: (32)."""
        if start.inertia is None or end.inertia is None:
            return self
        early, late = (-self.mass[:, None] * at[:, :3] for at in (start.inertia, end.inertia))
        weight, slope = self.section.weight + early, (late - early) / self.step[:, None]
        return replace(self, section=replace(self.section, weight=weight, weight_slope=slope))

    @cached_property
    def columns(self) -> Array:
        """Parameters (M, 38) of the intervals, as kernels take them."""
        made = self.section
        rods = self.step[:, None], made.stiffness, made.rest, made.rest_slope
        acting = made.weight, made.weight_slope
        beyond = self.end_stiffness, self.end_rest, self.mass[:, None]
        return np.concatenate([*rods, *acting, *beyond], axis=1)

    def wrench(self, start: State) -> Array:
        """Internal wrench (M, 6) of nodes where the intervals begin."""
        return self.section.stiffness * (start.strain - self.section.rest)

    def flow(self, start: State, *, noisy: bool) -> Flow:
        """Flow of undisturbed rods in pose and strain, with point loads in the noise."""
        rotation, stiffness = start.pose[:, :3, :3], self.section.stiffness
        by_wrench = flow(rotation, self.wrench(start), self.step, self.section, noisy=noisy)
        noise = by_wrench.noise
        noise[:, range(6, 12), range(6, 12)] += self.jump
        return in_strain(by_wrench, stiffness, self.end_stiffness, self.end_rest)

    def before(self, offset: Array) -> Intervals:
        """Parts of the intervals up to `offset` (M,) metres."""
        section, rest = self.section, self.section.ahead(offset).rest
        none = np.zeros_like(self.jump)
        return Intervals(offset, section, section.stiffness, rest, none, self.mass)

    def beyond(self, offset: Array) -> Intervals:
        """Parts of the intervals from `offset` (M,) metres on."""
        others = (self.end_stiffness, self.end_rest, self.jump, self.mass)
        return Intervals(self.step - offset, self.section.ahead(offset), *others)


@np.errstate(over="ignore", invalid="ignore")
def in_strain(by_wrench: Flow, begin: Array, end: Array, rest: Array) -> Flow:
    """Flow with strains in place of wrenches, for stiffness (M, 6) at both ends."""
    ones = np.ones_like(begin)
    into, out = np.concatenate([ones, begin], -1), np.concatenate([ones, 1.0 / end], -1)
    transition = out[:, :, None] * by_wrench.transition * into[:, None, :]
    noise = out[:, :, None] * by_wrench.noise * out[:, None, :]
    by_weight = out[:, :, None] * by_wrench.by_weight
    return Flow(by_wrench.pose, rest + by_wrench.wrench / end, transition, noise, by_weight)


def still_error(start: State, end: State, intervals: Intervals) -> tuple[Array, Array]:
    """Error r (M, 12) of intervals, Jacobians (M, 12, 2, 12) by pose and strain of both ends.

    With inertia the Jacobians are (M, 12, 2, 15), the last three columns by the acceleration.
    """
    error, slopes = kernels.still_error(*_ends(start, end), intervals.columns, _half(start))
    return error, slopes


def interval_error(start: State, end: State, intervals: Intervals) -> tuple[Array, Array]:
    """Error [r; ṙ] (M, 24) of intervals, Jacobian (M, 24, 2, dof) by both ends.

    Source: equations (27) and (9).
    """
    error, slopes = kernels.interval_error(*_ends(start, end), intervals.columns, _half(start))
    return error, slopes


def _ends(start: State, end: State) -> tuple[Array, Array, Array, Array]:
    """Poses and concatenated other fields of both ends (M,), as kernels take them."""
    fields0, fields1 = (np.concatenate(at.fields()[1:], axis=-1) for at in (start, end))
    return whole(start.pose), whole(end.pose), fields0, fields1


def _half(at: State) -> int:
    """Number of a node's components that are not rates."""
    return 12 if at.inertia is None else 15


def still_columns(half: int) -> Index:
    """Indices of a node's pose, strain and acceleration, `half` of them."""
    return np.r_[0:12, 24 : 12 + half]


@np.errstate(over="ignore", invalid="ignore")
def interval_end(start: State, error: Array, intervals: Intervals) -> tuple[State, Array]:
    """State (M,) at the end of intervals with an error [r; ṙ] (M, 24): inverts `interval_error`.

    The second value is the transition matrix (M, 12, 12) of the undisturbed rods.
    """
    ahead = intervals.flow(start, noisy=False)
    xi = error[:, :6]
    pose = start.pose @ ahead.pose @ se3.exp(xi)
    motion = np.concatenate([start.velocity, strain_rate_of(start)], axis=-1)
    carried = (ahead.transition @ motion[:, :, None])[..., 0]
    left = error[:, 12:].copy()
    left[:, :6] += (se3.right_jacobian_inverse(-xi) @ carried[:, :6, None])[..., 0]
    left[:, 6:] += carried[:, 6:]
    velocity = (se3.right_jacobian(xi) @ left[:, :6, None])[..., 0]
    end = State(pose, ahead.wrench + error[:, 6:12], velocity, left[:, 6:])
    return end, ahead.transition


def bridge(start: State, intervals: Intervals, offset: Array) -> tuple[Array, Array]:
    """Gain from an interval's error to that of a point, and bridge covariance, (M, 12, 12)."""
    near = intervals.before(offset).flow(start, noisy=True)
    point = State(start.pose @ near.pose, near.wrench, start.velocity)
    onward = intervals.beyond(offset).flow(point, noisy=True)
    cross = onward.transition @ near.noise
    whole = cross @ np.swapaxes(onward.transition, -1, -2) + onward.noise
    scale = 1.0 / np.sqrt(np.einsum("mii->mi", whole))
    even = scale[:, :, None] * whole * scale[:, None, :]
    gain = np.swapaxes(np.linalg.solve(even, scale[:, :, None] * cross), -1, -2) * scale[:, None, :]
    return gain, near.noise - gain @ cross


def interval_between(
    start: State, end: State, intervals: Intervals, offset: Array, gain: Array
) -> tuple[State, Array]:
    """State inside intervals, Jacobian (M, 24, 2, dof) by both ends. Source: (27) and (10).

    Args:
        start: State (M,) with strain rate where the intervals begin.
        end: State (M,) where they end.
        intervals: The intervals.
        offset: Distances (M,) of the points from the beginnings, m.
        gain: Gains (M, 12, 12) from the error of the interval to that of the point.
    """
    inside = intervals.columns, whole(offset), whole(gain), _half(start)
    pose, fields, slopes = kernels.interval_between(*_ends(start, end), *inside)
    return State(pose, fields[:, :6], fields[:, 6:12], fields[:, 12:]), slopes
