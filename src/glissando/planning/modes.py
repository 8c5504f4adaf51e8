"""Model reduction: the few combinations of a node's numbers that the sensor can measure.

Of all numbers of a time node, those combinations are kept that move some reading by more than its
noise: a reading at that node, or what is expected of a reading at a neighbouring node, so that the
link between times is kept as well. They are treated as a Markov chain of their own, with their true
covariance at neighbouring nodes. What they leave uncertain is added at readings and at queries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.priors.transitions import symmetrize
from glissando.solver.block_tridiagonal import BlockTridiagonal, Marginals

_FLOOR = 1e-9  # of the largest variance: below it there is only rounding
_LEFT = 0.1  # standard deviations of a reading that the modes may leave, in the root mean square
_MOST = 32  # modes at most


@dataclass(frozen=True)
class Modes:
    """The d numbers z = weightsᵀ x of each time node, before any reading to come.

    Attributes:
        lift: E[x | z] of both ends of a time step, x, as functions of z there (K−1, 2 D, 2 d).
        pair: Covariance of z at both ends of a time step (K−1, 2 d, 2 d).
        system: Information of z at all times.
    """

    lift: Array
    pair: Array
    system: BlockTridiagonal


def find_modes(marginals: Marginals, rows: Array) -> Modes:
    """The modes of a chain that readings in the middle of its time can measure.

    Args:
        marginals: Covariances of the chain's nodes (K, D, D) and of neighbours.
        rows: Whitened Jacobians (R, D) of readings everywhere at a time node.
    """
    k = (len(marginals.cov) - 1) // 2
    near = [marginals.cross[k]] if k == 0 else [marginals.cross[k], marginals.cross[k - 1].T]
    gains = np.split(np.linalg.solve(marginals.cov[k], np.hstack(near)), len(near), axis=1)
    predicted = [rows @ gain.T for gain in gains]  # such readings at the neighbouring nodes
    return _reduced(marginals, _measurable(marginals.cov[k], np.vstack([rows, *predicted])))


def _measurable(cov: Array, rows: Array) -> Array:
    """Weights (D, d) of the combinations of a node of covariance (D, D) that rows (R, D) measure.

    The components that are left out move the readings by `_LEFT` standard deviations of their noise
    at most, unless there are more than `_MOST` others.
    """
    few = np.asarray(np.linalg.qr(rows, mode="r"))  # the same squares in D rows at most
    variance, modes = np.linalg.eigh(few @ cov @ few.T)
    left = np.cumsum(np.maximum(variance, 0.0)) / len(rows)
    measurable = (left > _LEFT**2) & (variance > _FLOOR * variance[-1])
    measurable[:-_MOST] = False
    measurable[-1] = True
    return few.T @ (modes[:, measurable] / np.sqrt(variance[measurable]))


def _reduced(marginals: Marginals, weights: Array) -> Modes:
    """The chain of z = weightsᵀ x with the covariances that x has at neighbouring times."""
    used = np.flatnonzero(np.any(weights != 0.0, axis=1))
    w = weights[used]
    own = marginals.cov[:, :, used] @ w  # cov(x_k, z_k)
    later = marginals.cross[:, :, used] @ w  # cov(x_k, z_k+1)
    earlier = marginals.cross[:, used].mT @ w  # cov(x_k+1, z_k)
    cross = np.block([[own[:-1], later], [earlier, own[1:]]])
    size = weights.shape[1]
    z_own = symmetrize(w.T @ own[:, used])
    z_later = w.T @ later[:, used]
    pair = np.block([[z_own[:-1], z_later], [z_later.mT, z_own[1:]]])
    inverse = symmetrize(np.asarray(np.linalg.inv(pair)))
    diagonal = np.zeros_like(z_own)
    diagonal[:-1] += inverse[:, :size, :size]
    diagonal[1:] += inverse[:, size:, size:]
    diagonal[1:-1] -= symmetrize(np.asarray(np.linalg.inv(z_own[1:-1])))
    system = BlockTridiagonal(diagonal, np.ascontiguousarray(inverse[:, size:, :size]))
    return Modes(cross @ inverse, pair, system)
