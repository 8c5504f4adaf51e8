"""Process noise and bridges of lists of intervals, for `model.priors.transitions`."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.process import bridge_into, process_into
from glissando._kernels.scratch import matrix


@jit("(f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], b1)")
def process_covariances(rate, step, psd, carried_psd, jump, rigid):
    """Process noise of intervals: of the pair (M, 12, 12), of the carried field (M, 6, 6)."""
    cov, carried = np.empty((len(rate), 12, 12)), np.empty((len(rate), 6, 6))
    for i in range(len(rate)):
        process_into(rate[i], step[i], psd[i], carried_psd[i], jump[i], rigid, cov[i], carried[i])
    return cov, carried


@jit("(f8[:,::1], f8[::1], f8[::1], f8[:,::1], f8[:,::1], b1)")
def bridge(rate, step, offset, psd, jump, rigid):
    """Gains and bridge covariances (M, 12, 12) of the pair."""
    m = len(rate)
    gain, cov = np.empty((m, 12, 12)), np.empty((m, 12, 12))
    unused, unused_too = matrix(6, 6), matrix(6, 6)
    for i in range(m):
        bridge_into(
            rate[i], step[i], offset[i], psd[i], psd[i], jump[i], rigid, gain[i], cov[i],
            unused, unused_too,
        )  # fmt: skip
    return gain, cov
