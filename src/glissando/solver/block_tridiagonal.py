"""Block-tridiagonal systems: factor, solve, marginals, log-determinant, samples.

A slab holds all unknowns of one time node; in a batch of static shapes it holds one arclength node,
and slabs of different shapes are not coupled. The cost is linear in the number of slabs, and a
factorisation can resume at any slab. Source: equations (20) to (22).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glissando._kernels import block_tridiagonal as kernels
from glissando._kernels.arrays import whole
from glissando._kernels.threads import one_thread
from glissando.errors import UnobservableError
from glissando.geometry.se3 import Array
from glissando.model.priors.transitions import symmetrize


@dataclass(frozen=True)
class BlockTridiagonal:
    """A symmetric block-tridiagonal matrix.

    Attributes:
        diagonal: Blocks (K, D, D) on the diagonal.
        lower: Blocks (K−1, D, D) below the diagonal, lower[k] = A[k+1, k].
    """

    diagonal: Array
    lower: Array

    def add_to_diagonal(self, values: Array) -> BlockTridiagonal:
        """The matrix plus diag(values), values (K, D)."""
        diagonal = self.diagonal.copy()
        np.einsum("kii->ki", diagonal)[...] += values
        return BlockTridiagonal(diagonal, self.lower)


@dataclass(frozen=True)
class Marginals:
    """Blocks of the inverse on the diagonal and next to it: marginal covariances.

    Attributes:
        cov: Covariances (K, D, D) of slabs.
        cross: Covariances (K−1, D, D) between slabs k and k + 1.
    """

    cov: Array
    cross: Array

    def spread(
        self, slab: NDArray[np.intp], first: NDArray[np.intp], slopes: Array, left: Array
    ) -> Array:
        """Covariance of quantities that depend linearly on parts of neighbouring slabs.

        Args:
            slab: Slabs (M, c) of the parts.
            first: First columns (M, c) of the parts in their slabs.
            slopes: Derivatives (M, r, c, size) with respect to the parts.
            left: Covariance (M, r, r) of the quantities given the parts, which is added.

        Returns:
            Covariances (M, r, r), symmetric.
        """
        out = np.array(left, dtype=float)
        with one_thread():
            kernels.add_spread(
                whole(self.cov), whole(self.cross), whole(slab), whole(first), whole(slopes), out
            )
        return symmetrize(out)


@dataclass(frozen=True)
class Cholesky:
    """Block Cholesky factor L: inverses of its diagonal blocks, and the blocks beside them.

    Inverses of the triangles are kept because products with them run several times faster than
    triangular solves of this size.

    Attributes:
        inverse: Inverses (K, D, D) of the diagonal blocks, lower triangular.
        coupling: Blocks inverse[k] A[k, k+1] (K−1, D, D), those of Lᵀ above the diagonal.
    """

    inverse: Array
    coupling: Array

    @property
    def log_det(self) -> float:
        """Log-determinant of the matrix."""
        return -2.0 * float(np.sum(np.log(np.einsum("kii->ki", self.inverse))))

    def solve(self, rhs: Array) -> Array:
        """Solution x (K, D) of A x = rhs (K, D)."""
        x = np.array(rhs, dtype=float)
        with one_thread():
            kernels.solve(self.inverse, self.coupling, x)
        return x

    def whitened(self, rows: Array) -> Array:
        """Rows B (R, K, D) times L⁻ᵀ; inner products of the results are entries of B A⁻¹ Bᵀ."""
        out = np.empty_like(rows)
        for k, inverse in enumerate(self.inverse):
            own = rows[:, k] if k == 0 else rows[:, k] - out[:, k - 1] @ self.coupling[k - 1]
            out[:, k] = own @ inverse.T
        return out

    def sample(self, rng: np.random.Generator) -> Array:
        """One draw (K, D) from N(0, A⁻¹)."""
        white = rng.standard_normal(self.inverse.shape[:2])
        with one_thread():
            kernels.backward(self.inverse, self.coupling, white)
        return white

    def marginals(self, *, consume: bool = False) -> Marginals:
        """All blocks of A⁻¹ on the diagonal and next to it. Source: equation (21).

        Args:
            consume: Overwrite the factor, which is then invalid: allocating fresh memory would
                take as long as the computation.
        """
        cov = self.inverse if consume else np.empty_like(self.inverse)
        cross = self.coupling if consume else np.empty_like(self.coupling)
        with one_thread():
            kernels.marginals(self.inverse, self.coupling, cov, cross)
        return Marginals(cov, cross)


def factor(
    matrix: BlockTridiagonal, workspace: Cholesky | None = None, *, start: int = 0
) -> Cholesky:
    """Forward block Cholesky of a positive definite matrix. Source: equation (20).

    Args:
        matrix: The matrix.
        workspace: An earlier factor of the same size, to be overwritten; allocated if None.
        start: First slab at which the matrix differs from the one that `workspace` factors.

    Raises:
        UnobservableError: A pivot vanishes: some direction of the state has no information.
    """
    if workspace is None:
        workspace = Cholesky(np.empty_like(matrix.diagonal), np.empty_like(matrix.lower))
    blocks = whole(matrix.diagonal), whole(matrix.lower)
    eliminate(kernels.factor, *blocks, start, workspace.inverse, workspace.coupling)
    return workspace


def eliminate(kernel: Callable[..., int], *arguments: Any) -> None:
    """Call a kernel that factors a matrix, and check its pivots.

    Args:
        kernel: Kernel that returns the first slab with a vanishing pivot, or −1.
        arguments: Arguments of the kernel.

    Raises:
        UnobservableError: A pivot vanishes: some direction of the state has no information.
    """
    with one_thread():
        vanished = kernel(*arguments)
    if vanished >= 0:
        raise UnobservableError(
            f"The normal equations are singular at time node {vanished}: prior and readings leave "
            f"a direction of the state undetermined. Give the robot a [base], or a pose stream, or "
            f"coils or positions at several places of a bent shape."
        )
