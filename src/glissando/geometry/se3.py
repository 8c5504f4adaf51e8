"""Batched SE(3): exponential, logarithm, adjoints and right Jacobians.

**A pose is an array T_wb (…, 4, 4) that takes body coordinates to world; it is perturbed on the
right, T ⊕ x = T exp(x^), and six-vectors are [linear, angular] = [rho, phi].** Metres, radians.
Every function takes any leading shape. Coefficients are power series in the squared angle near zero
and closed forms away from it, so values and derivatives are accurate everywhere; the logarithm goes
through the quaternion and is accurate up to and at π.

Sources: Barfoot, *State Estimation for Robotics* (2nd ed.), chapter 8; the Jacobian polynomials
follow from the minimal polynomial (ad² + θ²)² ad = 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from glissando._kernels import se3 as kernels
from glissando._kernels.arrays import Array as Array
from glissando._kernels.arrays import items


def _skews() -> tuple[Array, Array]:
    """Linear maps from a three-vector to its skew matrix, and from a six-vector to its ad."""
    skew, wide = np.zeros((3, 3, 3)), np.zeros((6, 6, 6))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        skew[i, k, j], skew[i, j, k] = 1.0, -1.0
    wide[3:, :3, :3] = wide[3:, 3:, 3:] = wide[:3, :3, 3:] = skew
    return skew.reshape(3, 9), wide.reshape(6, 36)


_EYE3 = np.eye(3)
_SKEW, _AD = _skews()
_CROSS = np.zeros((3, 6, 6))  # x^T _CROSS x / 2 is φ × ρ / 2
_CROSS[:, 3:, :3] = 0.5 * _SKEW.reshape(3, 3, 3).transpose(1, 0, 2)
_CROSS[:, :3, 3:] = np.swapaxes(_CROSS[:, 3:, :3], 1, 2)


def hat3(v: Array) -> Array:
    """Skew matrix (…, 3, 3) of a three-vector (…, 3); its product is the cross product."""
    return (v @ _SKEW).reshape(*v.shape[:-1], 3, 3)


def hat(x: Array) -> Array:
    """Matrix x^ (…, 4, 4) of a six-vector [rho, phi]; dT/ds = T ε^ for a strain ε."""
    out = np.zeros((*x.shape[:-1], 4, 4))
    out[..., :3, :3] = hat3(x[..., 3:])
    out[..., :3, 3] = x[..., :3]
    return out


def pose(rotation: Array, position: Array) -> Array:
    """Pose (…, 4, 4) of a rotation matrix (…, 3, 3) and a position (…, 3)."""
    rotation, position = np.asarray(rotation), np.asarray(position)
    lead = np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    out = np.zeros((*lead, 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = rotation, position, 1.0
    return out


def so3_exp(phi: Array) -> Array:
    """Rotation matrix (…, 3, 3) of a rotation vector (…, 3)."""
    x = np.zeros((*phi.shape[:-1], 6))
    x[..., 3:] = phi
    return exp(x)[..., :3, :3]


def quaternion(rotation: Array) -> Array:
    """Unit quaternion [w, x, y, z] (…, 4), w ≥ 0, of a rotation matrix (…, 3, 3).

    The largest of the four components is found first and the others divided by it, so the
    result is accurate for every angle (Shepperd 1978).
    """
    r = rotation
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    q = np.empty((*r.shape[:-2], 4, 4))  # row i is the quaternion times 4 * its component i
    q[..., 0, 0], q[..., 1, 1] = 1 + xx + yy + zz, 1 + xx - yy - zz
    q[..., 2, 2], q[..., 3, 3] = 1 - xx + yy - zz, 1 - xx - yy + zz
    for i, j, k in ((1, 2, 3), (2, 3, 1), (3, 1, 2)):
        q[..., 0, i] = q[..., i, 0] = r[..., k - 1, j - 1] - r[..., j - 1, k - 1]
        q[..., i, j] = q[..., j, i] = r[..., i - 1, j - 1] + r[..., j - 1, i - 1]
    largest = np.argmax(np.einsum("...ii->...i", q), axis=-1)
    best = np.take_along_axis(q, largest[..., None, None], axis=-2)[..., 0, :]
    best = best / np.linalg.norm(best, axis=-1, keepdims=True)
    return np.where(best[..., :1] < 0.0, -best, best)


def rotation_from_quaternion(q: Array) -> Array:
    """Rotation matrix (…, 3, 3) of a quaternion [w, x, y, z] (…, 4) of any norm but zero."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w = hat3(q[..., 1:])
    return _EYE3 + 2.0 * q[..., :1, None] * w + 2.0 * (w @ w)


def so3_log(rotation: Array) -> Array:
    """Rotation vector (…, 3) of a rotation matrix (…, 3, 3), its norm in [0, π]."""
    return log(pose(rotation, np.zeros(3)))[..., 3:]


