"""The kinematic space-time prior: white noise on the rates, exact transitions between nodes.

White noise drives ∂ϖ/∂t, ∂ε/∂s and ∂ε/∂t (equations 3 to 5). Its strengths are densities over
arclength AND time: a node's factor is weighted by the span the node stands for, so that refining
the grid does not repeat the prior as if it were news.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from glissando import se3
from glissando.grid import Grid, Index
from glissando.linear import Factors, Residuals
from glissando.noise import pair_sqrt_information, sqrt_information
from glissando.se3 import Array
from glissando.state import DOF, POSE, STRAIN, VELOCITY, State, rest_state
from glissando.steps import ARCLENGTH, TIME, Direction, carried_error, pair_error
from glissando.transitions import Bridge, bridge, process_covariances

_POSE_STRAIN, _ALL = slice(0, 12), slice(0, DOF)
STRAIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


_SOFT = 0.022**2  # m², of strain density over curvature density
_STIFF = 10.0  # times softer than a prior must be to be worth a start of its own


def _soften(psd: Array) -> Array:
    """A strain density (6,) whose linear part is large enough beside its bending part."""
    return np.concatenate([np.maximum(psd[:3], _SOFT * np.mean(psd[3:5])), psd[3:]])


@dataclass(frozen=True)
class BaseDensity:
    """How firmly pose, strain and velocity are known at s = 0; each (6,), variance · second.

    A time node that stands for Δt seconds knows its base with covariance density / Δt. With a
    single time node (a static shape) Δt counts as one second, so these are plain variances.
    """

    pose: Array
    strain: Array
    velocity: Array


@dataclass(frozen=True)
class KinematicPrior:
    """Gaussian prior on pose, strain and velocity over arclength × time.

    Densities are (6,), [linear, angular], of white noise over arclength and time:
    `psd_strain_arclength` on ∂ε/∂s and `psd_velocity_arclength` on ∂ϖ/∂s (weighted by time spans),
    `psd_velocity_time` on ∂ϖ/∂t and `psd_strain_time` on ∂ε/∂t (weighted by arclength spans).
    `rest_strain` (6,) and `base_pose` (4, 4) are where the robot rests and stands; `base` says how
    firmly, and may be None when readings fix the base. Source: equations (2'), (3'), (4), (5).
    """

    psd_velocity_time: Array
    psd_strain_arclength: Array
    psd_strain_time: Array
    psd_velocity_arclength: Array
    base: BaseDensity | None
    rest_strain: Array = field(default_factory=STRAIGHT.copy)
    base_pose: Array = field(default_factory=lambda: np.eye(4))

    def softened(self) -> KinematicPrior:
        """The prior with shear and extension as soft as bending over 2 cm, or itself if not far.

        Its estimates bend easily, which makes them a start for the stiffer one.
        """
        names = ("psd_strain_arclength", "psd_strain_time")
        soft = {name: _soften(getattr(self, name)) for name in names}
        base = self.base
        if base is not None:
            base = replace(base, strain=_soften(base.strain))
        if all(np.all(soft[name] <= _STIFF * getattr(self, name)) for name in names):
            return self
        return replace(self, **soft, base=base)

    def rest_state(self, grid: Grid) -> State:
        """The robot at rest on the grid, from which an estimate starts."""
        return rest_state(grid, self.base_pose, self.rest_strain)

    def densities(self, direction: Direction) -> tuple[Array, Array]:
        """Densities (6,) of the field that moves the pose along a direction, and of the other."""
        if direction is ARCLENGTH:
            return self.psd_strain_arclength, self.psd_velocity_arclength
        return self.psd_velocity_time, self.psd_strain_time

    def bridge(self, direction: Direction, rate: Array, cell: tuple[Array, Array, Array]) -> Bridge:
        """Bridge into intervals with `cell` = (step, offset, span of the other direction), (M,)."""
        step, offset, span = cell
        psd, carried = self.densities(direction)
        return bridge(
            rate, step, offset, psd / span[:, None], carried / span[:, None], rigid=direction.rigid
        )

    def factors(self, grid: Grid, state: State, about: State, times: slice) -> Iterator[Factors]:
        """Prior factors that begin at the time nodes `times`, linearised at `state`.

        Along arclength at each of those times, along time to the next, and at the base. Their
        weights come from the rates of `about`, a state on the same grid.
        """
        k_count, n_count = grid.shape
        node = np.arange(k_count * n_count).reshape(k_count, n_count)
        here, flat, about = node[times], state.flatten(), about.flatten()
        if n_count > 1:
            ends = (here[:, :-1].ravel(), here[:, 1:].ravel())
            step = np.broadcast_to(np.diff(grid.arclength), (len(here), n_count - 1)).ravel()
            span = np.repeat(grid.time_spans[times], n_count - 1)
            yield from self._along(ARCLENGTH, flat, about, ends, step, span)
        if k_count > 1 and times.start < k_count - 1:
            starts = node[:-1][times]
            ends = (starts.ravel(), starts.ravel() + n_count)
            step = np.repeat(np.diff(grid.time)[times], n_count)
            span = np.broadcast_to(grid.arclength_spans, starts.shape).ravel()
            yield from self._along(TIME, flat, about, ends, step, span)
        if self.base is not None:
            yield self._base(grid.time_spans[times], flat, here[:, :1])

    def _along(
        self,
        direction: Direction,
        flat: State,
        about: State,
        ends: tuple[Index, Index],
        step: Array,
        span: Array,
    ) -> Iterator[Factors]:
        start, end = flat.take(ends[0]), flat.take(ends[1])
        rates = direction.rate_of(about)
        middle = 0.5 * (rates[ends[0]] + rates[ends[1]])
        cov, carried_cov = process_covariances(
            middle, step, *self.densities(direction), rigid=direction.rigid
        )
        nodes, weight = np.stack(ends, axis=1), np.sqrt(span)[:, None, None]
        pair_dofs = _POSE_STRAIN if direction is ARCLENGTH else _ALL
        carried_dofs = _ALL if direction.rigid else STRAIN
        pair, carried = pair_sqrt_information(cov), sqrt_information(carried_cov)
        for (error, j0, j1), dofs, whitener in (
            (pair_error(direction, start, end, step), pair_dofs, pair),
            (carried_error(direction, start, end), carried_dofs, carried),
        ):
            jacobian = np.stack([j0[..., dofs], j1[..., dofs]], axis=2)
            yield Factors(nodes, dofs, jacobian, Residuals(error, weight * whitener))

    def _base(self, spans: Array, flat: State, nodes: Index) -> Factors:
        assert self.base is not None
        state = flat.take(nodes[:, 0])
        xi = se3.log(se3.inverse(self.base_pose) @ state.pose)
        residual = np.concatenate([xi, state.strain - self.rest_strain, state.velocity], axis=-1)
        jacobian = np.zeros((nodes.size, DOF, 1, DOF))
        jacobian[:, POSE, 0, POSE] = se3.right_jacobian_inverse(xi)
        jacobian[:, STRAIN, 0, STRAIN] = jacobian[:, VELOCITY, 0, VELOCITY] = np.eye(6)
        density = np.concatenate([self.base.pose, self.base.strain, self.base.velocity])
        info = np.sqrt(spans)[:, None, None] * np.diag(1.0 / np.sqrt(density))
        return Factors(nodes, _ALL, jacobian, Residuals(residual, info))
