"""Square root of the information matrix by QR: twice the digits of the normal equations.

Source: Bierman, *Factorization Methods for Discrete Sequential Estimation* (1977).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from glissando._kernels.threads import one_thread
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.grid import Index
from glissando.model.memory import require_memory


@dataclass(frozen=True)
class RootInformation:
    """Upper triangular R such that Rᵀ R is the information matrix of all unknowns.

    Attributes:
        diagonal: Blocks (K, D, D) of the time nodes, upper triangular.
        beside: Blocks (K−1, D, D) to the right of the diagonal.
    """

    diagonal: Array
    beside: Array

    def sample(self, rng: np.random.Generator) -> Array:
        """One draw (K, D) from N(0, (Rᵀ R)⁻¹).

        Args:
            rng: Random number generator.
        """
        x: Array = rng.standard_normal(self.diagonal.shape[:2])
        with one_thread():
            for k in reversed(range(len(x))):
                if k + 1 < len(x):
                    x[k] -= self.beside[k] @ x[k + 1]
                x[k] = solve_triangular(self.diagonal[k], x[k])
        return x


def root_information(
    factors: Iterable[Factors], shape: tuple[int, int], dof: int
) -> RootInformation:
    """Square root of the information matrix of factors on a grid.

    Args:
        factors: Factors without extras, each of one time node or two neighbours.
        shape: Time nodes and arclength nodes (K, N) of the grid.
        dof: Degrees of freedom of a node.

    Raises:
        OutsideGridError: The matrix does not fit in memory.
    """
    count, size = shape[0], shape[1] * dof
    require_memory(
        16.0 * count * size**2,
        f"{count} time nodes of {size} numbers would be {count * size:,} unknowns",
        "take a shorter window",
    )
    rows: list[list[tuple[Index, Array]]] = [[] for _ in range(count)]
    for batch in factors:
        jacobian = batch.whitened()[1].reshape(batch.jacobian.shape)
        slab, inner = np.divmod(batch.nodes, shape[1])
        first = slab.min(axis=1)
        column = (slab - first[:, None]) * size + inner * dof + batch.dofs.start
        for k, at, slopes in zip(first, column, jacobian, strict=True):
            rows[k].append((at, slopes))
    out = RootInformation(np.empty((count, size, size)), np.empty((count - 1, size, size)))
    remainder = np.zeros((0, size))
    with one_thread():
        for k in range(count):
            wide = np.hstack([remainder, np.zeros_like(remainder)])
            tall = np.vstack([wide, *(_expanded(*row, 2 * size) for row in rows[k])])
            root: Array = np.asarray(np.linalg.qr(tall[:, : size * min(2, count - k)], mode="r"))
            out.diagonal[k] = root[:size, :size]
            if k + 1 < count:
                out.beside[k] = root[:size, size:]
            remainder = root[size:, size:]
    return out


def _expanded(columns: Index, slopes: Array, width: int) -> Array:
    """Rows (r, width) with Jacobians (r, c, d) by c nodes, whose first columns are (c,)."""
    out = np.zeros((len(slopes), width))
    for a, at in enumerate(columns):
        out[:, at : at + slopes.shape[2]] += slopes[:, a]
    return out
