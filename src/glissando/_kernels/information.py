"""Information at places along a chain, propagated from its two ends."""

from __future__ import annotations

import numpy as np

from glissando._kernels.blas import copy_into, product
from glissando._kernels.jit import jit


@jit()
def _blurred_into(information, noise, out):
    """Information after adding noise, (1 + I Q)⁻¹ I, made symmetric."""
    n = len(noise)
    mixed = np.empty((n, n))
    product(information, noise, mixed, 1.0, 0.0, False, False)
    for i in range(n):
        mixed[i, i] += 1.0
    blurred = np.linalg.solve(mixed, information)
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.5 * (blurred[i, j] + blurred[j, i])


@jit("(f8[:,::1], f8[:,:,::1], f8[:,:,:,::1], f8[:,:,:,::1])")
def along_chain(base, tip, onward, noise):
    """Information (K, N, r, r) at N places of K chains, from the base and from the tip.

    Args:
        base: Information (r, r) at the first place.
        tip: Information (K, r, r) at the last places.
        onward: Transition matrices (K, N−1, r, r) from one place to the next.
        noise: Process noise (K, N−1, r, r) between places.
    """
    chains, steps, r = onward.shape[:3]
    outwards = np.empty((chains, steps + 1, r, r))
    inwards = np.empty((chains, steps + 1, r, r))
    half, carried = np.empty((r, r)), np.empty((r, r))
    for k in range(chains):
        copy_into(base, outwards[k, 0])
        copy_into(tip[k], inwards[k, steps])
        for i in range(steps):
            back = np.ascontiguousarray(np.linalg.inv(onward[k, i]))  # returned in column order
            product(outwards[k, i], back, half, 1.0, 0.0, False, False)
            product(back, half, carried, 1.0, 0.0, True, False)
            _blurred_into(carried, noise[k, i], outwards[k, i + 1])
        for i in range(steps - 1, -1, -1):
            _blurred_into(inwards[k, i + 1], noise[k, i], carried)
            product(carried, onward[k, i], half, 1.0, 0.0, False, False)
            product(onward[k, i], half, inwards[k, i], 1.0, 0.0, True, False)
    return outwards, inwards
