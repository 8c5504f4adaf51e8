"""Covariances in the axes of an estimate that has rolled since its problem was linearised.

The last step of an estimate is not linearised again, nor are all nodes of a window. Where it rolls
the body, as it may where no sensor reads the roll, the body's axes turn with it. Source: (35).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.arrays import whole
from glissando.geometry.se3 import Array
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Marginals

_TURNED = 1e-3  # rad, below which axes count as where they were


def has_rolled(start: State, end: State) -> bool:
    """Whether a step from one state to another turned any axes."""
    return bool(np.abs(end.rolls_from(start)).max() > _TURNED)


def carried_rows(start: State, end: State, rows: Array) -> Array:
    """Numbers that belong to steps from one state as those of steps from another.

    Args:
        start: Points (…, N) where the steps begin.
        end: Points (…, N) where one of them led.
        rows: Rows (…, R, D) of numbers: N · dof of the points, then others, which stay.

    Returns:
        The rows (…, R, D): of a root R of the covariance RᵀR of steps, those of the other's root.
    """
    out, dof = rows.copy(), start.dof
    slopes = start.slope_to(end).swapaxes(-1, -2)
    for n in range(slopes.shape[-3]):
        at = slice(n * dof, (n + 1) * dof)
        out[..., at] = rows[..., at] @ slopes[..., n, :, :]
    return out


def carried(start: State, end: State, marginals: Marginals) -> Marginals:
    """Covariances of steps from nodes (K, N) `start` as those of steps from `end`."""
    if not has_rolled(start, end):
        return marginals

    def both(blocks: Array, rows: slice, columns: slice) -> Array:
        for at in (columns, rows):
            blocks = carried_rows(start.take(at), end.take(at), blocks).swapaxes(1, 2)
        return whole(blocks)

    every, first, second = slice(None), slice(-1), slice(1, None)
    return Marginals(both(marginals.cov, every, every), both(marginals.cross, first, second))
