"""Transport of covariances to the axes of an estimate that has rolled since its linearisation.

The last step of an estimate is not relinearised, nor are all nodes of a window. Where the step
rolls the body, as it may if no sensor measures roll, the body's axes turn with it. Source: (35).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels import rolls
from glissando.geometry.se3 import Array
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Marginals

_TURNED = 1e-3  # rad, below which axes count as unchanged


def has_rolled(start: State, end: State) -> bool:
    """Whether the step from one state to another rolled the body at any node."""
    return bool(np.abs(end.rolls_from(start)).max() > _TURNED)


def transport(slopes: Array, cov: Array) -> Array:
    """Transport covariances (K, D, D) in place by `State.slope_to` slopes (K, N, dof, dof)."""
    rolls.transport_columns(slopes, cov)
    rolls.transport_rows(slopes, cov)
    return cov


def transported(start: State, end: State, marginals: Marginals) -> Marginals:
    """Marginals of steps from nodes (K, N) `start`, transported to those from `end` in place."""
    if has_rolled(start, end):
        slopes = start.slope_to(end)
        transport(slopes, marginals.cov)
        rolls.transport_columns(slopes[1:], marginals.cross)
        rolls.transport_rows(slopes[:-1], marginals.cross)
    return marginals
