"""Arclength intervals of a rod with known mechanics: their errors, points inside, and rates.

The error of an interval says how far its end is from where an undisturbed rod arrives, r =
[log(T̂₁⁻¹ T₁); ε₁ − ε̂₁], in poses and strains; for a known stiffness strain is the internal wrench
in other units. A node, (M, 24), is [pose, strain, velocity, strain rate]; with inertia it goes on
with [acceleration, its rate], (M, 30), which act as weight does. Source: (26), (27) and (32).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.priors.intervals import RATED, strain_rate_of
from glissando.model.priors.mechanical.flow import Flow, Section, flow
from glissando.model.state import POSE, State, concatenate

V = TypeVar("V")

_NUDGE = 1e-4  # rad or so, by which nodes are moved to difference slopes along their motion


@dataclass(frozen=True)
class Intervals:
    """What intervals (M,) and the cross-sections at their ends are made of.

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
        """Those of the intervals."""
        others = (self.end_stiffness[index], self.end_rest[index], self.jump[index])
        return Intervals(self.step[index], self.section.take(index), *others, self.mass[index])

    def accelerated(self, start: State, end: State) -> Intervals:
        """The intervals with what inertia adds to the weight between two nodes. Source: (32)."""
        if start.inertia is None or end.inertia is None:
            return self
        early, late = (-self.mass[:, None] * at[:, :3] for at in (start.inertia, end.inertia))
        weight, slope = self.section.weight + early, (late - early) / self.step[:, None]
        return replace(self, section=replace(self.section, weight=weight, weight_slope=slope))

    def by_inertia(self, by_weight: Array) -> tuple[Array, Array]:
        """Slopes (M, 12, 3) by the acceleration of both ends, from those by the weight."""
        late = -self.mass[:, None, None] * by_weight[:, :, 3:] / self.step[:, None, None]
        return -self.mass[:, None, None] * by_weight[:, :, :3] - late, late

    def wrench(self, start: State) -> Array:
        """Internal wrench (M, 6) of nodes where the intervals begin."""
        return self.section.stiffness * (start.strain - self.section.rest)

    def flow(self, start: State, *, noisy: bool) -> Flow:
        """Where undisturbed rods arrive, in poses and strains, jumps in the noise."""
        rotation, stiffness = start.pose[:, :3, :3], self.section.stiffness
        found = flow(rotation, self.wrench(start), self.step, self.section, noisy=noisy)
        noise = found.noise
        noise[:, range(6, 12), range(6, 12)] += self.jump
        return in_strain(found, stiffness, self.end_stiffness, self.end_rest)

    def before(self, offset: Array) -> Intervals:
        """The intervals up to `offset` (M,) metres."""
        section, rest = self.section, self.section.ahead(offset).rest
        none = np.zeros_like(self.jump)
        return Intervals(offset, section, section.stiffness, rest, none, self.mass)

    def beyond(self, offset: Array) -> Intervals:
        """The intervals from `offset` (M,) metres on."""
        others = (self.end_stiffness, self.end_rest, self.jump, self.mass)
        return Intervals(self.step - offset, self.section.ahead(offset), *others)


@np.errstate(over="ignore", invalid="ignore")
def in_strain(found: Flow, begin: Array, end: Array, rest: Array) -> Flow:
    """A flow with strains in the place of wrenches, for stiffness (M, 6) at both ends."""
    ones = np.ones_like(begin)
    into, out = np.concatenate([ones, begin], -1), np.concatenate([ones, 1.0 / end], -1)
    transition = out[:, :, None] * found.transition * into[:, None, :]
    noise = out[:, :, None] * found.noise * out[:, None, :]
    by_weight = out[:, :, None] * found.by_weight
    return Flow(found.pose, rest + found.wrench / end, transition, noise, by_weight)


