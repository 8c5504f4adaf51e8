"""A body's shape in few numbers: the modes that the sensor can tell, and their rates.

Of all numbers of a time node those combinations are kept that move some reading by more than its
noise, before any reading of the time ahead, and their rates of change. They are a Markov chain of
their own: exactly for a still shape under the separable prior, where every linear functional with
its rate is one; else the chain with the same covariance at neighbouring nodes. What modes leave
uncertain stays where it matters, at readings and at queries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.se3 import Array
from glissando.slabs import BlockTridiagonal, Marginals
from glissando.transitions import symmetrize

_FLOOR = 1e-9  # of the largest variance: below it there is only rounding


@dataclass(frozen=True)
class Modes:
    """d numbers z = weightsᵀ x of each time node, before any reading of the time ahead.

    `weights` (D, d); `lift` (K−1, 2 D, 2 d) gives what is expected of both ends of a time step, x,
    from theirs, z; `pair` (K−1, 2 d, 2 d) is the covariance of z there, `system` its inverse over
    all times.
    """

    weights: Array
    lift: Array
    pair: Array
    system: BlockTridiagonal


def telling_weights(cov: Array, rows: Array, least: float, most: int) -> Array:
    """Weights (D, m) of the combinations that readings can tell of a node's covariance (D, D).

    `rows` (R, D) are whitened Jacobians of readings everywhere; the components that are left out
    move them by `least` standard deviations of their noise at most, in the root mean square, unless
    there are more than `most`.
    """
    variance, modes = np.linalg.eigh(rows @ cov @ rows.T)
    left = np.cumsum(np.maximum(variance, 0.0)) / len(rows)
    kept = (left > least**2) & (variance > _FLOOR * variance[-1])
    kept[:-most] = False
    kept[-1] = True
    return rows.T @ (modes[:, kept] / np.sqrt(variance[kept]))


def with_rates(weights: Array, cov: Array, nodes: int, dof: int) -> Array:
    """Weights (D, d) of a node's values by `weights` (D, m), of their rates, and of every extra.

    Rates that say the same of a covariance (D, D) are kept once.
    """
    size = len(weights)
    rated = (np.arange(nodes)[:, None] * dof + np.arange(dof - 12)).ravel()
    rates = np.zeros_like(weights)
    rates[rated + 12] = weights[rated]
    rates /= np.sqrt(np.einsum("im,ij,jm->m", rates, cov, rates)) + 1e-300
    variance, modes = np.linalg.eigh(rates.T @ cov @ rates)
    kept = variance > _FLOOR * variance[-1]
    rates = rates @ (modes[:, kept] / np.sqrt(variance[kept]))
    return np.hstack([weights, rates, np.eye(size)[:, nodes * dof :]])


def reduced(marginals: Marginals, weights: Array) -> Modes:
    """The chain of z = weightsᵀ x with the covariances that x has at neighbouring times."""
    used = np.flatnonzero(np.any(weights != 0.0, axis=1))
    w = weights[used]
    own = marginals.cov[:, :, used] @ w  # cov(x_k, z_k)
    later = marginals.cross[:, :, used] @ w  # cov(x_k, z_k+1)
    earlier = np.swapaxes(marginals.cross[:, used], -1, -2) @ w  # cov(x_k+1, z_k)
    cross = np.block([[own[:-1], later], [earlier, own[1:]]])
    k, size = marginals.cov.shape[0], weights.shape[1]
    z_own = symmetrize(w.T @ own[:, used])
    z_later = w.T @ later[:, used]
    pair = np.block([[z_own[:-1], z_later], [np.swapaxes(z_later, -1, -2), z_own[1:]]])
    inverse = symmetrize(np.asarray(np.linalg.inv(pair)))
    lift = cross @ inverse
    diagonal = np.zeros((k, size, size))
    diagonal[:-1] += inverse[:, :size, :size]
    diagonal[1:] += inverse[:, size:, size:]
    diagonal[1:-1] -= symmetrize(np.asarray(np.linalg.inv(z_own[1:-1])))
    system = BlockTridiagonal(diagonal, np.ascontiguousarray(inverse[:, size:, :size]))
    return Modes(weights, lift, pair, system)
