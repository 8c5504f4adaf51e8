"""Covariances in the axes of an estimate that has rolled since its problem was linearised.

The last step of an estimate is not linearised again, nor are all nodes of a window. Where it rolls
the body, as it may where no sensor reads the roll, the body's axes turn with it. Source: (35).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels import rolls
from glissando.geometry.se3 import Array
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Marginals

_TURNED = 1e-3  # rad, below which axes count as where they were


def has_rolled(start: State, end: State) -> bool:
    """Whether a step from one state to another turned any axes."""
    return bool(np.abs(end.rolls_from(start)).max() > _TURNED)


def transport(slopes: Array, cov: Array) -> Array:
    """Covariances (K, D, D) turned by slopes (K, N, dof, dof) of `State.slope_to`, in place."""
    rolls.transport_columns(slopes, cov)
    rolls.transport_rows(slopes, cov)
    return cov


def transported(start: State, end: State, marginals: Marginals) -> Marginals:
    """Covariances of steps from nodes (K, N) `start` as those of steps from `end`, in place."""
    if has_rolled(start, end):
        slopes = start.slope_to(end)
        transport(slopes, marginals.cov)
        rolls.transport_columns(slopes[1:], marginals.cross)
        rolls.transport_rows(slopes[:-1], marginals.cross)
    return marginals
