"""A rod before any reading: equilibrium under its weight, and covariances of cross-sections."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from glissando._kernels import information as kernels
from glissando._kernels.arrays import whole
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.ends import RodEnds
from glissando.model.priors.mechanical.flow import Flow
from glissando.model.priors.mechanical.intervals import Intervals
from glissando.model.priors.mechanical.rod import LoadedRod
from glissando.model.priors.transitions import symmetrize
from glissando.model.state import State

_ITERATIONS = 50
_CLOSE = 1e-9  # of the wrench beyond the tip at the beginning of the iteration
_SHARES = (1.0, 0.25, 0.5, 0.75, 0.9, 1.0)  # of the weight, in steps where the whole at once fails
_WEIGHTS = ("weight", "weight_slope")


def hanging_rod(mechanics: Mechanics, every: Intervals, base: Array) -> tuple[Array, Array]:
    """Poses (S, N, 4, 4) and strains (S, N, 6) of rods in equilibrium with weight and tool.

    Newton's method finds the wrench at the base for which the wrench beyond the tip vanishes.

    Args:
        mechanics: The tool, and gravity (3,) or (S, 3).
        every: The intervals (S · (N−1),) of S rods.
        base: Poses (S, 4, 4) of their bases.

    Raises:
        GlissandoError: No equilibrium is found: the rod is too soft for its weight.
    """
    wrench = np.zeros((len(base), 6))
    for share in _SHARES:
        section = replace(every.section, **{f: share * getattr(every.section, f) for f in _WEIGHTS})
        lighter = replace(mechanics, gravity=share * mechanics.gravity)
        shape, balanced, sound = _newton(lighter, replace(every, section=section), base, wrench)
        if sound and share == 1.0:
            return shape
        wrench = balanced if sound else np.zeros_like(balanced)
    raise GlissandoError(
        "No shape is found in which the robot bears its own weight; check the stiffness, the mass "
        "and the gravity of [mechanics]."
    )


def _newton(
    mechanics: Mechanics, every: Intervals, base: Array, wrench: Array
) -> tuple[tuple[Array, Array], Array, bool]:
    """Poses and strains, base wrenches (S, 6) and whether they converged, from a first guess."""
    share = np.ones((len(base), 1))
    pose, strain, residual, slope = _shoot(mechanics, every, base, wrench)
    error = np.abs(residual).max(axis=1)
    close = _CLOSE * error + 1e-15 * np.abs(every.end_stiffness).max()
    for _ in range(_ITERATIONS):
        if np.all(error <= close):
            break
        step = np.linalg.solve(slope, -residual[..., None])[..., 0]
        tried = wrench + share * step * (error > close)[:, None]
        shot = _shoot(mechanics, every, base, tried)
        size = np.abs(shot[2]).max(axis=1)
        better = (size < error) | (error <= close)
        share = np.where(better[:, None], np.minimum(1.0, 2.0 * share), 0.25 * share)
        wrench = np.where(better[:, None], tried, wrench)
        old = pose, strain, residual, slope
        pose, strain, residual, slope = (
            _where(better, *pair) for pair in zip(shot, old, strict=True)
        )
        error = np.where(better, size, error)
    return (pose, strain), wrench, bool(np.all(error <= close))


def _where(which: NDArray[np.bool_], one: Array, other: Array) -> Array:
    """Rows of `one` where the mask `which` (S,) is set, else of `other`."""
    return np.where(which.reshape(-1, *(1,) * (one.ndim - 1)), one, other)


def _shoot(
    mechanics: Mechanics, every: Intervals, base: Array, wrench: Array
) -> tuple[Array, Array, Array, Array]:
    """Poses and strains along rods, wrenches (S, 6) beyond the tip, Jacobians by the bases'."""
    count = len(base)
    pieces = len(every.step) // count
    first = np.arange(count) * pieces
    section = every.section
    poses, strains = [base], [section.rest[first] + wrench / section.stiffness[first]]
    by_base = np.zeros((count, 12, 6))
    by_base[:, 6:] = np.eye(6) / section.stiffness[first, :, None]
    for n in range(pieces):
        start = State(poses[-1], strains[-1], np.zeros((count, 6)))
        ahead = every.take(first + n).flow(start, noisy=False)
        poses.append(poses[-1] @ ahead.pose)
        strains.append(ahead.wrench)
        by_base = ahead.transition @ by_base
    last = first + pieces - 1
    stiffness, rotation = every.end_stiffness[last], poses[-1][:, :3, :3]
    residual = stiffness * (strains[-1] - every.end_rest[last]) - mechanics.tip_wrench(rotation)
    slope = stiffness[:, :, None] * by_base[:, 6:]
    slope -= mechanics.tip_slope(rotation) @ by_base[:, 3:6]
    return np.stack(poses, axis=1), np.stack(strains, axis=1), residual, slope


