"""Block-tridiagonal systems: factor, solve, marginals, log-determinant, samples.

One block, a slab, holds all arclength nodes of one time. Everything is linear in the number of
slabs: a forward block Cholesky, a backward substitution, a backward recursion for covariances.
Source: equations (20) to (22). Every routine keeps BLAS to one thread: the blocks are small.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from glissando._kernels.threads import one_thread
from glissando.errors import UnobservableError
from glissando.geometry.se3 import Array

_PIVOT_FLOOR = 1e-13  # a pivot this small against its diagonal entry carries no information
_HALVED = 32  # rows of the halves of a triangle from which on it is inverted by them


@dataclass(frozen=True)
class BlockTridiagonal:
    """A symmetric matrix: `diagonal` (K, D, D) and `lower` (K−1, D, D), lower[k] = A[k+1, k]."""

    diagonal: Array
    lower: Array

    def add_to_diagonal(self, values: Array) -> BlockTridiagonal:
        """The matrix plus diag(values), values (K, D)."""
        diagonal = self.diagonal.copy()
        np.einsum("kii->ki", diagonal)[...] += values
        return BlockTridiagonal(diagonal, self.lower)


@dataclass(frozen=True)
class Marginals:
    """Blocks of the inverse: `cov` (K, D, D) and `cross` (K−1, D, D) = cov of slabs k and k+1."""

    cov: Array
    cross: Array

    def joint(self, slab: NDArray[np.intp], column: NDArray[np.intp]) -> Array:
        """Joint covariance (M, q, q) of numbers: columns (M, q) of slabs (M, q), neighbours all."""
        k0, k1 = slab[:, :, None], slab[:, None, :]
        row, other = column[:, :, None], column[:, None, :]
        cov = self.cov[k0, row, other]
        if np.all(slab == slab[:, :1]):
            return cov
        swap = k0 > k1
        low = np.minimum(np.minimum(k0, k1), len(self.cross) - 1)
        cross = self.cross[low, np.where(swap, other, row), np.where(swap, row, other)]
        return np.where(k0 == k1, cov, cross)


@dataclass(frozen=True)
class Cholesky:
    """Block Cholesky factor L: inverses of its diagonal blocks, and what couples slabs.

    `inverse` (K, D, D) lower, `coupling` (K−1, D, D) with coupling[k] = inverse[k] A[k, k+1], and
    the log-determinant of A. Inverses of the triangles are kept because products with them run
    several times faster than triangular solves of this size.
    """

    inverse: Array
    coupling: Array
    log_det: float

    def solve(self, right: Array) -> Array:
        """Solution x (K, D) of A x = right (K, D)."""
        x = np.array(right, dtype=float)
        with one_thread():
            for k, inverse in enumerate(self.inverse):
                if k:
                    x[k] -= self.coupling[k - 1].T @ x[k - 1]
                x[k] = inverse @ x[k]
            return self._backward(x)

    def _backward(self, x: Array) -> Array:
        """Solve with the transposed factor, in place."""
        for k in reversed(range(len(self.inverse))):
            if k + 1 < len(self.inverse):
                x[k] -= self.coupling[k] @ x[k + 1]
            x[k] = self.inverse[k].T @ x[k]
        return x

    def sample(self, rng: np.random.Generator) -> Array:
        """One draw (K, D) from N(0, A⁻¹)."""
        white = rng.standard_normal(self.inverse.shape[:2])
        with one_thread():
            return self._backward(white)

    def marginals(self, *, consume: bool = False) -> Marginals:
        """All blocks of A⁻¹ on the diagonal and next to it. Source: equation (21).

        With `consume` they are written over the factor, which is of no use afterwards: fresh
        memory for them would cost as much time as computing them.
        """
        cov = self.inverse if consume else np.empty_like(self.inverse)
        cross = self.coupling if consume else np.empty_like(self.coupling)
        with one_thread():
            for k in reversed(range(len(cov))):
                inverse = self.inverse[k]
                block = inverse.T @ inverse
                if k + 1 < len(cov):
                    gain = blas.dtrmm(-1.0, inverse.T, self.coupling[k].T, side=1, trans_a=1).T
                    cross[k] = gain @ cov[k + 1]
                    block += cross[k] @ gain.T
                cov[k] = 0.5 * (block + block.T)
        return Marginals(cov, cross)


def factor(matrix: BlockTridiagonal, room: Cholesky | None = None) -> Cholesky:
    """Forward block Cholesky of a positive definite matrix. Source: equation (20).

    An earlier factor of the same size may be given as `room` to be overwritten. Raises
    UnobservableError when a pivot vanishes: some direction of the state has no information.
    """
    inverses = np.empty_like(matrix.diagonal) if room is None else room.inverse
    couplings = np.empty_like(matrix.lower) if room is None else room.coupling
    coupling = np.empty((0, 0))
    with one_thread():
        for k, block in enumerate(matrix.diagonal):
            schur = block.T  # Fortran order; the matrix is symmetric
            if k:
                schur = blas.dsyrk(-1.0, coupling, beta=1.0, c=schur, trans=1, lower=1)
            chol, failed = lapack.dpotrf(schur, lower=1, clean=1)
            if failed:
                raise _unobservable(k)
            inverse = inverse_of_triangle(chol)
            inverses[k] = inverse
            if k < len(couplings):
                coupling = blas.dtrmm(1.0, inverse, matrix.lower[k].T, lower=1)
                couplings[k] = coupling
    pivots = np.einsum("kii->ki", inverses) ** -2.0
    sound = pivots >= _PIVOT_FLOOR * np.einsum("kii->ki", matrix.diagonal)
    if not np.all(sound):  # so that NaN counts as vanished
        raise _unobservable(int(np.argmin(np.all(sound, axis=1))))
    return Cholesky(inverses, couplings, float(np.sum(np.log(pivots))))


def inverse_of_triangle(lower: Array) -> Array:
    """Inverse (n, n) of a lower triangle, in Fortran's order.

    By halves if large: products of the parts are much faster than LAPACK's inversion of the whole.
    """
    n = len(lower) // 2
    if n < _HALVED:
        return np.asarray(lapack.dtrtri(lower, lower=1)[0])
    out = np.zeros_like(lower, order="F")
    out[:n, :n] = lapack.dtrtri(lower[:n, :n], lower=1)[0]
    out[n:, n:] = lapack.dtrtri(lower[n:, n:], lower=1)[0]
    out[n:, :n] = -out[n:, n:] @ (lower[n:, :n] @ out[:n, :n])
    return out


def _unobservable(k: int) -> UnobservableError:
    return UnobservableError(
        f"The normal equations are singular at time node {k}: prior and readings leave a direction "
        f"of the state undetermined. Give the robot a [base], or a pose stream, or coils or "
        f"positions at several places of a bent shape."
    )
