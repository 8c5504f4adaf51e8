"""Motions drawn from the separable prior itself, with nothing linearised but the noise's weight."""

import numpy as np
from scipy.linalg import expm

from glissando.geometry import se3
from glissando.model.priors.transitions import process_covariances


def draw_motion(
    rng,
    arclength_fine,
    time_fine,
    *,
    psd,
    base_pose_var,
    base_strain_var,
    time_scale,
    rest_strain,
    joints=(),
):
    """A motion on K times × N arclengths, its base about the identity and a rest strain.

    `joints` are pairs (s_j, jump (6,)), each s_j one of the fine arclengths but the first; the
    strain at s_j is the one after the jump. Returns pose (K, N, 4, 4), strain, velocity and strain
    rate (K, N, 6).
    """
    s, t = np.asarray(arclength_fine, dtype=float), np.asarray(time_fine, dtype=float)
    psd, jumps = np.asarray(psd, dtype=float), _jump_at(s, joints)
    # In time every component is the same unit process; Q_i's root mixes them afterwards, which
    # is a process whose first state has P∞ ⊗ Q_i and whose steps have Q(h) ⊗ Q_i.
    r, r_dot = _unit_process(rng, t, time_scale, (s.size, 12))

    root = np.sqrt(np.concatenate([base_pose_var, base_strain_var]))
    b, b_dot = root * r[:, 0], root * r_dot[:, 0]
    pose, strain = [se3.exp(b[:, :6])], [rest_strain + b[:, 6:]]
    velocity, strain_rate = [_mul(se3.right_jacobian(b[:, :6]), b_dot[:, :6])], [b_dot[:, 6:]]

    for i, h in enumerate(np.diff(s)):
        # One Q_i for all times, about the strain of the middle time: that keeps r_i a Gaussian
        # process given what lies inward, and over a short interval Q_i hardly depends on strain.
        middle = strain[i][t.size // 2][None]
        q = process_covariances(middle, np.array([h]), psd, psd, rigid=False)[0][0]
        q[6:, 6:] += np.diag(jumps[i + 1])
        root = np.linalg.cholesky(q)
        e, e_dot = r[:, i + 1] @ root.T, r_dot[:, i + 1] @ root.T

        arc, slip = h * strain[i], e[:, :6]
        ride = _mul(se3.adjoint(se3.exp(-arc)), velocity[i])
        ride = ride + h * _mul(se3.right_jacobian(arc), strain_rate[i])
        ride = _mul(se3.adjoint(se3.exp(-slip)), ride)
        velocity.append(ride + _mul(se3.right_jacobian(slip), e_dot[:, :6]))
        pose.append(pose[i] @ se3.exp(arc) @ se3.exp(slip))
        strain.append(strain[i] + e[:, 6:])
        strain_rate.append(strain_rate[i] + e_dot[:, 6:])
    return tuple(np.stack(field, axis=1) for field in (pose, strain, velocity, strain_rate))


def _unit_process(rng, time, time_scale, shape):
    """Value and rate (K, *shape) of independent unit Matérn-3/2 processes, exact at the times."""
    rate = np.sqrt(3.0) / time_scale
    drift = np.array([[0.0, 1.0], [-(rate**2), -2.0 * rate]])
    start = np.diag([1.0, rate**2])
    state = [np.tensordot(np.sqrt(start), rng.standard_normal((2, *shape)), axes=1)]
    for h in np.diff(time):
        phi = expm(h * drift)
        kick = np.linalg.cholesky(start - phi @ start @ phi.T)
        noise = rng.standard_normal((2, *shape))
        state.append(np.tensordot(phi, state[-1], axes=1) + np.tensordot(kick, noise, axes=1))
    return np.stack(state, axis=1)


def _jump_at(arclength, joints):
    """The variance (N, 6) by which the strain jumps just before each fine arclength."""
    jumps = np.zeros((arclength.size, 6))
    for place, jump in joints:
        (found,) = np.flatnonzero(np.isclose(arclength, place, rtol=0.0, atol=1e-9))
        assert found > 0, "a joint lies at the end of an interval"
        jumps[found] += jump
    return jumps


def _mul(matrix, vector):
    """Products of matrices (…, 6, 6) with vectors (…, 6)."""
    return np.einsum("...ij,...j->...i", matrix, vector)
