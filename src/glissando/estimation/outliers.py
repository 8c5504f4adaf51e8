"""Outliers of a recording: readings that all others refute.

A spike among its neighbours in a stream is left out of the first solution, which it could spoil.
Then each suspicious reading is tested by its innovation against all others, whether it was used or
not. The scale of a stream's innovations is estimated from the stream: where a model fits a whole
stream badly, none of its readings is an outlier. Source: equation (25).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glissando.estimation.contact import bending_force
from glissando.estimation.posterior import Posterior
from glissando.estimation.reading_fit import fit_of
from glissando.geometry.se3 import Array
from glissando.model.factors import Residuals
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior
from glissando.model.quantiles import chi_square_exceedance
from glissando.model.sensors.readings import Readings
from glissando.solver.gauss_newton import Solution

CHANCE = 1e-9
"""Probability with which a sound reading is refused by its innovation."""

_NEIGHBOURS = 3  # number on either side
_CHUNK = 4096  # readings whose neighbours are compared at a time, for their memory
_SPIKE = 10.0  # times spread of the neighbours plus standard deviation, beyond which it is a spike
_LIKELY = 1e-6  # probability of a residual below which a reading is tested
_WORST = 0.2  # share of a stream's largest squared innovation above which readings are refused
_STIFF = 1e-3  # lower bound on S of `ReadingFit.squared`

Mask = NDArray[np.bool_]


def spikes(readings: Readings) -> Mask:
    """Mask (M,) of readings far from neighbours in time; of a tracker, from a line through them."""
    count, values = len(readings), readings.values
    if count <= 2 * _NEIGHBOURS or not values.size or values.shape[1:] == (3, 3):
        return np.zeros(count, dtype=bool)
    variance = np.diagonal(
        np.broadcast_to(readings.cov, (count, *readings.cov.shape[-2:])), 0, 1, 2
    )
    if values.shape[1:] != (4, 4):
        flat = values.reshape(count, -1)
        noise = variance[:, : flat.shape[1]].sum(axis=1)
        return _stray(readings.time, flat, noise, level=not readings.tracker)
    out = _stray(readings.time, values[:, :3, 3], variance[:, :3].sum(axis=1))
    if variance.shape[1] == 6:  # other sensors do not measure roll
        turned = values[:, :3, :3].reshape(count, 9) / np.sqrt(
            2.0
        )  # so that its length is an angle
        out |= _stray(readings.time, turned, variance[:, 3:].sum(axis=1))
    return out


def _stray(time: Array, values: Array, variance: Array, *, level: bool = False) -> Mask:
    """Mask of values (M, n), of total noise variance (M,), far off a line through neighbours."""
    count, wide = len(time), 2 * _NEIGHBOURS
    order = np.argsort(time, kind="stable")
    time, values = time[order], values[order]
    first = np.clip(np.arange(count) - _NEIGHBOURS, 0, count - wide - 1)
    near = first[:, None] + np.arange(wide + 1)
    near = near[near != np.arange(count)[:, None]].reshape(count, wide)  # all but itself
    off, spread = np.empty(count), np.empty(count)
    for begin in range(0, count, _CHUNK):
        rows = slice(begin, begin + _CHUNK)
        when = time[near[rows]] - time[rows, None]
        off[rows], spread[rows] = _off_line(when, values[near[rows]], values[rows], level=level)
    out = np.zeros(count, dtype=bool)
    out[order] = off > _SPIKE * (spread + np.sqrt(variance[order]))
    return out


def _off_line(when: Array, around: Array, own: Array, *, level: bool) -> tuple[Array, Array]:
    """Distances of values (M, n) from a line through their neighbours, and spread of these.

    The line is `level`, or has the median of the slopes between any two neighbours (Theil and Sen).
    The spread grows with the uncertainty of the slope where the line is extrapolated.

    Args:
        when: Times (M, 6) of the neighbours relative to that of the value.
        around: Values (M, 6, n) of the neighbours.
        own: The values.
        level: Whether the line has zero slope.
    """
    unsure = np.zeros(len(own))
    if not level:
        a, b = np.triu_indices(when.shape[1], 1)
        step, rise = (when[:, b] - when[:, a])[..., None], around[:, b] - around[:, a]
        slopes = np.divide(rise, step, out=np.zeros_like(rise), where=step > 0.0)
        slope = np.median(slopes, axis=1)[:, None]
        unsure = np.median(np.linalg.norm(slopes - slope, axis=2), axis=1)
        around = around - slope * when[..., None]
    middle = np.median(around, axis=1)
    spread = np.median(np.linalg.norm(around - middle[:, None], axis=2), axis=1)
    spread += np.abs(when.mean(axis=1)) * unsure
    return np.linalg.norm(own - middle, axis=1), spread


def distinct_labels(readings: Sequence[Readings]) -> list[str]:
    """Labels of streams, made distinct: the second of several equal ones is "label 2"."""
    labels = [r.label for r in readings]
    counts = [labels[: i + 1].count(label) for i, label in enumerate(labels)]
    return [label if n == 1 else f"{label} {n}" for label, n in zip(labels, counts, strict=True)]


def used_at_first(readings: Readings, gate: float | None) -> Mask:
    """Mask (M,) of readings for the first solution: no spikes, if there is a gate and no loss."""
    if gate is None or readings.loss is not None:
        return np.ones(len(readings), dtype=bool)
    return ~spikes(readings)


def under_touches(prior: Prior, arclength: Array, within: float = np.inf) -> Prior:
    """Prior by which readings are tested: a mechanical prior with contact forces added, or `prior`.

    Without these forces all readings of a robot that is pushed aside for a while would be outliers.

    Args:
        prior: The prior.
        arclength: Nodes (N,), m.
        within: Time scale of contacts, s, if that of the prior's loads is longer.
    """
    if not isinstance(prior, MechanicalPrior):
        return prior
    force = bending_force(prior, arclength) ** 2 / float(arclength[-1])
    return replace(
        prior,
        psd_load=prior.psd_load + np.repeat([force, 0.0], 3),
        time_scale=min(prior.time_scale, within),
    )


def judged(
    posterior: Posterior,
    solution: Solution,
    readings: Sequence[Readings],
    used: Sequence[Mask],
    gate: float,
) -> list[Mask]:
    """Masks of the readings of each stream that the others do not refute.

    Readings that depend on more than one state are kept.

    Args:
        posterior: The estimate.
        solution: Solution from which the estimate was computed.
        readings: All readings of each stream.
        used: Masks (M,) of those that the estimate used.
        gate: Probability of an innovation below which a reading is refuted.
    """
    streams, out = iter(solution.equations.reading_terms()), []
    for stream, rows in zip(readings, used, strict=True):
        terms = next(streams) if rows.any() else None
        believed = rows.copy()
        if stream.loss is None and stream.reads_one_state and terms is not None:
            suspects = np.flatnonzero(~rows | _suspects(terms, rows))
            limit = chi_square_exceedance(gate, terms.residual.shape[1]) * _scale_of(terms)
            if suspects.size:
                believed[suspects] = ~_refuted(
                    posterior, stream.select(suspects), rows[suspects], limit
                )
        out.append(believed)
    return out


def _suspects(terms: Residuals, sound: Mask) -> Mask:
    """Mask (M,) of used readings whose residuals are unlikely for their stream."""
    out = np.zeros(sound.size, dtype=bool)
    out[sound] = _size(terms) > chi_square_exceedance(_LIKELY, terms.residual.shape[1]) * _scale_of(
        terms
    )
    return out


def unlikely(terms: Residuals) -> Mask:
    """Mask (M,) of residuals that the stated noise exceeds once in a million readings."""
    return _size(terms) > chi_square_exceedance(_LIKELY, terms.residual.shape[1])


def _size(terms: Residuals) -> Array:
    white = terms.whiten(terms.residual)
    return np.einsum("mr,mr->m", white, white)


def _scale_of(terms: Residuals) -> float:
    """Ratio of a stream's squared residuals to those of its stated noise, 1 or more."""
    if not len(terms.residual):
        return 1.0
    return max(
        1.0, float(np.median(_size(terms))) / chi_square_exceedance(0.5, terms.residual.shape[1])
    )


def _refuted(posterior: Posterior, readings: Readings, used: Mask, limit: float) -> Mask:
    """Mask (M,) of readings that all others refute: squared innovations beyond a limit.

    Of those that were used only the worst count, as an outlier makes its neighbours seem wrong.

    Args:
        posterior: The estimate.
        readings: Readings of one stream.
        used: Mask (M,) of those that the estimate used.
        limit: Largest squared innovation that is accepted.
    """
    try:
        squared = fit_of(posterior, readings).squared(used, _STIFF)
    except np.linalg.LinAlgError:  # the state is absurd and refutes no reading
        return np.zeros(len(readings), dtype=bool)
    return np.asarray(squared > np.where(used, max(limit, _WORST * squared.max()), limit))
