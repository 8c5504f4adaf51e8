"""Model reduction: the few linear combinations of a node's state that the sensor can measure.

Of the state of a time node, those combinations (modes) are kept that change a reading by more than
its noise: a reading at that node, or the prediction of a reading at a neighbouring node, so that
the correlation in time is kept too. They are modelled as a Markov chain with their true covariance
at neighbouring nodes. The uncertainty outside the modes is added at readings and at queries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.priors.transitions import symmetrize
from glissando.solver.block_tridiagonal import BlockTridiagonal, Marginals

_FLOOR = 1e-9  # share of the largest variance, below which there is only rounding
_NEGLIGIBLE = 0.1  # RMS part of a reading, in its standard deviations, that the modes may leave out
_MOST = 32  # largest number of modes


@dataclass(frozen=True)
class Modes:
    """Modes z = weightsᵀ x, d at each time node, and their distribution before future readings.

    Attributes:
        lift: Matrices (K−1, 2 D, 2 d) with E[x | z] = lift z, both stacked for the two ends of a
            time step.
        pair: Covariances (K−1, 2 d, 2 d) of z stacked for both ends of a time step.
        system: Information matrix of z at all times.
    """

    lift: Array
    pair: Array
    system: BlockTridiagonal


def find_modes(marginals: Marginals, rows: Array) -> Modes:
    """Find the modes of a chain that readings at its middle time node can measure.

    Args:
        marginals: Covariances (K, D, D) of the chain's nodes and (K−1, D, D) of neighbours.
        rows: Whitened Jacobians (R, D) of readings at all places of one time node.
    """
    k = (len(marginals.cov) - 1) // 2
    near = [marginals.cross[k]] if k == 0 else [marginals.cross[k], marginals.cross[k - 1].T]
    gains = np.split(np.linalg.solve(marginals.cov[k], np.hstack(near)), len(near), axis=1)
    predicted = [rows @ gain.T for gain in gains]  # predictions of readings at the neighbours
    return _reduced(marginals, _measurable(marginals.cov[k], np.vstack([rows, *predicted])))


def _measurable(cov: Array, rows: Array) -> Array:
    """Weights (D, d) of the modes of a node with covariance (D, D) that rows (R, D) measure.

    The neglected components change the readings by at most `_NEGLIGIBLE` standard deviations of
    their noise in the root mean square, unless `_MOST` limits the number of modes.
    """
    compressed = np.asarray(np.linalg.qr(rows, mode="r"))  # same normal equations, D rows at most
    variance, modes = np.linalg.eigh(compressed @ cov @ compressed.T)
    neglected = np.cumsum(np.maximum(variance, 0.0)) / len(rows)
    measurable = (neglected > _NEGLIGIBLE**2) & (variance > _FLOOR * variance[-1])
    measurable[:-_MOST] = False
    measurable[-1] = True
    return compressed.T @ (modes[:, measurable] / np.sqrt(variance[measurable]))


def _reduced(marginals: Marginals, weights: Array) -> Modes:
    """Markov chain of z = weightsᵀ x whose covariances at neighbouring times are those of x."""
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