def exp(x: Array) -> Array:
    """Pose (…, 4, 4) of a six-vector [rho, phi] (…, 6).

    >>> np.round(exp(np.array([0, 0, 0.1, 0, np.pi / 2, 0]))[:3, 3], 4)  # a quarter arc
    array([0.0637, 0.    , 0.0637])
    """
    x = np.asarray(x, dtype=float)
    lead = x.shape[:-1]
    poses: Array = kernels.exp(items(x, lead, 6)).reshape(*lead, 4, 4)
    return poses


def retract(pose: Array, step: Array) -> Array:
    """Poses (…, 4, 4) perturbed on the right by the first six numbers of steps (…, ·)."""
    lead = pose.shape[:-2]
    if lead != step.shape[:-1]:
        lead = np.broadcast_shapes(lead, step.shape[:-1])
    moved: Array = kernels.retract(items(pose, lead, 4, 4), items(step, lead, step.shape[-1]))
    return moved.reshape(*lead, 4, 4)


def log(pose: Array) -> Array:
    """Six-vector [rho, phi] (…, 6) of a pose (…, 4, 4), the rotation angle in [0, π]."""
    lead = pose.shape[:-2]
    vectors: Array = kernels.log(items(pose, lead, 4, 4)).reshape(*lead, 6)
    return vectors


def inverse(pose: Array) -> Array:
    """Inverse (…, 4, 4) of a pose: takes world coordinates to body."""
    out = np.zeros_like(pose)
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    out[..., :3, :3] = rotation
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation, pose[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def adjoint(pose: Array) -> Array:
    """Ad(T) (…, 6, 6): T exp(x^) T⁻¹ = exp((Ad(T) x)^)."""
    rotation = pose[..., :3, :3]
    out = np.zeros((*pose.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = rotation
    out[..., :3, 3:] = hat3(pose[..., :3, 3]) @ rotation
    return out


def ad(x: Array) -> Array:
    """Lie bracket with x as a matrix (…, 6, 6): (ad(x) y)^ = x^ y^ − y^ x^."""
    return (x @ _AD).reshape(*x.shape[:-1], 6, 6)


def right_jacobian(x: Array) -> Array:
    """J_r(x) (…, 6, 6): exp(x + d) = exp(x) exp(J_r(x) d) to first order in d.

    Also ∫₀¹ Ad(exp(−u x)) du, which is how the priors use it.
    """
    return _matrices(kernels.right_jacobian, x)


def right_jacobian_slope(x: Array, w: Array) -> Array:
    """Derivative (…, 6, 6) of J_r(x) w with respect to x, for six-vectors x and w (…, 6)."""
    x, w = np.broadcast_arrays(x, w)
    return _matrices(kernels.right_jacobian_slope, x, w)


def right_jacobian_inverse(x: Array) -> Array:
    """J_r(x)⁻¹ (…, 6, 6): log(exp(x) exp(d)) = x + J_r(x)⁻¹ d to first order in d."""
    return _matrices(kernels.right_jacobian_inverse, x)


def left_jacobian(x: Array) -> Array:
    """J_l(x) (…, 6, 6): exp(x + d) = exp(J_l(x) d) exp(x) to first order in d."""
    return right_jacobian(-x)


def left_jacobian_inverse(x: Array) -> Array:
    """J_l(x)⁻¹ (…, 6, 6): log(exp(d) exp(x)) = x + J_l(x)⁻¹ d to first order in d."""
    return right_jacobian_inverse(-x)


def rotate(rotation: Array, vector: Array) -> Array:
    """Vectors (…, 3) turned by rotations (…, 3, 3), or any vectors by any matrices."""
    return np.einsum("...ij,...j->...i", rotation, vector)


def position_covariance(cov: Array) -> Array:
    """Second moments (…, 3, 3) of the position of exp(x^), for covariance (…, 6, 6) of x.

    The position is ρ + φ × ρ / 2 to second order. Where the rotation is uncertain the position
    moves along an arc, which a first-order covariance would replace by its tangent.
    Source: equation (34).
    """
    by_cross = np.einsum("iab,...bc->...iac", _CROSS, cov)
    mean = 0.5 * np.einsum("...iaa->...i", by_cross)
    spread = 0.5 * np.einsum("...iab,...jba->...ij", by_cross, by_cross)
    return cov[..., :3, :3] + spread + mean[..., :, None] * mean[..., None, :]


def _matrices(kernel: Callable[..., Array], *vectors: Array) -> Array:
    """Matrices (…, 6, 6) that a kernel computes from six-vectors (…, 6) of one shape."""
    lead = vectors[0].shape[:-1]
    return kernel(*(items(each, lead, 6) for each in vectors)).reshape(*lead, 6, 6)


def least_turn(axis: Array) -> Array:
    """Rotations (M, 3, 3) of least angle that take the z axis onto axes (M, 3)."""
    lean = np.stack([-axis[:, 1], axis[:, 0], np.zeros(len(axis))], axis=-1)
    sine = np.linalg.norm(lean, axis=1, keepdims=True)
    angle = np.arctan2(sine, axis[:, 2:])
    lean = np.where(sine > 1e-12, angle * lean / np.maximum(sine, 1e-12), [1.0, 0.0, 0.0] * angle)
    return so3_exp(lean)
