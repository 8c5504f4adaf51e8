"""Factors of short chains: twin of chains.py."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.process import whiten_into


@jit
def factor_batch(diagonal, lower):
    """Inverses (N, S, d, d) of the factors' blocks, and what couples them (N−1, S, d, d)."""
    s_count, n_count, d, _ = diagonal.shape
    inverse = np.empty((n_count, s_count, d, d))
    coupling = np.empty((max(n_count - 1, 0), s_count, d, d))
    schur = np.empty((d, d))
    for s in range(s_count):
        for n in range(n_count):
            schur[:] = diagonal[s, n]
            if n:
                before = coupling[n - 1, s]
                for k in range(d):
                    for i in range(d):
                        for j in range(i + 1):
                            schur[i, j] -= before[k, i] * before[k, j]
            root = inverse[n, s]
            whiten_into(schur, root)
            if n + 1 < n_count:
                out = coupling[n, s]
                for i in range(d):
                    for j in range(d):
                        value = 0.0
                        for k in range(i + 1):
                            value += root[i, k] * lower[s, n, j, k]
                        out[i, j] = value
    return inverse, coupling
