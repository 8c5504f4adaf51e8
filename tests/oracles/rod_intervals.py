"""What `_kernels.rod_intervals` computes in loops, by arrays over the intervals: (27), (32)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from glissando._kernels.rod_intervals import NUDGE
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.mechanics import Mechanics
from glissando.model.priors.intervals import RATED, strain_rate_of
from glissando.model.priors.mechanical.intervals import Intervals, still_columns
from glissando.model.state import POSE, STRAIN, STRAIN_RATE, State, concatenate

V = TypeVar("V")


def _by_inertia(every: Intervals, by_weight: Array) -> tuple[Array, Array]:
    """Slopes (M, 12, 3) by the acceleration of both ends, from those by the weight."""
    late = -every.mass[:, None, None] * by_weight[:, :, 3:] / every.step[:, None, None]
    return -every.mass[:, None, None] * by_weight[:, :, :3] - late, late


@np.errstate(over="ignore", invalid="ignore")
def _still_error(start: State, end: State, intervals: Intervals) -> tuple[Array, Array, Array]:
    """Error r (M, 12) of intervals and Jacobians by pose and strain of both ends.

    The Jacobians are (M, 12, 12), or (M, 12, 15) and by the acceleration, too.
    """
    intervals = intervals.accelerated(start, end)
    ahead = intervals.flow(start, noisy=False)
    xi = se3.log(se3.inverse(start.pose @ ahead.pose) @ end.pose)
    error = np.concatenate([xi, end.strain - ahead.wrench], axis=-1)
    j0, j1 = -ahead.transition, np.zeros((len(xi), 12, 12))
    if start.inertia is not None:
        early, late = _by_inertia(intervals, ahead.by_weight)
        j0, j1 = np.concatenate([j0, -early], axis=2), np.concatenate([j1, -late], axis=2)
    back = se3.right_jacobian_inverse(-xi)
    j0[:, :6], j1[:, :6] = back @ j0[:, :6], back @ j1[:, :6]
    j1[:, :6, :6], j1[:, 6:, 6:12] = se3.right_jacobian_inverse(xi), np.eye(6)
    return error, j0, j1


def still_error(start: State, end: State, intervals: Intervals) -> tuple[Array, Array]:
    """What `model.priors.mechanical.intervals.still_error` returns."""
    error, *slopes = _still_error(start, end, intervals)
    return error, np.stack(slopes, axis=2)


@np.errstate(over="ignore", invalid="ignore")
def interval_error(start: State, end: State, intervals: Intervals) -> tuple[Array, Array]:
    """What `model.priors.mechanical.intervals.interval_error` returns."""
    (error, *slopes), change = _along_motion(_still_error, start, end, intervals)
    error = error[: len(intervals.step)]
    rate, jacobians = np.zeros_like(error), []
    for at, slope, changed in zip((start, end), slopes, change, strict=True):
        rate += (slope @ _motion(at)[:, :, None])[..., 0]
        jacobians.append(_rated(slope, changed, at.velocity))
    return np.concatenate([error, rate], axis=-1), np.stack(jacobians, axis=2)


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
    nudge = NUDGE / (NUDGE + speed)
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


def interval_between(
    start: State, end: State, intervals: Intervals, offset: Array, gain: Array
) -> tuple[State, Array]:
    """What `model.priors.mechanical.intervals.interval_between` returns."""
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
        np.stack(jacobians, axis=2),
    )


def _still_between(
    start: State, end: State, intervals: Intervals, offset: Array, gain: Array
) -> tuple[State, Array, Array]:
    """Pose and strain inside intervals, Jacobians (M, 12, dof / 2) by those of both ends."""
    error, r0, r1 = _still_error(start, end, intervals)
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
        early, late = _by_inertia(intervals, ahead.by_weight)
        straight += [(j0[:, :, 12:], early), (j1[:, :, 12:], late)]
    for jacobian, own in straight:
        jacobian[:, :6] += back @ own[:, :6]
        jacobian[:, 6:] += own[:, 6:]
    return State(pose, strain, np.zeros_like(strain)), j0, j1


def tip_error(mechanics: Mechanics, rest: Array, at: State) -> tuple[Array, Array]:
    """What `model.priors.mechanical.tip.tip_error` returns."""
    stiffness = mechanics.stiffness[-1]
    rotation, turning = at.pose[..., :3, :3], at.velocity[..., 3:]
    by_turn = mechanics.tip_slope(rotation)
    error = np.zeros((*turning.shape[:-1], 12))
    error[..., :6] = stiffness * (at.strain - rest) - mechanics.tip_wrench(rotation)
    error[..., 6:] = stiffness * strain_rate_of(at)
    error[..., 6:] -= np.einsum("...ij,...j->...i", by_turn, turning)
    jacobian = np.zeros((*turning.shape[:-1], 12, RATED))
    jacobian[..., :6, 3:6] = jacobian[..., 6:, 15:18] = -by_turn
    jacobian[..., :6, STRAIN] = jacobian[..., 6:, STRAIN_RATE] = np.diag(stiffness)
    lever, spin = se3.hat3(mechanics.tip_center), se3.hat3(turning) @ by_turn[..., :3, :]
    jacobian[..., 6:9, 3:6], jacobian[..., 9:, 3:6] = spin, lever @ spin
    return error, jacobian
