"""Slow, obvious twins of the fast code: matrix exponentials, power series and dense inverses.

Nothing here imports the functions it judges. Poses take body coordinates to the world and are
perturbed on the right; six-vectors are [linear, angular]. One element at a time, no batches.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm, logm

from glissando.model.factors import Factors
from glissando.model.state import DOF

Array = NDArray[np.float64]


def hat(x: Array) -> Array:
    """Return the 4x4 matrix of a six-vector, entry by entry."""
    a, b, c, u, v, w = x
    return np.array([[0, -w, v, a], [w, 0, -u, b], [-v, u, 0, c], [0, 0, 0, 0]], dtype=float)


def vee(matrix: Array) -> Array:
    """Return the six-vector of a 4x4 matrix, the inverse of `hat`."""
    m = matrix
    return np.array([m[0, 3], m[1, 3], m[2, 3], m[2, 1], m[0, 2], m[1, 0]])


def exp(x: Array) -> Array:
    """Return the pose of a six-vector by the matrix exponential."""
    return expm(hat(x))


def log(pose: Array) -> Array:
    """Return the six-vector of a pose by the matrix logarithm; rotations well below pi only."""
    return vee(np.real(logm(pose)))


def adjoint(pose: Array) -> Array:
    """Return Ad(T) column by column, from T x^ T^-1."""
    return np.stack([vee(pose @ hat(x) @ np.linalg.inv(pose)) for x in np.eye(6)], axis=1)


def ad(x: Array) -> Array:
    """Return ad(x) column by column, from the commutator x^ y^ - y^ x^."""
    return np.stack([vee(hat(x) @ hat(y) - hat(y) @ hat(x)) for y in np.eye(6)], axis=1)


def adjoint_exp(x: Array) -> Array:
    """Return Ad(exp(x)) = expm(ad(x))."""
    return expm(ad(x))


def right_jacobian(x: Array, terms: int = 60) -> Array:
    """Return J_r(x) by its power series, sum of (-ad(x))^k / (k+1)!."""
    return sum(np.linalg.matrix_power(-ad(x), k) / float(factorial(k + 1)) for k in range(terms))


def pair_transition(rate: Array, step: float) -> Array:
    """Return Phi (12, 12) of [pose error, rate error] by the matrix exponential of F."""
    return expm(step * _pair_drift(rate))


def _pair_drift(rate: Array) -> Array:
    return np.block([[-ad(rate), np.eye(6)], [np.zeros((6, 6)), np.zeros((6, 6))]])


def van_loan(drift: Array, diffusion: Array, step: float) -> Array:
    """Return the integral of exp(F u) Q exp(F u)' over u in [0, step] (Van Loan 1978)."""
    n = len(drift)
    block = np.block([[-drift, diffusion], [np.zeros((n, n)), drift.T]])
    found = expm(step * block)
    return found[n:, n:].T @ found[:n, n:]


def pair_covariance(rate: Array, step: float, psd: Array) -> Array:
    """Return Q (12, 12) of [pose error, rate error], white noise of density psd on the rate."""
    return van_loan(_pair_drift(rate), block_diag(np.zeros((6, 6)), np.diag(psd)), step)


def carried_covariance(rate: Array, step: float, psd: Array, *, rigid: bool) -> Array:
    """Return the noise (6, 6) of the field that rides with the body, or that stays as it is."""
    return van_loan(-ad(rate) if rigid else np.zeros((6, 6)), np.diag(psd), step)


def bridge_covariance(near: Array, onward: Array, far: Array) -> Array:
    """Return what both ends leave unknown at a point, as in equation (12).

    `near` is Q(u) up to the point, `far` is Q(h-u) beyond it, `onward` is Phi(h-u).
    """
    return np.linalg.inv(np.linalg.inv(near) + onward.T @ np.linalg.inv(far) @ onward)


@dataclass(frozen=True)
class DenseSystem:
    """Normal equations as one dense matrix: `information` (n, n) and `right` (n,)."""

    information: Array
    right: Array

    @property
    def step(self) -> Array:
        """The Gauss-Newton step (n,)."""
        return np.linalg.solve(self.information, self.right)

    @property
    def cov(self) -> Array:
        """The covariance (n, n) of all nodes at once."""
        return np.linalg.inv(self.information)

    @property
    def log_det(self) -> float:
        """Log-determinant of the information."""
        sign, value = np.linalg.slogdet(self.information)
        assert sign > 0.0
        return float(value)


def assemble(batches: Iterable[Factors], nodes: int) -> DenseSystem:
    """Return the normal equations of all factors, one factor at a time."""
    information, right = np.zeros((nodes * DOF, nodes * DOF)), np.zeros(nodes * DOF)
    for batch in batches:
        weights = batch.terms.robust_weights()
        for row, at_node in enumerate(spread(batch, nodes)):
            root = batch.terms.sqrt_info[row]
            weight = weights[row] * root.T @ root
            information += at_node.T @ weight @ at_node
            right -= at_node.T @ weight @ batch.terms.residual[row]
    return DenseSystem(information, right)


def matrix_of(system: Any) -> Array:
    """Return the whole matrix (K n, K n) that block-tridiagonal slabs (K, n, n) stand for."""
    count, size = system.diagonal.shape[:2]
    out = np.zeros((count, size, count, size))
    for k in range(count):
        out[k, :, k] = system.diagonal[k]
    for k in range(count - 1):
        out[k + 1, :, k], out[k, :, k + 1] = system.lower[k], system.lower[k].T
    return out.reshape(count * size, count * size)


def spread(batch: Factors, nodes: int, dof: int = DOF) -> Array:
    """Return a batch's Jacobian (M, r, nodes * dof) with respect to every node of the grid."""
    m, r, c, _ = batch.jacobian.shape
    out = np.zeros((m, r, nodes, dof))
    for row in range(m):
        for corner in range(c):
            out[row, :, batch.nodes[row, corner], batch.dofs] += batch.jacobian[row, :, corner]
    return out.reshape(m, r, nodes * dof)
