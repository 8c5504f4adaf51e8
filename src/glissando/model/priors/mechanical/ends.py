"""The ends of a rod: a base of uncertain pose, and a tip at which an unknown wrench acts.

Source: equations (26) and (27).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid, Index
from glissando.model.priors.intervals import place_error
from glissando.model.priors.mechanical.rod import LoadedRod
from glissando.model.priors.static import STATIC_DOF
from glissando.model.priors.stationary import chain_factors
from glissando.model.state import State

_STATIC = slice(0, STATIC_DOF)
_POSE_ROWS = np.r_[0:6, 12:18]


@dataclass(frozen=True)
class RodEnds:
    """Prior of a rod's ends.

    Attributes:
        rod: The rod.
        base_pose: Mean pose (4, 4) of the base.
        var_base: Variance (6,) of the base's pose.
        var_tip: Variance (6,) of the unknown wrench at the tip, N² and N² m².
    """

    rod: LoadedRod
    base_pose: Array
    var_base: Array
    var_tip: Array

    def factors(
        self, chain: tuple[float, bool, Array], grid: Grid, state: State, node: Index
    ) -> Iterator[Factors]:
        """Factors of the base, then of the tip, over successive time nodes.

        Args:
            chain: Time scale, whether the first time node is the first of all, time steps (K−1,).
            grid: Grid of the nodes.
            state: States (K, N) of the nodes.
            node: Indices (K, N) of the nodes.
        """
        at = replace(state.take(np.s_[:, :1]), inertia=None)
        error, slope = place_error(self.base_pose, at.strain[0, 0], at)
        error, slope = error[..., _POSE_ROWS], _zero_padded(slope[..., _POSE_ROWS, :], state.dof)
        cov = np.broadcast_to(np.diag(self.var_base), (len(node), 1, 6, 6))
        yield from chain_factors(*chain, node[:, :1, None], error, slope, cov, paired=False)
        error, slope = self.rod.tip_error(grid, state.take(np.s_[:, -1:]))
        cov = np.broadcast_to(np.diag(self.var_tip), (len(node), 1, 6, 6))
        slope = _zero_padded(slope, state.dof)
        yield from chain_factors(*chain, node[:, -1:, None], error, slope, cov, paired=False)

    def static_factors(self, grid: Grid, state: State, node: Index) -> Iterator[Factors]:
        """Factors of the base, then of the tip, of static shapes with nodes (S, N)."""
        at, count = state.take(np.s_[:, 0]), len(node)
        xi = se3.log(se3.inverse(self.base_pose) @ at.pose)
        jacobian = np.zeros((count, 6, 1, STATIC_DOF))
        jacobian[:, :, 0, :6] = se3.right_jacobian_inverse(xi)
        yield Factors(
            node[:, :1], _STATIC, jacobian, Residuals(xi, _whitener(self.var_base, count))
        )
        error, slope = self.rod.tip_error(grid, state.take(np.s_[:, -1]))
        terms = Residuals(error[:, :6], _whitener(self.var_tip, count))
        yield Factors(node[:, -1:], _STATIC, slope[:, :6, None, _STATIC], terms)

    def information(self, grid: Grid, state: State) -> tuple[Array, Array]:
        """Information (6, 6) of the base's pose, and (K, 12, 12) of the tip's pose and strain."""
        tip = self.rod.tip_error(grid, state.take(np.s_[:, -1]))[1][:, :6, _STATIC]
        return np.diag(1.0 / self.var_base), tip.mT @ (tip / self.var_tip[:, None])


def _zero_padded(slope: Array, dof: int) -> Array:
    """Jacobians (…, r, 1, dof) by a node, from those (…, r, d) by its first d components."""
    none = np.zeros((*slope.shape[:-1], dof - slope.shape[-1]))
    return np.concatenate([slope, none], axis=-1)[..., None, :]


def _whitener(variance: Array, count: int) -> Array:
    """Square-root information (count, 6, 6) of one variance (6,)."""
    return np.broadcast_to(np.diag(variance**-0.5), (count, 6, 6))
