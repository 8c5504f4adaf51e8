"""Prior factors of static shapes: pose and strain, no velocity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from glissando._kernels import rolls
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid
from glissando.model.priors.prior import transversely_isotropic
from glissando.model.priors.rest_shape import RestShape
from glissando.model.priors.steps import static_steps
from glissando.model.state import State

STATIC_DOF = 12
"""Degrees of freedom of a node of a static shape: pose and strain."""

_DOFS = slice(0, STATIC_DOF)
_FAR = 1.5 * STATIC_DOF  # squared whitened error above which a state is far from an estimate


def static_factors(
    grid: Grid,
    state: State,
    rest: RestShape,
    intervals: tuple[Array, Array],
    base: tuple[Array, Array] | None,
) -> Iterator[Factors]:
    """Factors of arclength intervals and of the base of static shapes. Source: (2') and (5).

    Args:
        grid: Grid of S shapes and N arclength nodes.
        state: States (S, N) of the nodes to linearise at.
        rest: The shape at rest.
        intervals: Density (N−1, 6) of strain in each interval, variance (N−1, 6) of its jump.
        base: Expected pose (4, 4) of the base, and variances (12,) of its pose and strain; None
            if the prior does not fix it.
    """
    count, n_count = grid.shape
    node = np.arange(count * n_count).reshape(count, n_count)
    if n_count > 1:
        nodes = np.stack([node[:, :-1].ravel(), node[:, 1:].ravel()], axis=1)
        psd, jump = (np.tile(values, (count, 1)) for values in intervals)
        step = np.tile(np.diff(grid.arclength), count)
        error, jacobian, whitener = static_steps(state.flatten(), nodes, step, psd, jump)
        error = error - np.tile(rest.interval_errors(grid.arclength), (count, 1))
        terms = Residuals(error, whitener)
        if transversely_isotropic(*intervals):
            near = np.sum(terms.whiten(error) ** 2, axis=1) < _FAR  # farther off, steps overshoot
            slopes = jacobian[near]
            rolls.turn_all_back(np.zeros(len(slopes)), error[near], slopes)  # (35)
            jacobian[near] = slopes
        yield Factors(nodes, _DOFS, jacobian, terms)
    if base is None:
        return
    pose, variance = base
    at = state.take(np.s_[:, 0])
    xi = se3.log(se3.inverse(pose) @ at.pose)
    error = np.concatenate([xi, at.strain - rest.at(np.zeros(1))], axis=-1)
    jacobian = np.zeros((count, STATIC_DOF, 1, STATIC_DOF))
    jacobian[:, :6, 0, :6] = se3.right_jacobian_inverse(xi)
    jacobian[:, 6:, 0, 6:] = np.eye(6)
    whitener = np.broadcast_to(np.diag(variance**-0.5), (count, STATIC_DOF, STATIC_DOF))
    yield Factors(node[:, :1], _DOFS, jacobian, Residuals(error, whitener))
