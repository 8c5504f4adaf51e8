"""A body's shape in few numbers: what the sensor can tell of it, now and soon.

Of all numbers of a time node those combinations are kept that move some reading by more than its
noise, before any reading of the time ahead: a reading at that node, or what is expected of one at a
neighbouring node, so that what links the times is kept as well. They are taken for a Markov chain
of their own, with their true covariance at neighbouring nodes. What they leave uncertain stays
where it matters, at readings and at queries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.priors.transitions import symmetrize
from glissando.solver.block_tridiagonal import BlockTridiagonal, Marginals

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


def near_in_time(marginals: Marginals, k: int, rows: Array) -> Array:
    """Rows of the state at time node k: these (R, D), and what it says of them nearby.

    That is what is expected of the same readings one time node later, and one earlier if there is.
    """
    near = [marginals.cross[k]] if k == 0 else [marginals.cross[k], marginals.cross[k - 1].T]
    gains = np.split(np.linalg.solve(marginals.cov[k], np.hstack(near)), len(near), axis=1)
    return np.vstack([rows, *(rows @ gain.T for gain in gains)])


def telling_weights(cov: Array, rows: Array, least: float, most: int) -> Array:
    """Weights (D, d) of the combinations that readings can tell of a node's covariance (D, D).

    `rows` (R, D) are whitened Jacobians of readings everywhere; the components that are left out
    move them by `least` standard deviations of their noise at most, in the root mean square, unless
    there are more than `most`.
    """
    few = np.asarray(np.linalg.qr(rows, mode="r"))  # the same squares in D rows at most
    variance, modes = np.linalg.eigh(few @ cov @ few.T)
    left = np.cumsum(np.maximum(variance, 0.0)) / len(rows)
    kept = (left > least**2) & (variance > _FLOOR * variance[-1])
    kept[:-most] = False
    kept[-1] = True
    return few.T @ (modes[:, kept] / np.sqrt(variance[kept]))


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
