"""Many short block-tridiagonal systems at once: a chain of nodes each, the chains apart.

What `slabs` does along time for one long system with wide blocks, this does along arclength for a
batch of them with narrow ones. Source: equations (20) and (21).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import Array
from glissando.twins import twin


@dataclass(frozen=True)
class BatchCholesky:
    """Cholesky factors of S chains of N blocks.

    `inverse` (N, S, d, d) of the factors' diagonal blocks, `coupling` (N−1, S, d, d) as in
    `slabs.Cholesky`.
    """

    inverse: Array
    coupling: Array

    def solve(self, right: Array) -> Array:
        """Solutions (S, N, d) for right sides (S, N, d)."""
        x = np.swapaxes(right, 0, 1)[..., None].copy()
        for n, inverse in enumerate(self.inverse):
            if n:
                x[n] -= _turned(self.coupling[n - 1]) @ x[n - 1]
            x[n] = inverse @ x[n]
        for n in reversed(range(len(x))):
            if n + 1 < len(x):
                x[n] -= self.coupling[n] @ x[n + 1]
            x[n] = _turned(self.inverse[n]) @ x[n]
        return np.swapaxes(x[..., 0], 0, 1)

    def marginals(self) -> tuple[Array, Array]:
        """Blocks of the inverses: of nodes (S, N, d, d), of nodes n and n + 1 (S, N−1, d, d)."""
        cov, cross = np.empty_like(self.inverse), np.empty_like(self.coupling)
        for n in reversed(range(len(cov))):
            half = self.inverse[n]
            if n + 1 < len(cov):
                ahead = self.coupling[n] @ cov[n + 1]
                cross[n] = -(_turned(half) @ ahead)
                half = half + ahead @ (_turned(self.coupling[n]) @ half)
            block = _turned(self.inverse[n]) @ half
            cov[n] = 0.5 * (block + _turned(block))
        return np.swapaxes(cov, 0, 1), np.swapaxes(cross, 0, 1)


@twin
def factor_batch(diagonal: Array, lower: Array) -> BatchCholesky:
    """Factors of chains with blocks (S, N, d, d), and (S, N−1, d, d) below the diagonal.

    Raises LinAlgError when any chain is not positive definite.
    """
    count = diagonal.shape[1]
    inverse = np.empty((count, len(diagonal), *diagonal.shape[2:]))
    coupling = np.empty((count - 1, *inverse.shape[1:]))
    for n in range(count):
        schur = diagonal[:, n]
        if n:
            schur = schur - _turned(coupling[n - 1]) @ coupling[n - 1]
        inverse[n] = np.linalg.inv(np.linalg.cholesky(schur))
        if n + 1 < count:
            coupling[n] = inverse[n] @ _turned(lower[:, n])
    return BatchCholesky(inverse, coupling)


def _turned(matrix: Array) -> Array:
    return np.swapaxes(matrix, -1, -2)
