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


def carried(start: State, end: State, marginals: Marginals) -> Marginals:
    """Covariances of steps from nodes (K, N) as those of steps from another state.

    Args:
        start: Where the steps begin.
        end: Where one of them led.
        marginals: The covariances.
    """
    if not has_rolled(start, end):
        return marginals
    slopes = start.slope_to(end).swapaxes(-1, -2)

    def both(blocks: Array, rows: Array, columns: Array) -> Array:
        return whole(_times(_times(blocks, columns).swapaxes(1, 2), rows).swapaxes(1, 2))

    cov = both(marginals.cov, slopes, slopes)
    return Marginals(cov, both(marginals.cross, slopes[:-1], slopes[1:]))


def carried_root(start: State, end: State, root: Array) -> Array:
    """The root (D, D) of a covariance RᵀR of steps from nodes (N,) as that of steps from another.

    Args:
        start: Where the steps begin.
        end: Where one of them led.
        root: The root.
    """
    if not has_rolled(start, end):
        return root
    return _times(root, start.slope_to(end).swapaxes(-1, -2))


def _times(rows: Array, blocks: Array) -> Array:
    """Rows (…, R, D) times a block (…, N, dof, dof) each for the numbers of N points.

    Numbers after those of the points are as they were.
    """
    out, dof = whole(rows).copy(), blocks.shape[-1]
    for n in range(blocks.shape[-3]):
        at = slice(n * dof, (n + 1) * dof)
        out[..., at] = rows[..., at] @ blocks[..., n, :, :]
    return out
