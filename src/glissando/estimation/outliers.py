"""Outliers of a recording: readings that all others refute.

A spike beside its own stream's neighbours is left out of the first solve, which it could wreck.
Then each suspicious reading is judged by its innovation against all others, whether it was used or
not. How large innovations of a stream may be is measured on the stream itself: a model that fits a
whole stream badly makes none of its readings an outlier. Source: equation (25).
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
"""By which the innovation of a sound reading would be refused."""

_NEIGHBOURS = 3  # on either side
_CHUNK = 4096  # readings whose neighbours are compared at a time, for their memory
_SPIKE = 10.0  # spreads of its neighbours, and standard deviations, at which a reading is a spike
_LIKELY = 1e-6  # chance of a residual below which a reading is judged
_WORST = 0.2  # of a stream's largest squared innovation: what is refused together
_STIFF = 1e-3  # least share of its variance that a reading leaves to the others

Mask = NDArray[np.bool_]


def spikes(readings: Readings) -> Mask:
    """Readings (M,) far from their neighbours in time; of a tracker, from the line these are on."""
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
    if variance.shape[1] == 6:  # another sensor does not show its roll
        turned = values[:, :3, :3].reshape(count, 9) / np.sqrt(
            2.0
        )  # so that its length is an angle
        out |= _stray(readings.time, turned, variance[:, 3:].sum(axis=1))
    return out


def _stray(time: Array, values: Array, variance: Array, *, level: bool = False) -> Mask:
    """Which values (M, n) with noise of a total variance (M,) are far off a line by neighbours."""
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
    """How far values (M, n) are off a line by their neighbours (M, 6, n), and how far these are.

    The line is `level`, or has the median of slopes between any two of them (Theil and Sen). It is
    less sure beyond them.

    Args:
        when: Times (M, 6) of the neighbours from that of the value.
        around: Their values.
        own: The values.
        level: Whether the line has no slope.
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
    """Labels of streams, told apart: of several that are alike the second is "label 2"."""
    labels = [r.label for r in readings]
    counts = [labels[: i + 1].count(label) for i, label in enumerate(labels)]
    return [label if n == 1 else f"{label} {n}" for label, n in zip(labels, counts, strict=True)]


def used_at_first(readings: Readings, gate: float | None) -> Mask:
    """Which readings (M,) the first solve uses: no spikes, unless nothing is to be left out."""
    if gate is None or readings.loss is not None:
        return np.ones(len(readings), dtype=bool)
    return ~spikes(readings)


def under_touches(prior: Prior, arclength: Array, within: float = np.inf) -> Prior:
    """The prior that judges readings: if it knows mechanics, one of a robot that may be touched.

    Else all readings of a robot that something pushes aside for a while are outliers of a robot
    that nothing touches.

    Args:
        prior: The prior.
        arclength: Nodes (N,), m.
        within: How fast touches come, s, where the prior's loads come more slowly.
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
    """Which readings of each stream the others do not refute.

    Readings that depend on more than one state are kept.

    Args:
        posterior: The estimate.
        solution: Where its iteration ended.
        readings: All readings of each stream.
        used: Which of them (M,) it used.
        gate: Chance of an innovation below which a reading is refuted.
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
    """Readings (M,) with residuals that are unlikely for their stream, of those that were used."""
    out = np.zeros(sound.size, dtype=bool)
    out[sound] = _size(terms) > chi_square_exceedance(_LIKELY, terms.residual.shape[1]) * _scale_of(
        terms
    )
    return out


def unlikely(terms: Residuals) -> Mask:
    """Residuals (M,) that a reading of noise as stated has once in a million times."""
    return _size(terms) > chi_square_exceedance(_LIKELY, terms.residual.shape[1])


def _size(terms: Residuals) -> Array:
    white = terms.whiten(terms.residual)
    return np.einsum("mr,mr->m", white, white)


def _scale_of(terms: Residuals) -> float:
    """By how much a stream's squared residuals are larger than its noise says, 1 or more."""
    if not len(terms.residual):
        return 1.0
    return max(
        1.0, float(np.median(_size(terms))) / chi_square_exceedance(0.5, terms.residual.shape[1])
    )


def _refuted(posterior: Posterior, readings: Readings, used: Mask, limit: float) -> Mask:
    """Which readings (M,) all others refute: squared innovations beyond a limit.

    Of those that were used only the worst, as a wrong one makes its neighbours look wrong.

    Args:
        posterior: The estimate.
        readings: Readings of one stream.
        used: Which of them were used for the estimate.
        limit: Largest squared innovation that is believed.
    """
    try:
        squared = fit_of(posterior, readings).squared(used, _STIFF)
    except np.linalg.LinAlgError:  # of a state that is absurd, which judges nobody
        return np.zeros(len(readings), dtype=bool)
    return np.asarray(squared > np.where(used, max(limit, _WORST * squared.max()), limit))
