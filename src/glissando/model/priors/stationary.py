"""The base class of priors whose arclength intervals are stationary processes in time.

An interval's error r is a Gaussian process with covariance k(t−t') Q, k a Matérn-3/2 of unit
variance. Such priors differ in the definitions of r and Q. Source: equations (6) to (12).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from glissando._kernels import rolls
from glissando._kernels import stationary as kernels
from glissando._kernels.arrays import items, whole
from glissando.errors import OutsideGridError
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Cells, Grid, Index
from glissando.model.interpolation import Interpolation, Points
from glissando.model.noise import sqrt_information
from glissando.model.priors import matern
from glissando.model.priors.intervals import as_fields, at_nodes, kron_pair
from glissando.model.priors.rest_shape import RestShape
from glissando.model.state import DOF, State

_SAME = 1e-3  # relative tolerance of steps, for rounding, also of Unix times
_DENSEST = 200.0  # time nodes a time scale: beyond, rounding shows in the covariance


class StationaryPrior(Protocol):
    """A prior whose intervals are stationary processes in time, a base class of such priors.

    Attributes:
        time_scale: Time scale ℓ, s.
    """

    time_scale: float

    @property
    def rest(self) -> RestShape:
        """Expected shape of the undisturbed robot."""

    def arclength_bridge(
        self, grid: Grid, noise_state: State, k: Index, s: Cells
    ) -> tuple[Array, Array]:
        """Gain and covariance (M, 12, 12) inside the intervals `s` at time nodes k."""

    def between(
        self, grid: Grid, start: State, end: State, k: Index, s: Cells, gain: Array
    ) -> tuple[State, Array]:
        """State (M,) inside intervals `s` at times k, and Jacobian (M, 24, 2, dof) by both ends."""

    def sections(
        self, grid: Grid, noise_state: State, k: Index, n: Index, s: Cells, inside: bool
    ) -> list[tuple[float, Array]]:
        """Prior covariances (M, 12, 12) of pose and strain at time nodes k, on n or inside `s`.

        They add up; each comes with its correlation time in seconds, ℓ first.
        """

    @property
    def fixes_base(self) -> bool:
        """True: the base's pose has a stationary distribution of finite covariance."""
        return True

    def least_step(self, arclength: Array) -> float:
        """Least distance of time nodes, s, at which information stays numerically accurate."""
        return self.time_scale / _DENSEST * (1.0 - _SAME)

    def require_digits(self, grid: Grid) -> None:
        """Raise OutsideGridError if time nodes are so dense that information loses digits."""
        steps = np.diff(grid.time)
        if steps.size and np.median(steps) < self.least_step(grid.arclength):
            raise OutsideGridError(
                f"Time nodes {np.median(steps):.3g} s apart are too dense for a time scale of "
                f"{self.time_scale:g} s: they add nothing and cost all digits; leave "
                f"{self.time_scale / _DENSEST:.3g} s at least between them."
            )

    def interpolate(
        self, grid: Grid, state: State, noise_state: State, points: Points
    ) -> Interpolation:
        """State at points between the nodes, conditional on the nodes. Source: (10) to (12).

        Inside a cell: along arclength at both times, then along time. The bridge covariance is that
        of the whole process, Σ_s ⊗ P∞ + (K_s − Σ_s) ⊗ Σ_t with K_s the prior covariance of the
        cross-section, Σ_s and Σ_t the bridge covariances along arclength and along time.
        """
        s, t = points.along, points.through
        k = t.lower if points.inside_time else t.nearest
        n = s.lower if points.inside_arclength else s.nearest
        m, by_time, both = k.size, np.zeros((2, 2)), 1 + points.inside_time
        ends = np.concatenate([k, k + 1][:both])
        every = np.tile(np.arange(m), both)
        across = s.take(every)
        bridge = None
        if points.inside_arclength:
            bridge = self.arclength_bridge(grid, noise_state, ends, across)
        gain = None if bridge is None else bridge[0]
        at, nodes, jacobian = self._at_time_nodes(grid, state, ends, n[every], across, gain)
        if not points.inside_time:
            at, jacobian = replace(at, strain_rate=None), jacobian[:, :DOF]
            if bridge is None:  # on nodes
                return Interpolation(at, nodes, jacobian, np.zeros((m, DOF, DOF)))
        else:
            pose, strain, velocity, jacobian, by_time = kernels.between(
                self.time_scale, *as_fields(at, (2 * m,)), whole(t.step), whole(t.offset),
                whole(self.rest.at(points.arclength)), whole(jacobian),
            )  # fmt: skip
            at, nodes = State(pose, strain, velocity), np.hstack([nodes[:m], nodes[m:]])

        def bridge_covariance() -> Array:
            parts, along = [(self.time_scale, np.zeros((12, 12)))], np.zeros((12, 12))
            if points.inside_time:
                parts = self.sections(grid, noise_state, k, n, s, points.inside_arclength)
            if bridge is not None:
                early, late = bridge[1][:m], bridge[1][-m:]
                along = early + t.share[:, None, None] * (late - early)
            cov, through = np.zeros((m, DOF, DOF)), by_time
            for i, (scale, section) in enumerate(parts):
                if i:
                    along, through = np.zeros((12, 12)), matern.bridge(scale, t.step, t.offset)[2]
                cov += kernels.left_over(
                    scale, whole(at.velocity), items(through, (m,), 2, 2),
                    items(section, (m,), 12, 12), items(along, (m,), 12, 12),
                )  # fmt: skip
            return cov

        return Interpolation(at, nodes, jacobian, bridge_covariance)

    def _at_time_nodes(
        self, grid: Grid, state: State, k: Index, n: Index, s: Cells, gain: Array | None
    ) -> tuple[State, Index, Array]:
        """State, nodes (M, c) and Jacobian (M, 24, c, dof) at time nodes k.

        At the arclength nodes n or, with gains (M, 12, 12) of interval errors, inside `s`.
        """
        if gain is None:
            return at_nodes(state, k, n)
        nodes = (k * grid.arclength.size + n)[:, None] + np.arange(2)
        start, end = (state.flatten().take(nodes[:, i]) for i in (0, 1))
        at, jacobian = self.between(grid, start, end, k, s, gain)
        return at, nodes, jacobian


