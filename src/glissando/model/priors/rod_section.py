"""A rod before any reading: how it hangs under its weight, and how sure its cross-sections are."""

from __future__ import annotations

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.mechanics import Mechanics
from glissando.model.priors.rod_intervals import Intervals
from glissando.model.priors.transitions import symmetrize
from glissando.model.state import State

_ITERATIONS = 50
_CLOSE = 1e-9  # of the wrench that the unbent rod leaves at the tip


def hanging_rod(mechanics: Mechanics, intervals: Intervals, base: Array) -> tuple[Array, Array]:
    """Poses (N, 4, 4) and strains (N, 6) at nodes of a rod that bears its weight and its tool.

    Newton's method finds the wrench at the base for which nothing is left beyond the tip.

    Raises:
        GlissandoError: No such shape is found: the rod is too soft for its weight.
    """

    def shoot(wrench: Array) -> tuple[Array, Array, Array, Array]:
        return _shoot(mechanics, intervals, base, wrench)

    wrench = np.zeros(6)
    pose, strain, left, slope = shoot(wrench)
    scale = np.abs(left).max() + 1e-6 * np.abs(intervals.end_stiffness).max() * 1e-6
    for _ in range(_ITERATIONS):
        if np.abs(left).max() <= _CLOSE * scale:
            return pose, strain
        step, share = np.linalg.solve(slope, -left), 1.0
        while share > 1e-3:
            found = shoot(wrench + share * step)
            if np.abs(found[2]).max() < (1.0 - 0.1 * share) * np.abs(left).max():
                break
            share *= 0.5
        wrench = wrench + share * step
        pose, strain, left, slope = found
    raise GlissandoError(
        "No shape is found in which the robot bears its own weight; check the stiffness, the mass "
        "and the gravity of [mechanics]."
    )


def _shoot(
    mechanics: Mechanics, intervals: Intervals, base: Array, wrench: Array
) -> tuple[Array, Array, Array, Array]:
    """Poses and strains along the rod, wrench (6,) left beyond the tip, its slope by the base's."""
    section = intervals.section
    stiffness, rest = section.stiffness[0], section.rest[0]
    poses, strains = [base], [rest + wrench / stiffness]
    by_base = np.zeros((12, 6))
    by_base[6:] = np.diag(1.0 / stiffness)
    for n in range(len(intervals.step)):
        start = State(poses[-1][None], strains[-1][None], np.zeros((1, 6)))
        ahead = intervals.take(np.array([n])).flow(start, noisy=False)
        poses.append(poses[-1] @ ahead.pose[0])
        strains.append(ahead.wrench[0])
        by_base = ahead.transition[0] @ by_base
    stiffness, rest = intervals.end_stiffness[-1], intervals.end_rest[-1]
    rotation = poses[-1][:3, :3]
    left = stiffness * (strains[-1] - rest) - mechanics.tip_wrench(rotation)
    slope = stiffness[:, None] * by_base[6:]
    for i in range(3):  # the tool's weight turns with the tip
        turn = np.zeros((3, 3))
        j, k = (i + 1) % 3, (i + 2) % 3
        turn[k, j], turn[j, k] = 1.0, -1.0
        slope -= np.outer(mechanics.tip_wrench(rotation @ turn), by_base[3 + i])
    return np.array(poses), np.array(strains), left, slope


def section_covariances(
    there: State,
    every: Intervals,
    ends: tuple[Array, Array],
    which: np.ndarray,
    n: np.ndarray,
    offset: Array | None,
) -> Array:
    """Prior covariance (M, 12, 12) of pose and strain of cross-sections.

    What the base says is carried outwards and what the tip says inwards; both add.

    Args:
        there: Nodes (K, N) to linearise at.
        every: Intervals (K · (N−1),) between them.
        ends: Information (6, 6) of the base's pose and (K, 12, 12) of the tip's pose and strain.
        which: Times (M,), rows of `there`.
        n: Nodes (M,), or those where the intervals of the cross-sections begin.
        offset: Places (M,) of the cross-sections beyond those nodes.
    """
    k_count, n_count = there.strain.shape[:2]
    start = there.take(np.s_[:, :-1]).flatten()
    found = every.flow(start, noisy=True)
    shape = (k_count, n_count - 1, 12, 12)
    onward, noise = found.transition.reshape(shape), found.noise.reshape(shape)
    outwards, inwards = np.zeros((2, k_count, n_count, 12, 12))
    outwards[:, 0, :6, :6], inwards[:, -1] = ends
    for i in range(n_count - 1):
        outwards[:, i + 1] = _carried(outwards[:, i], onward[:, i], noise[:, i])
        j = n_count - 2 - i
        inwards[:, j] = _returned(inwards[:, j + 1], onward[:, j], noise[:, j])
    if offset is None:
        return _inverse(outwards[which, n] + inwards[which, n])
    piece = every.take(which * (n_count - 1) + n)
    begin = there.take((which, n))
    near = piece.before(offset).flow(begin, noisy=True)
    point = State(begin.pose @ near.pose, near.wrench, begin.velocity)
    far = piece.beyond(offset).flow(point, noisy=True)
    before = _carried(outwards[which, n], near.transition, near.noise)
    return _inverse(before + _returned(inwards[which, n + 1], far.transition, far.noise))


def _carried(information: Array, onward: Array, noise: Array) -> Array:
    """Information (K, 12, 12) at the end of intervals, from that at their beginning."""
    back = np.linalg.inv(onward)
    return _blurred(np.swapaxes(back, -1, -2) @ information @ back, noise)


def _returned(information: Array, onward: Array, noise: Array) -> Array:
    """Information (K, 12, 12) at the beginning of intervals, from that at their end."""
    return np.swapaxes(onward, -1, -2) @ _blurred(information, noise) @ onward


def _blurred(information: Array, noise: Array) -> Array:
    """Information (K, 12, 12) after noise is added: I − I (I + Q⁻¹)⁻¹ I, as (1 + I Q)⁻¹ I."""
    found = np.linalg.solve(np.eye(12) + information @ noise, information)
    return symmetrize(np.asarray(found, dtype=float))


def _inverse(information: Array) -> Array:
    """Covariance (M, 12, 12), by numbers of one size."""
    scale = 1.0 / np.sqrt(np.einsum("mii->mi", information))
    even = np.linalg.inv(scale[:, :, None] * information * scale[:, None, :])
    return scale[:, :, None] * even * scale[:, None, :]
