"""Online: delayed readings of a window with readings at a single time, thus without motion.

Without motion readings have no derivative by a delay, and one taken any time earlier would count as
taken at that time. The possible motion of the state since, by the prior alone, is added as noise of
such a reading: with z = h(x(t − d)), the covariance of x(t) − x(t − d) for the root mean square of
d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.block_tridiagonal import factor
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate

_BRIEF = 0.01  # s: over less the motion is proportional to time, and differences lose digits


def shows_motion(streams: Sequence[Readings]) -> bool:
    """Whether readings were taken at several times."""
    times = [stream.time for stream in streams if len(stream)]
    return bool(times) and bool(np.ptp(np.concatenate(times)) > 0.0)


def moved_within(prior: Prior, arclength: Array, state: State, lag: float) -> Array:
    """Covariance (N · dof, N · dof) of the motion of nodes within a time, by the prior alone.

    Args:
        prior: The prior.
        arclength: Arclength nodes (N,), m.
        state: Nodes (K, N), the last of which is the linearisation point.
        lag: Duration, s.
    """
    lasts = max(lag, _BRIEF, prior.least_step(arclength))
    grid, both = Grid(arclength, [0.0, lasts]), state.take(np.array([-1, -1]))
    known = factor(linearize(prior, locate(grid, []), both, both).system).marginals(consume=True)
    across = known.cross[0]
    return np.asarray(known.cov.sum(axis=0) - across - across.T) * (lag / lasts) ** 2


def widened(factors: Factors, moves: Array) -> Factors:
    """Factors of readings with the motion of their states added to their noise.

    Args:
        factors: Factors linearised at nodes (K, N), whose motion is the same at all times.
        moves: Covariance (N, dof, N, dof) of the motion of a time's nodes.
    """
    terms, own = factors.terms, factors.dofs
    by_node = np.einsum("mij,mjcd->micd", terms.sqrt_info, factors.jacobian)
    nodes = factors.nodes % len(moves)
    pairs = moves[:, own, :, own].transpose(0, 2, 1, 3)[nodes[:, :, None], nodes[:, None, :]]
    more = np.einsum("micd,mcedf,mjef->mij", by_node, pairs, by_node, optimize=True)
    root = np.linalg.cholesky(np.eye(more.shape[1]) + 0.5 * (more + np.swapaxes(more, 1, 2)))
    sqrt_info = np.ascontiguousarray(np.linalg.solve(root, terms.sqrt_info))
    return replace(factors, terms=replace(terms, sqrt_info=sqrt_info))