@dataclass(frozen=True)
class LinearizedRod:
    """A rod linearised at nodes (K, N); flow and information are computed once.

    Attributes:
        arclength: The arclength nodes (N,), m.
        state: States (K, N) of the nodes.
        every: Intervals (K · (N−1),) between them.
        ends: Information (6, 6) of the base's pose and (K, 12, 12) of the tip's pose and strain.
    """

    arclength: Array
    state: State
    every: Intervals
    ends: tuple[Array, Array]

    @cached_property
    def flow(self) -> Flow:
        """Flow of undisturbed rods from the nodes, with process noise."""
        return self.every.flow(self.state.take(np.s_[:, :-1]).flatten(), noisy=True)

    @cached_property
    def noise(self) -> Array:
        """Covariance (K, N−1, 12, 12) of pose and strain where intervals end."""
        return self.flow.noise.reshape(len(self.state.strain), -1, 12, 12)

    @cached_property
    def information(self) -> tuple[Array, Array]:
        """Information (K, N, 12, 12) from the base, carried outwards, and from the tip, inwards."""
        base, onward = np.zeros((12, 12)), self.flow.transition.reshape(self.noise.shape)
        base[:6, :6] = self.ends[0]
        outwards, inwards = kernels.along_chain(
            base, whole(self.ends[1]), whole(onward), whole(self.noise)
        )
        return outwards, inwards

    def covariances(self, k: Index, n: Index, offset: Array | None) -> Array:
        """Prior covariance (M, 12, 12) of pose and strain of cross-sections.

        The information from the base and that from the tip add up.

        Args:
            k: Time nodes (M,).
            n: Arclength nodes (M,) at the cross-sections, or at the beginnings of their intervals.
            offset: Distances (M,) of the cross-sections beyond these nodes, m; None if on them.
        """
        outwards, inwards = self.information
        if offset is None:
            return _inverse(outwards[k, n] + inwards[k, n])
        piece = self.every.take(k * (self.arclength.size - 1) + n)
        begin = self.state.take((k, n))
        near = piece.before(offset).flow(begin, noisy=True)
        point = State(begin.pose @ near.pose, near.wrench, begin.velocity)
        far = piece.beyond(offset).flow(point, noisy=True)
        before = _forward(outwards[k, n], near.transition, near.noise)
        return _inverse(before + _backward(inwards[k, n + 1], far.transition, far.noise))


class LinearizedRods:
    """Linearisations of a rod with its ends; the last one is cached for the same nodes."""

    def __init__(self, rod: LoadedRod, ends: RodEnds) -> None:
        self._rod, self._ends = rod, ends
        self._last: LinearizedRod | None = None

    def at(self, grid: Grid, state: State) -> LinearizedRod:
        """Linearised rod at nodes (K, N), which is cached."""
        self._last = self._cached(grid, state) or self._linearized(grid, state)
        return self._last

    def covariances(
        self, grid: Grid, state: State, k: Index, n: Index, offset: Array | None
    ) -> Array:
        """Prior covariance (M, 12, 12) of pose and strain at time nodes k, on n or beyond."""
        rod = self._cached(grid, state)
        times, which = np.unique(k, return_inverse=True)
        if rod is None and 2 * times.size < len(state.strain):  # few of many time nodes
            rod, k = self._linearized(grid, state.take(times)), which
        return (rod or self.at(grid, state)).covariances(k, n, offset)

    def _linearized(self, grid: Grid, state: State) -> LinearizedRod:
        every = self._rod.tiled(grid, len(state.strain))
        return LinearizedRod(grid.arclength, state, every, self._ends.information(grid, state))

    def _cached(self, grid: Grid, state: State) -> LinearizedRod | None:
        last = self._last
        same = last and last.state is state and np.array_equal(last.arclength, grid.arclength)
        return last if same else None


def _forward(information: Array, onward: Array, noise: Array) -> Array:
    """Information (K, 12, 12) at the end of intervals, from that at their beginning."""
    back = np.linalg.inv(onward)
    return _with_noise(np.swapaxes(back, -1, -2) @ information @ back, noise)


def _backward(information: Array, onward: Array, noise: Array) -> Array:
    """Information (K, 12, 12) at the beginning of intervals, from that at their end."""
    return np.swapaxes(onward, -1, -2) @ _with_noise(information, noise) @ onward


def _with_noise(information: Array, noise: Array) -> Array:
    """Information (K, 12, 12) after noise is added: I − I (I + Q⁻¹)⁻¹ I, as (1 + I Q)⁻¹ I."""
    blurred = np.linalg.solve(np.eye(12) + information @ noise, information)
    return symmetrize(np.asarray(blurred, dtype=float))


def _inverse(information: Array) -> Array:
    """Covariance (M, 12, 12), inverted after scaling to a unit diagonal.

    For rods so wound up that rounding leaves no information it is not a number, and the solver
    takes a shorter step.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = 1.0 / np.sqrt(np.einsum("mii->mi", information))
    even = np.linalg.inv(scale[:, :, None] * information * scale[:, None, :])
    return scale[:, :, None] * even * scale[:, None, :]
