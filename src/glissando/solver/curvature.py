"""Terms that Gauss–Newton omits from the Hessian: residuals times their second derivatives.

Where equilibrium constrains neighbouring cross-sections almost exactly, residuals are tiny and
their weights huge; the products, multipliers of the constraints, are as large as loads. Without
these terms the covariance of a wrench falls below its Cramér–Rao bound wherever a rotation of the
rod is uncertain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from glissando.errors import UnobservableError
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.priors.static import STATIC_DOF
from glissando.model.state import State
from glissando.solver.block_tridiagonal import BlockTridiagonal, factor
from glissando.solver.static_equations import StaticEquations

_NUDGE = 1e-3  # standard deviations: step of the finite differences

Linearize = Callable[[State], Iterator[Factors]]
"""Factors of static shapes, always in the same order, at a state (S, N)."""


def curvature(linearize: Linearize, state: State, step: Array, std: Array) -> BlockTridiagonal:
    """Σ λᵢ ∂²eᵢ over all factors, by finite differences of their gradients λᵀJ.

    Every second node is perturbed at a time, so that only one node of each factor moves. Source:
    equation (31).

    Args:
        linearize: Computes the factors.
        state: Nodes (S, N) near the minimum.
        step: Gauss–Newton step (S, N, 12) there, after which the multipliers are evaluated.
        std: Standard deviations (S, N, 12) of the nodes, which scale the differences.
    """
    count, n_count = state.strain.shape[:2]
    diagonal = np.zeros((count * n_count, STATIC_DOF, STATIC_DOF))
    lower = np.zeros((count * n_count - 1, STATIC_DOF, STATIC_DOF))
    scale, step = _NUDGE * std.reshape(-1, STATIC_DOF), step.reshape(-1, STATIC_DOF)
    batches = list(linearize(state))
    multipliers = [_multiplier(batch, step) for batch in batches]
    gradients = [_gradient(*pair) for pair in zip(batches, multipliers, strict=True)]
    for parity, column in np.ndindex(2, STATIC_DOF):
        nudge = np.zeros((count, n_count, state.dof))
        nudge[:, parity::2, column] = scale.reshape(std.shape)[:, parity::2, column]
        nudged = linearize(state.retract(nudge))
        for batch, multiplier, before in zip(nudged, multipliers, gradients, strict=True):
            change = _gradient(batch, multiplier) - before
            for j, moved in enumerate(batch.nodes.T):
                hit = np.flatnonzero(moved % n_count % 2 == parity)
                for i, touched in enumerate(batch.nodes[hit].T):
                    slope = change[hit, i] / scale[moved[hit], column, None]
                    if i == j:
                        np.add.at(diagonal[:, :, column], touched, slope)
                    elif i > j:
                        np.add.at(lower[:, :, column], moved[hit], 0.5 * slope)
                    else:
                        np.add.at(lower[:, column], touched, 0.5 * slope)
    return BlockTridiagonal(0.5 * (diagonal + np.swapaxes(diagonal, 1, 2)), lower)


def with_curvature(here: StaticEquations, added: BlockTridiagonal) -> BlockTridiagonal:
    """Hessian of every shape where it is positive definite, else Gauss–Newton's approximation."""
    n_count = here.rhs.shape[1]
    diagonal, lower = here.system.diagonal + added.diagonal, here.system.lower + added.lower
    for first in range(0, len(diagonal), n_count):
        slabs = np.s_[first : first + n_count]
        between = np.s_[first : first + n_count - 1]
        try:
            factor(BlockTridiagonal(diagonal[slabs], lower[between]))
        except UnobservableError:
            diagonal[slabs] = here.system.diagonal[slabs]
            lower[between] = here.system.lower[between]
    return BlockTridiagonal(diagonal, lower)


def _multiplier(batch: Factors, step: Array) -> Array:
    """Weighted linearised residuals (M, r) after a step of all nodes."""
    jacobian = batch.jacobian[..., :STATIC_DOF]
    residual = batch.terms.residual + np.einsum("mrcd,mcd->mr", jacobian, step[batch.nodes])
    weighted = np.einsum("mji,mj->mi", batch.terms.sqrt_info, batch.terms.whiten(residual))
    return weighted * batch.terms.robust_weights()[:, None]


def _gradient(batch: Factors, multiplier: Array) -> Array:
    """Multipliers times Jacobians (M, c, 12)."""
    return np.einsum("mrcd,mr->mcd", batch.jacobian[..., :STATIC_DOF], multiplier)