@np.errstate(over="ignore", invalid="ignore")
def still_error(start: State, end: State, intervals: Intervals) -> tuple[Array, Array, Array]:
    """Error r (M, 12) of intervals and Jacobians by pose and strain of both ends.

    The Jacobians are (M, 12, 12), or (M, 12, 15) and by the acceleration, too.
    """
    intervals = intervals.accelerated(start, end)
    ahead = intervals.flow(start, noisy=False)
    xi = se3.log(se3.inverse(start.pose @ ahead.pose) @ end.pose)
    error = np.concatenate([xi, end.strain - ahead.wrench], axis=-1)
    j0, j1 = -ahead.transition, np.zeros((len(xi), 12, 12))
    if start.inertia is not None:
        early, late = intervals.by_inertia(ahead.by_weight)
        j0, j1 = np.concatenate([j0, -early], axis=2), np.concatenate([j1, -late], axis=2)
    back = se3.right_jacobian_inverse(-xi)
    j0[:, :6], j1[:, :6] = back @ j0[:, :6], back @ j1[:, :6]
    j1[:, :6, :6], j1[:, 6:, 6:12] = se3.right_jacobian_inverse(xi), np.eye(6)
    return error, j0, j1


@np.errstate(over="ignore", invalid="ignore")
def interval_error(start: State, end: State, intervals: Intervals) -> tuple[Array, Array, Array]:
    """Error [r; ṙ] (M, 24) of intervals, Jacobians (M, 24, dof) by both ends. Source: (27), (9)."""
    (error, *slopes), change = _along_motion(still_error, start, end, intervals)
    error = error[: len(intervals.step)]
    rate, jacobians = np.zeros_like(error), []
    for at, slope, changed in zip((start, end), slopes, change, strict=True):
        rate += (slope @ _motion(at)[:, :, None])[..., 0]
        jacobians.append(_rated(slope, changed, at.velocity))
    j0, j1 = jacobians
    return np.concatenate([error, rate], axis=-1), j0, j1


def _along_motion(
    linearize: Callable[[State, State, Intervals], tuple[V, Array, Array]],
    start: State,
    end: State,
    intervals: Intervals,
) -> tuple[tuple[V, Array, Array], tuple[Array, Array]]:
    """What `linearize` gives, and how both its Jacobians change in time along the nodes' motion.

    Of the value only the first M entries are of the nodes where they are.
    """
    speed = sum(
        np.linalg.norm(at.velocity, axis=-1)
        + intervals.step * np.linalg.norm(strain_rate_of(at)[:, 3:], axis=-1)
        for at in (start, end)
    )
    nudge = _NUDGE / (_NUDGE + speed)
    moved = [_moved(start, x * nudge) for x in (0.0, 1.0, -1.0)]
    ends = [_moved(end, x * nudge) for x in (0.0, 1.0, -1.0)]
    every = np.tile(np.arange(len(nudge)), 3)
    value, j0, j1 = linearize(concatenate(*moved), concatenate(*ends), intervals.take(every))
    count, width = len(nudge), 2.0 * nudge[:, None, None]
    c0, c1 = ((j[count : 2 * count] - j[2 * count :]) / width for j in (j0, j1))
    return (value, j0[:count], j1[:count]), (c0, c1)


def _moved(at: State, time: Array) -> State:
    """Nodes (M,) after times (M,) of their motion, without their rates."""
    step = time[:, None]
    pose = at.pose @ se3.exp(step * at.velocity)
    inertia = None
    if at.inertia is not None:
        inertia = np.concatenate(
            [at.inertia[:, :3] + step * at.inertia[:, 3:], at.inertia[:, 3:]], 1
        )
    rate = strain_rate_of(at)
    return State(pose, at.strain + step * rate, at.velocity, rate, inertia)


def _motion(at: State) -> Array:
    """Rates of pose, strain and, with inertia, acceleration (M, 12 or 15)."""
    last = [] if at.inertia is None else [at.inertia[:, 3:]]
    return np.concatenate([at.velocity, strain_rate_of(at), *last], axis=-1)


def _rated(slope: Array, change: Array, velocity: Array) -> Array:
    """Jacobian (M, 24, dof) of [value, rate] by a node, from that of the value (M, 12, dof / 2).

    Two motions of a pose do not commute, so a slope that changes along the motion does so less
    the slope of their bracket.
    """
    half = slope.shape[2]
    value, rate = still_columns(half), np.r_[12:24, 12 + half : 2 * half]
    out = np.zeros((len(slope), RATED, 2 * half))
    out[:, :12, value] = out[:, 12:, rate] = slope
    out[:, 12:, value] = change
    out[:, 12:, POSE] -= slope[:, :, :6] @ se3.ad(velocity)
    return out