def longest_scale(grid: Grid) -> float:
    """Longest time scale, s, at which these time nodes are not too dense numerically."""
    steps = np.diff(grid.time)
    return _DENSEST * float(np.median(steps)) if steps.size else np.inf


def chain_factors(
    time_scale: float,
    first: bool,
    steps: Array,
    nodes: Index,
    error: Array,
    jacobian: Array,
    cov: Array,
    *,
    paired: bool = True,
    angle: Array | None = None,
) -> Iterator[Factors]:
    """Factors of I stationary processes over K times. Source: equation (8).

    Args:
        time_scale: Time scale of the processes, s.
        first: Whether the first time is the first of all.
        steps: Time steps (K−1,), s.
        nodes: Nodes (K, I, c) that each process depends on.
        error: Errors [r; ṙ] (K, I, 2 r).
        jacobian: Jacobians (K, I, 2 r, c, dof) of the errors by these nodes.
        cov: Covariances Q (K, I, r, r).
        paired: Whether the last six rows and columns of Q are diagonal.
        angle: Rolls (K, I), rad, of the processes' first nodes since Q was evaluated, by which
            errors are rotated back. Only if errors are in a body frame and Q is equal in x and y.
    """
    every, shape = slice(0, jacobian.shape[-1]), error.shape[:2]
    if first:
        root = np.diag(np.diagonal(matern.stationary(time_scale)) ** -0.5)
        initial, slopes = error[0].copy(), jacobian[0].copy()
        if angle is not None:
            rolls.turn_all_back(whole(angle[0]), initial, slopes)  # (35)
        whitener = kron_pair(root, sqrt_information(cov[0]))
        yield Factors(nodes[0], every, slopes, Residuals(initial, whitener))
    if not len(steps):
        return
    arrays = whole(steps), whole(error), whole(jacobian), items(cov, shape, *cov.shape[2:])
    arrays = *arrays[:3], arrays[3].reshape(cov.shape)
    innovation, slopes, info = kernels.chain(time_scale, *arrays, paired)
    if angle is not None:
        rolls.turn_all_back(angle[:-1].ravel(), innovation, slopes)
    joined = np.concatenate([nodes[:-1], nodes[1:]], axis=2).reshape(len(innovation), -1)
    yield Factors(joined, every, slopes, Residuals(innovation, info))
