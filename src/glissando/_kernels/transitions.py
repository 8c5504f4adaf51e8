"""What intervals that are processes in time ask of their noise, bridges and points inside."""

from __future__ import annotations

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.process import bridge_into, pair_whiten_into, process_into
from glissando._kernels.steps import pair_point_into


@jit("(f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], b1)")
def process_covariances(rate, step, psd, carried_psd, jump, rigid):
    """Noise (M, 12, 12) and (M, 6, 6) of intervals."""
    cov, carried = np.empty((len(rate), 12, 12)), np.empty((len(rate), 6, 6))
    for i in range(len(rate)):
        process_into(rate[i], step[i], psd[i], carried_psd[i], jump[i], rigid, cov[i], carried[i])
    return cov, carried


@jit("(f8[:,::1], f8[::1], f8[::1], f8[:,::1], f8[:,::1], b1)")
def bridge(rate, step, offset, psd, jump, rigid):
    """Gains and covariances (M, 12, 12) of the pair, whatever is carried."""
    m = len(rate)
    gain, cov = np.empty((m, 12, 12)), np.empty((m, 12, 12))
    unused, unused_too = np.empty((6, 6)), np.empty((6, 6))
    for i in range(m):
        bridge_into(
            rate[i], step[i], offset[i], psd[i], psd[i], jump[i], rigid, gain[i], cov[i],
            unused, unused_too,
        )  # fmt: skip
    return gain, cov


@jit("(f8[:,:,::1],)")
def pair_sqrt_information(cov):
    """Whiteners (M, 12, 12) of covariances whose last block is diagonal."""
    out = np.zeros(cov.shape)
    for n in range(len(cov)):
        pair_whiten_into(cov[n], out[n])
    return out


@jit("(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,:,::1], i8, i8)")
def pair_between(start, end, rate0, rate1, step, offset, gain, at, columns):
    """Poses and rates inside steps; slopes (M, 18, columns) by both ends with those rows."""
    m = len(step)
    pose, rate, turn = np.empty((m, 4, 4)), np.empty((m, 6)), np.empty((6, 6))
    j0, j1 = np.zeros((m, 18, columns)), np.zeros((m, 18, columns))
    for n in range(m):
        pair_point_into(
            start[n], end[n], rate0[n], rate1[n], step[n], offset[n], gain[n], at,
            pose[n], rate[n], turn, j0[n], j1[n],
        )  # fmt: skip
    return pose, rate, j0, j1