def still_columns(half: int) -> Index:
    """Which numbers of a node are pose, strain and acceleration."""
    return np.r_[0:12, 24 : 12 + half]


@np.errstate(over="ignore", invalid="ignore")
def interval_end(start: State, error: Array, intervals: Intervals) -> tuple[State, Array]:
    """The end (M,) of intervals that have this `error` [r; ṙ] (M, 24): `interval_error` undone.

    Also the slope (M, 12, 12) of where they end without an error.
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
    """Gain of a point's error on that of its interval, and what it leaves, (M, 12, 12) each."""
    near = intervals.before(offset).flow(start, noisy=True)
    there = State(start.pose @ near.pose, near.wrench, start.velocity)
    onward = intervals.beyond(offset).flow(there, noisy=True)
    cross = onward.transition @ near.noise
    whole = cross @ np.swapaxes(onward.transition, -1, -2) + onward.noise
    scale = 1.0 / np.sqrt(np.einsum("mii->mi", whole))
    even = scale[:, :, None] * whole * scale[:, None, :]
    gain = np.swapaxes(np.linalg.solve(even, scale[:, :, None] * cross), -1, -2) * scale[:, None, :]
    return gain, near.noise - gain @ cross


def interval_between(
    start: State, end: State, intervals: Intervals, offset: Array, gain: Array
) -> tuple[State, Array, Array]:
    """State inside intervals, with Jacobians (M, 24, dof) by both ends. Source: (27) and (10).

    Args:
        start: State (M,) with strain rate where the intervals begin.
        end: State (M,) where they end.
        intervals: The intervals.
        offset: Places (M,) inside them.
        gain: Gains (M, 12, 12) of the point's error on that of the interval.
    """
    places, gains = np.tile(offset, 3), np.tile(gain, (3, 1, 1))

    def linearize(a: State, b: State, every: Intervals) -> tuple[State, Array, Array]:
        return _still_between(a, b, every, places, gains)

    (at, j0, j1), change = _along_motion(linearize, start, end, intervals)
    rate = np.zeros((len(offset), 12))
    for node, slope in ((start, j0), (end, j1)):
        rate += (slope @ _motion(node)[:, :, None])[..., 0]
    jacobians = []
    for node, slope, changed in zip((start, end), (j0, j1), change, strict=True):
        jacobian = _rated(slope, changed, node.velocity)
        jacobian[:, 12:18, still_columns(slope.shape[2])] += se3.ad(rate[:, :6]) @ slope[:, :6]
        jacobians.append(jacobian)
    count = len(offset)
    return (
        State(at.pose[:count], at.strain[:count], rate[:, :6], rate[:, 6:]),
        jacobians[0],
        jacobians[1],
    )


def _still_between(
    start: State, end: State, intervals: Intervals, offset: Array, gain: Array
) -> tuple[State, Array, Array]:
    """Pose and strain inside intervals, Jacobians (M, 12, dof / 2) by those of both ends."""
    error, r0, r1 = still_error(start, end, intervals)
    intervals = intervals.accelerated(start, end)
    off = (gain @ error[:, :, None])[..., 0]
    ahead = intervals.before(offset).flow(start, noisy=False)
    bend = se3.exp(off[:, :6])
    pose, strain = start.pose @ ahead.pose @ bend, ahead.wrench + off[:, 6:]
    j0, j1, carried = gain @ r0, gain @ r1, ahead.transition
    turn, back = se3.right_jacobian(off[:, :6]), se3.adjoint(se3.inverse(bend))
    j0[:, :6], j1[:, :6] = turn @ j0[:, :6], turn @ j1[:, :6]
    straight = [(j0[:, :, :12], carried)]
    if start.inertia is not None:
        early, late = intervals.by_inertia(ahead.by_weight)
        straight += [(j0[:, :, 12:], early), (j1[:, :, 12:], late)]
    for jacobian, own in straight:
        jacobian[:, :6] += back @ own[:, :6]
        jacobian[:, 6:] += own[:, 6:]
    return State(pose, strain, np.zeros_like(strain)), j0, j1
