"""What priors share whose arclength intervals are stationary processes in time.

An interval's error r is a Gaussian process with covariance k(t−t') Q, k a Matérn-3/2 of unit
variance. Such priors differ in what r is and in Q. Source: equations (6) to (12).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from glissando.errors import OutsideGridError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Cells, Grid, Index
from glissando.model.interpolation import Interpolation, Points, chained
from glissando.model.noise import pair_sqrt_information, sqrt_information
from glissando.model.priors import matern
from glissando.model.priors.intervals import RATED, kron_pair, strain_rate_of
from glissando.model.priors.steps import TIME, pair_between
from glissando.model.state import DOF, POSE, STRAIN, STRAIN_RATE, VELOCITY, State

_DENSEST = 200.0  # time nodes a time scale: beyond, rounding shows in the covariance


class StationaryPrior(Protocol):
    """A prior whose intervals are stationary processes in time, as interpolation needs it."""

    @property
    def time_scale(self) -> float:
        """Time scale ℓ, s."""
        ...

    def crossing(self, grid: Grid, noise_state: State, k: Index, s: Cells) -> tuple[Array, Array]:
        """Gain and covariance (M, 12, 12) inside the intervals `s` at time nodes k."""
        ...

    def at_time_nodes(
        self, grid: Grid, state: State, k: Index, n: Index, s: Cells, gain: Array | None
    ) -> tuple[State, Index, Array]:
        """State, nodes (M, c) and Jacobian (M, 24, c, dof) at time nodes k, on n or inside `s`."""
        ...

    def mean_strain(self, arclength: Array) -> Array:
        """The strain (M, 6) that is expected at arclengths (M,)."""
        ...

    def section(
        self, grid: Grid, noise_state: State, k: Index, n: Index, s: Cells, inside: bool
    ) -> Array:
        """Prior covariance (M, 12, 12) of pose and strain at time nodes k, on n or inside `s`."""
        ...


def require_digits(grid: Grid, time_scale: float) -> None:
    """Raise OutsideGridError where time nodes are so dense that information loses digits."""
    steps = np.diff(grid.time)
    if longest_scale(grid) < time_scale:
        raise OutsideGridError(
            f"Time nodes {np.median(steps):.3g} s apart are too dense for a time scale of "
            f"{time_scale:g} s: they add nothing and cost all digits; leave "
            f"{time_scale / _DENSEST:.3g} s at least between them."
        )


def longest_scale(grid: Grid) -> float:
    """The longest time scale, s, that information on these time nodes has digits for."""
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
) -> Iterator[Factors]:
    """Factors of I processes over K times. Source: equation (8).

    Args:
        time_scale: Time scale of the processes, s.
        first: Whether the first time is the first of all.
        steps: Between times (K−1,), s.
        nodes: Nodes (K, I, c) that each process depends on.
        error: Errors [r; ṙ] (K, I, 2 r).
        jacobian: Their Jacobians (K, I, 2 r, c, dof).
        cov: Covariances Q (K, I, r, r).
        paired: Whether the last six rows and columns of Q are diagonal.
    """
    whitener = pair_sqrt_information if paired else sqrt_information
    count, rows, dof = nodes.shape[2], error.shape[-1], jacobian.shape[-1]
    every = slice(0, dof)
    if first:
        root = np.diag(np.diagonal(matern.stationary(time_scale)) ** -0.5)
        terms = Residuals(error[0], kron_pair(root, whitener(cov[0])))
        yield Factors(nodes[0], every, jacobian[0], terms)
    if not len(steps):
        return
    fade = matern.transition(time_scale, steps)[:, None]
    root = np.linalg.inv(np.linalg.cholesky(matern.process_covariance(time_scale, steps)))
    before = error[:-1].reshape(*error[:-1].shape[:2], 2, rows // 2)
    slopes = jacobian[:-1].reshape(*before.shape, count * dof)
    innovation = error[1:] - (fade @ before).reshape(error[1:].shape)
    fading = fade @ slopes.reshape(*before.shape[:3], -1)
    both = np.empty((*innovation.shape, 2 * count, dof))
    both[..., :count, :] = -fading.reshape(both[..., :count, :].shape)
    both[..., count:, :] = jacobian[1:]
    joined = np.concatenate([nodes[:-1], nodes[1:]], axis=2)
    info = kron_pair(root[:, None], whitener(0.5 * (cov[:-1] + cov[1:])))
    terms = Residuals(innovation.reshape(-1, rows), info.reshape(-1, rows, rows))
    shape = -1, rows, 2 * count, dof
    yield Factors(joined.reshape(-1, 2 * count), every, both.reshape(shape), terms)


def interpolate_process(
    prior: StationaryPrior, grid: Grid, state: State, noise_state: State, points: Points
) -> Interpolation:
    """State at points between the nodes, conditional on the nodes. Source: (10) to (12).

    Inside a cell: along arclength at both times, then along time. What is left uncertain is that
    of the whole process, Σ_s ⊗ P∞ + (K_s − Σ_s) ⊗ Σ_t with K_s the prior covariance of the
    cross-section, Σ_s and Σ_t what the bridges along arclength and along time leave.
    """
    s, t = points.along, points.through
    k = t.lower if points.inside_time else t.nearest
    n = s.lower if points.inside_arclength else s.nearest
    crossing = prior.crossing(grid, noise_state, k, s) if points.inside_arclength else None
    gain = None if crossing is None else crossing[0]
    if not points.inside_time:
        at, nodes, jacobian = prior.at_time_nodes(grid, state, k, n, s, gain)
        at, jacobian, time_left = replace(at, strain_rate=None), jacobian[:, :DOF], None
    else:
        early, late = (prior.at_time_nodes(grid, state, k + i, n, s, gain) for i in (0, 1))
        rest = prior.mean_strain(points.arclength)
        at, j0, j1, time_left = _along_time(prior.time_scale, early[0], late[0], t, rest)
        jacobian = np.concatenate([chained(j0, early[2]), chained(j1, late[2])], axis=2)
        nodes = np.concatenate([early[1], late[1]], axis=1)
    if crossing is None and time_left is None:  # on nodes
        return Interpolation(at, nodes, jacobian, np.zeros((k.size, DOF, DOF)))
    left = np.zeros((k.size, RATED, RATED))
    if crossing is not None:
        left += kron_pair(matern.stationary(prior.time_scale), crossing[1])
    if time_left is not None:
        section = prior.section(grid, noise_state, k, n, s, points.inside_arclength)
        known = section if crossing is None else section - crossing[1]
        left += kron_pair(time_left, known)
    return Interpolation(at, nodes, jacobian, _in_body(at, left[:, :DOF, :DOF]))


def _along_time(
    time_scale: float, early: State, late: State, t: Cells, rest: Array
) -> tuple[State, Array, Array, Array]:
    """State (M,) within time steps, its Jacobians (M, 18, 24) at both ends, and Σ_t."""
    fading, rising, left = matern.bridge(time_scale, t.step, t.offset)
    gain = np.einsum("mij,ab->miajb", rising, np.eye(6)).reshape(-1, 12, 12)
    pose, velocity, j0, j1 = pair_between(TIME, early, late, t.step, t.offset, gain)
    strain = rest
    for end, weights, j in ((early, fading, j0), (late, rising, j1)):
        strain = strain + weights[:, 0, :1] * (end.strain - rest)
        strain = strain + weights[:, 0, 1:] * strain_rate_of(end)
        j[:, STRAIN, STRAIN] = weights[:, 0, 0, None, None] * np.eye(6)
        j[:, STRAIN, STRAIN_RATE] = weights[:, 0, 1, None, None] * np.eye(6)
    return State(pose, strain, velocity), j0, j1, left


def _in_body(at: State, left: Array) -> Array:
    """Covariance (M, 18, 18) of the body's velocity from that of the pose's rate, in place."""
    curl = se3.ad(at.velocity)
    left[..., VELOCITY, :] += curl @ left[..., POSE, :]
    left[..., VELOCITY] += left[..., POSE] @ np.swapaxes(curl, -1, -2)
    return left
