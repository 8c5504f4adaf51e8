"""Arclength intervals as stationary processes in time. Source: (8), (10) to (12).

An interval's error has covariance k(t−t′) Q, with k of `matern` and Q (r, r).
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.blas import product
from glissando._kernels.jit import jit
from glissando._kernels.lie import ad_into
from glissando._kernels.matern import (
    bridge_into,
    inverse_root_of_noise_into,
    transition_into,
)
from glissando._kernels.process import (
    middle_into,
    pair_whiten_into,
    process_into,
    transition_of_pair_into,
    whiten_into,
)
from glissando._kernels.scratch import matrix, vector, zero_matrix, zero_vector
from glissando._kernels.steps import FREE, pair_point_into


@jit()
def kron_into(small, large, out):
    """Kronecker product of matrices (2, 2) and (r, r)."""
    r = len(large)
    for a in range(2):
        for b in range(2):
            for i in range(r):
                for j in range(r):
                    out[a * r + i, b * r + j] = small[a, b] * large[i, j]


@jit()
def _innovation_into(fade, before, now, out):
    """Innovation of [r; ṙ] (2 r, ·): its value now less the prediction from that before."""
    r = len(now) // 2
    for i in range(r):
        for j in range(now.shape[1]):
            x, y = before[i, j], before[r + i, j]
            out[i, j] = now[i, j] - fade[0, 0] * x - fade[0, 1] * y
            out[r + i, j] = now[r + i, j] - fade[1, 0] * x - fade[1, 1] * y


@jit("(f8, f8[::1], f8[:,:,::1], f8[:,:,:,:,::1], f8[:,:,:,::1], b1)")
def chain(scale, steps, error, jacobian, cov, paired):
    """Innovations of processes (K, I) over steps (K−1,) between times.

    Args:
        scale: Time scale, s.
        steps: Time steps (K−1,), s.
        error: Errors [r; ṙ] (K, I, 2 r).
        jacobian: Jacobians (K, I, 2 r, c, dof) of the errors.
        cov: Covariances Q (K, I, r, r).
        paired: Whether the last block of Q is diagonal.

    Returns:
        Innovations (M, 2 r), M = (K−1) I, Jacobians (M, 2 r, 2 c, dof) and whiteners (M, 2 r, 2 r).
    """
    count, rows, c, dof = error.shape[1], error.shape[2], jacobian.shape[3], jacobian.shape[4]
    m, r, wide = len(steps) * count, rows // 2, c * dof
    out, slopes = np.empty((m, rows, 1)), np.zeros((m, rows, 2, wide))
    info, mean, root = np.empty((m, rows, rows)), np.empty((r, r)), np.zeros((r, r))
    fade, shrink, none = matrix(2, 2), matrix(2, 2), np.zeros((rows, wide))
    inner = jacobian.reshape(len(error), count, rows, wide)
    for k in range(len(steps)):
        transition_into(scale, steps[k], fade)
        inverse_root_of_noise_into(scale, steps[k], shrink)
        for i in range(count):
            n = k * count + i
            before, now = error[k, i].reshape(rows, 1), error[k + 1, i].reshape(rows, 1)
            _innovation_into(fade, before, now, out[n])
            _innovation_into(fade, inner[k, i], none, slopes[n, :, 0])
            for y in range(rows):
                for x in range(wide):
                    slopes[n, y, 1, x] = inner[k + 1, i, y, x]
            for y in range(r):
                for x in range(r):
                    mean[y, x] = 0.5 * (cov[k, i, y, x] + cov[k + 1, i, y, x])
                    root[y, x] = 0.0
            if paired:
                pair_whiten_into(mean, root)
            else:
                whiten_into(mean, root)
            kron_into(shrink, root, info[n])
    return out.reshape(m, rows), slopes.reshape(m, rows, 2 * c, dof), info


@jit()
def _strain_between(early, late, rest, fading, rising, strain, j0, j1):
    """Strain (6,) from fields (18,) at both ends, and its rows of the Jacobians (18, 24)."""
    for i in range(6):
        strain[i] = rest[i]
        strain[i] += fading[0, 0] * (early[i] - rest[i]) + fading[0, 1] * early[12 + i]
        strain[i] += rising[0, 0] * (late[i] - rest[i]) + rising[0, 1] * late[12 + i]
        j0[6 + i, 6 + i], j0[6 + i, 18 + i] = fading[0, 0], fading[0, 1]
        j1[6 + i, 6 + i], j1[6 + i, 18 + i] = rising[0, 0], rising[0, 1]


@jit("(f8, f8[:,:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1], f8[:,:,:,::1])")
def between(scale, poses, fields, step, offset, rest, inner):
    """States inside time steps, from those at both ends: M earlier ones, then M later ones.

    Args:
        scale: Time scale, s.
        poses: Poses (2 M, 4, 4) at the ends.
        fields: Strain, velocity and strain rate (2 M, 18) at the ends.
        step: Lengths (M,), s.
        offset: Times (M,) since the beginnings of the steps, s.
        rest: Expected strain (M, 6).
        inner: Jacobians (2 M, 24, c, dof) of the ends by their nodes.

    Returns:
        Poses, strains and velocities; Jacobians (M, 18, 2 c, dof) by all nodes; Σ_t (M, 2, 2).
    """
    m, c, dof = len(step), inner.shape[2], inner.shape[3]
    pose, strain, velocity = np.empty((m, 4, 4)), np.empty((m, 6)), np.empty((m, 6))
    slopes, left = np.empty((m, 18, 2 * c * dof)), np.empty((m, 2, 2))
    fading, rising, turn = matrix(2, 2), matrix(2, 2), matrix(6, 6)
    gain, eye, wide = matrix(12, 12), np.eye(6), c * dof
    for n in range(m):
        j0, j1 = zero_matrix(18, 24), zero_matrix(18, 24)
        early, late = fields[n], fields[m + n]
        bridge_into(scale, step[n], offset[n], fading, rising, left[n])
        kron_into(rising, eye, gain)
        pair_point_into(
            poses[n], poses[m + n], early[6:12], late[6:12], step[n], offset[n], gain, 12,
            pose[n], velocity[n], turn, j0, j1,
        )  # fmt: skip
        _strain_between(early, late, rest[n], fading, rising, strain[n], j0, j1)
        first, last = inner[n].reshape(24, wide), inner[m + n].reshape(24, wide)
        product(j0, first, slopes[n, :, :wide], 1.0, 0.0, False, False)
        product(j1, last, slopes[n, :, wide:], 1.0, 0.0, False, False)
    return pose, strain, velocity, slopes.reshape(m, 18, 2 * c, dof), left


@jit("(f8, f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1])")
def left_over(scale, velocity, through, section, along):
    """Bridge covariance of the state at points, Σ_s ⊗ P∞ + (K_s − Σ_s) ⊗ Σ_t. (12).

    Args:
        scale: Time scale, s.
        velocity: Velocity (M, 6) of the body.
        through: Bridge covariance along time, Σ_t (M, 2, 2).
        section: Prior covariance of the cross-section, K_s (M, 12, 12).
        along: Bridge covariance along arclength, Σ_s (M, 12, 12).

    Returns:
        Covariances (M, 18, 18) of pose, strain and the body's velocity.
    """
    m, whole, curl = len(velocity), zero_matrix(2, 2), matrix(6, 6)
    whole[0, 0], whole[1, 1] = 1.0, 3.0 / scale**2
    out = np.empty((m, 18, 18))
    for n in range(m):
        for y in range(18):
            a, i = divmod(y, 12)
            for x in range(18):
                b, j = divmod(x, 12)
                own = along[n, i, j]
                out[n, y, x] = whole[a, b] * own + through[n, a, b] * (section[n, i, j] - own)
        ad_into(velocity[n], curl)
        product(curl, out[n, 0:6], out[n, 12:18], 1.0, 1.0, False, False)
        product(out[n, :, 0:6], curl, out[n, :, 12:18], 1.0, 1.0, False, True)
    return out


@jit()
def _onward_into(rate, step, psd, jump, before, out):
    """Covariance (12, 12) of a cross-section `step` beyond one with the covariance `before`."""
    phi, half, carried = matrix(12, 12), matrix(12, 12), matrix(6, 6)
    transition_of_pair_into(rate, step, phi)
    process_into(rate, step, psd, psd, jump, FREE, out, carried)
    product(phi, before, half, 1.0, 0.0, False, False)
    product(half, phi, out, 1.0, 1.0, False, True)


@jit("(f8[:,:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], i8[::1], i8[::1], f8[::1])")
def sections(strain, lengths, psd, jump, base, k, n, offset):
    """Prior covariances K_s (M, 12, 12) of cross-sections along the shapes at time nodes.

    Args:
        strain: Strain (K, N, 6) at nodes.
        lengths: Lengths (N−1,) of intervals, m.
        psd: Densities (N−1, 6) of strain.
        jump: Variances (N−1, 6) of strain's jump at the end of intervals.
        base: Covariance (12, 12) at the base.
        k: Time nodes (M,).
        n: Arclength nodes (M,).
        offset: Distances (M,) beyond these nodes, m; zero on a node.
    """
    count, first = len(lengths), k.min()
    known = np.zeros(k.max() + 1 - first, np.bool_)
    cov = np.empty((len(known), count + 1, 12, 12))
    out, middle, smooth = np.empty((len(k), 12, 12)), vector(6), zero_vector(6)
    for i in range(len(k)):
        shape, at = cov[k[i] - first], strain[k[i]]
        if not known[k[i] - first]:
            known[k[i] - first] = True
            shape[0] = base
            for j in range(count):
                middle_into(at[j], at[j + 1], lengths[j], psd[j], jump[j], middle)
                _onward_into(middle, lengths[j], psd[j], jump[j], shape[j], shape[j + 1])
        if offset[i] > 0.0:
            j = n[i]
            middle_into(at[j], at[j + 1], lengths[j], psd[j], jump[j], middle)
            _onward_into(middle, offset[i], psd[j], smooth, shape[j], out[i])
        else:
            out[i] = shape[n[i]]
    return out
