"""Upper bound of the joint probability that any part of the body hits an obstacle at any moment.

A clearance that is linear in the model error, c + aᵀ e with e ~ N(0, P), is negative with
probability Φ(−c / σ). Hits at neighbouring places and moments are strongly correlated: in a fixed
order of events, a hit counts only if there was no hit at one earlier neighbour, so

    P(any hit) ≤ Σ_i [ P(A_i) − max_j P(A_i A_j) ],

for j among earlier events. Source: Ditlevsen, *Narrow reliability bounds for structural systems*,
J. Struct. Mech. 7 (1979).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, owens_t

from glissando.geometry.se3 import Array
from glissando.model.grid import Index

_LEAST = 1e-9  # probability up to which an event is neglected
_DENSITY = 1.0 / np.sqrt(2.0 * np.pi)
_NEAR = 1.0 - 1e-10  # correlation at most
_BEFORE = ((0, 0, -1), (0, 0, -2), (0, -1, 0), (0, -1, -1), (0, -1, 1), (-1, 0, 0))


@dataclass(frozen=True)
class Clearances:
    """Clearances of N places from O obstacles at K moments, linear in the model error.

    Attributes:
        mean: Expected clearances (O, K, N), m.
        by_error: Jacobians (O, K, N, q) of the clearances by the model error.
        cov: Covariances (K, q, q) of the model error at each moment.
        lagged: Covariances (K−1, q, q) of the model errors at one moment and at the next.
        floor: Standard deviation of an error common to all clearances, besides the model error, m.
    """

    mean: Array
    by_error: Array
    cov: Array
    lagged: Array
    floor: float

    def std(self) -> Array:
        """Standard deviations (O, K, N) of the clearances, m."""
        spread = np.sum((self.by_error @ self.cov) * self.by_error, axis=-1)
        return np.asarray(np.sqrt(np.maximum(spread, 0.0) + self.floor**2))


@dataclass(frozen=True)
class HitBound:
    """An upper bound of the probability of a hit, and its gradients.

    Attributes:
        value: The bound, which may exceed 1.
        by_mean: Gradient (O, K, N) by the expected clearances.
        by_error: Gradient (O, K, N, q) by their Jacobians.
        by_cov: Gradient (K, q, q) by the covariances.
        by_lagged: Gradient (K−1, q, q) by the lagged covariances.
    """

    value: float
    by_mean: Array
    by_error: Array
    by_cov: Array
    by_lagged: Array


def bound_hits(clearances: Clearances) -> HitBound:
    """Upper bound of the probability that any clearance is negative, with its gradients."""
    c = clearances
    std = c.std()
    beta = c.mean / std
    events = np.argwhere(ndtr(-beta) > _LEAST)
    order = np.lexsort((events[:, 0], events[:, 2], events[:, 1]))
    events = events[order]
    rank = np.full(c.mean.shape, -1, dtype=np.intp)
    rank[tuple(events.T)] = np.arange(len(events))
    own, earlier = _pairs(events, rank)
    b = beta[tuple(events.T)]
    s = std[tuple(events.T)]
    a = c.by_error[tuple(events.T)]
    moment = events[:, 1]
    late = moment[own] != moment[earlier]
    mixed = np.empty((own.size, a.shape[1]))  # cov(model error, earlier clearance)
    mixed[~late] = _block_products(c.cov, moment[own[~late]], a[earlier[~late]])
    mixed[late] = _block_products(c.lagged.mT, moment[earlier[late]], a[earlier[late]])
    shared = np.einsum("ei,ei->e", a[own], mixed) + c.floor**2
    rho = np.clip(shared / (s[own] * s[earlier]), -_NEAR, _NEAR)
    both = both_below(-b[own], -b[earlier], rho)
    single = ndtr(-b)
    best = _best_of(own, both, len(events))
    pair = best[best >= 0]
    value = float(single.sum() - both[pair].sum())
    return _slopes(c, events, own[pair], earlier[pair], rho[pair], mixed[pair], value, b, s, a)


def _slopes(
    c: Clearances, events: Index, own: Index, earlier: Index, rho: Array, mixed: Array,
    value: float, b: Array, s: Array, a: Array,
) -> HitBound:  # fmt: skip
    """Gradients of Σ Φ(−β_i) − Σ Φ₂(−β_own, −β_earlier; ρ)."""
    root = np.sqrt(1.0 - rho**2)
    density = _DENSITY * np.exp(-0.5 * b**2)
    by_beta = -density
    to_own = density[own] * ndtr((rho * b[own] - b[earlier]) / root)
    to_earlier = density[earlier] * ndtr((rho * b[earlier] - b[own]) / root)
    np.add.at(by_beta, own, to_own)
    np.add.at(by_beta, earlier, to_earlier)
    square = b[own] ** 2 - 2.0 * rho * b[own] * b[earlier] + b[earlier] ** 2
    by_rho = -np.exp(-0.5 * square / root**2) / (2.0 * np.pi * root)
    by_std = -by_beta * b / s
    np.add.at(by_std, own, -by_rho * rho / s[own])
    np.add.at(by_std, earlier, -by_rho * rho / s[earlier])
    by_variance = 0.5 * by_std / s
    moment = events[:, 1]
    by_error = 2.0 * by_variance[:, None] * _block_products(c.cov, moment, a)
    by_cov, by_lagged = np.zeros_like(c.cov), np.zeros_like(c.lagged)
    np.add.at(by_cov, moment, by_variance[:, None, None] * a[:, :, None] * a[:, None, :])
    by_shared = by_rho / (s[own] * s[earlier])
    np.add.at(by_error, own, by_shared[:, None] * mixed)
    late = moment[own] != moment[earlier]
    weighted = by_shared[:, None] * a[own]
    own_moment, earlier_moment = moment[own], moment[earlier]
    back = np.empty_like(weighted)
    back[~late] = _block_products(c.cov, own_moment[~late], weighted[~late])
    back[late] = _block_products(c.lagged, earlier_moment[late], weighted[late])
    np.add.at(by_error, earlier, back)
    outer = a[earlier][:, :, None] * weighted[:, None, :]
    np.add.at(by_cov, own_moment[~late], 0.5 * (outer[~late] + outer[~late].mT))
    np.add.at(by_lagged, earlier_moment[late], outer[late])
    full_mean, full_error = np.zeros_like(c.mean), np.zeros_like(c.by_error)
    full_mean[tuple(events.T)] = by_beta / s
    full_error[tuple(events.T)] = by_error
    return HitBound(value, full_mean, full_error, by_cov, by_lagged)


def _block_products(blocks: Array, block: Index, rows: Array) -> Array:
    """Products (E, q) of rows (E, q) with the blocks (q, q) selected for each."""
    return (blocks[block] @ rows[..., None])[..., 0]


def _pairs(events: Index, rank: Index) -> tuple[Index, Index]:
    """Pairs of an event and an earlier neighbour, at another obstacle, place or the last moment."""
    own, earlier = [], []
    for shift in _BEFORE:
        neighbour = events + np.array(shift)
        inside = np.all((neighbour >= 0) & (neighbour < rank.shape), axis=1)
        at = np.flatnonzero(inside)
        number = rank[tuple(neighbour[at].T)]
        own.append(at[number >= 0])
        earlier.append(number[number >= 0])
    return np.concatenate(own), np.concatenate(earlier)


def _best_of(own: Index, value: Array, count: int) -> Index:
    """Index (count,) of the pair with the largest value for each event; −1 without a pair."""
    best = np.full(count, -1, dtype=np.intp)
    order = np.lexsort((value, own))
    best[own[order]] = order
    return best


def both_below(x: Array, y: Array, rho: Array) -> Array:
    """P(X < x, Y < y) of standard normal variables with correlations (E,). Source: Owen 1956."""
    x, y = np.where(x == 0.0, 1e-12, x), np.where(y == 0.0, 1e-12, y)
    root = np.sqrt(1.0 - rho**2)
    owen_terms = owens_t(x, (y / x - rho) / root) + owens_t(y, (x / y - rho) / root)
    opposite = np.where(x * y < 0.0, 0.5, 0.0)
    return np.maximum(0.5 * (ndtr(x) + ndtr(y)) - owen_terms - opposite, 0.0)
