"""Agreement of readings with an estimate, from the same factors by which it was solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glissando.estimation.channels import placed
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.sensors.readings import Readings
from glissando.model.short_repr import ShortRepr
from glissando.solver.block_tridiagonal import Marginals
from glissando.solver.located_readings import locate
from glissando.solver.measurement_factors import measurement_factors

_CHUNK = 200  # readings at a time, to bound memory


@dataclass(frozen=True)
class ReadingFit(ShortRepr):
    """Residuals of M readings, in units of each reading's own uncertainty.

    Attributes:
        residual: Residuals (M, r), whitened by noise, an uncertain place, and interpolation.
        explained: Covariance (M, r, r), in the same units, of the readings' prediction by states
            and sensor parameters; delays, which follow from motion, count as known where readings
            of the stream were used.
        weight: Robust weights (M,) of the readings where they are used.
    """

    residual: Array
    explained: Array
    weight: Array

    def squared(self, used: NDArray[np.bool_] | bool, least: float) -> Array:
        """Squared innovations (M,) against all other readings, normalised by their covariance.

        With G the covariance `explained`, the residual e of a reading of weight w would be S⁻¹ e
        without that reading, S = 1 − w G, and its covariance S⁻¹ (S + G). With w = 1 the square is
        eᵀ (1 − G)⁻¹ e (equation 25); for a reading that was not used it is eᵀ (1 + G)⁻¹ e.

        Args:
            used: Mask of the readings that were used: one for all, or (M,).
            least: Lower bound on S, below which rounding and the solver's tolerance dominate.
        """
        share, axes = np.linalg.eigh(self.explained)
        remaining = 1.0 - np.where(used, self.weight, 0.0)[:, None] * share
        remaining = np.maximum(remaining, least)
        along = np.einsum("mji,mj->mi", axes, self.residual)
        return np.einsum("mi,mi->m", along / (remaining * (remaining + share)), along)

    def white(self) -> Array:
        """Whitened innovations (M, r) of readings that were not used."""
        share, axes = np.linalg.eigh(self.explained)
        along = np.einsum("mji,mj->mi", axes, self.residual) / np.sqrt(1.0 + share)
        return np.einsum("mij,mj->mi", axes, along)


def fit_of(posterior: Posterior, readings: Readings, *, predicted: bool = False) -> ReadingFit:
    """Agreement of readings with an estimate, whether it used them or not.

    Args:
        posterior: The estimate.
        readings: Readings of one stream, corrected for known sensor parameters; those off the grid
            are clamped to its ends.
        predicted: Whether none of the stream was used: then the uncertainty of delays counts, too.
    """
    grid = posterior.grid
    marginals = posterior.marginals if predicted else posterior.marginals_of_known_delays
    (readings,) = placed([readings], posterior)
    readings = readings.changed(
        arclength=np.clip(readings.arclength, grid.arclength[0], grid.arclength[-1]),
        time=np.clip(readings.time, grid.time[0], grid.time[-1]),
    )
    count, r = len(readings), readings.row_count
    residual, explained, weight = np.zeros((count, r)), np.zeros((count, r, r)), np.ones(count)
    parameters = [parameter for parameter, _ in posterior.sensor_parameters]
    of_each = [np.zeros((grid.time.size, 0)), *(v for _, v in posterior.sensor_parameters)]
    values = np.concatenate(of_each, axis=1)
    for first in range(0, count, _CHUNK):
        part = readings.select(slice(first, first + _CHUNK))
        located = locate(grid, [part], parameters, values, keep_all=True)
        at = posterior.prior, located, posterior.state, posterior.state
        for _, rows, batch in measurement_factors(*at):
            whitener = batch.terms.sqrt_info
            cov = whitener @ _explained(posterior, marginals, batch) @ np.swapaxes(whitener, -1, -2)
            residual[first + rows] = batch.terms.whiten(batch.terms.residual)
            explained[first + rows] = 0.5 * (cov + np.swapaxes(cov, -1, -2))
            weight[first + rows] = batch.terms.robust_weights()
    return ReadingFit(residual, explained, weight)


def _explained(posterior: Posterior, marginals: Marginals, batch: Factors) -> Array:
    """Covariance (M, r, r) of residuals from the unknowns at both ends of their time interval."""
    count, inner = posterior.grid.shape
    size, dof = posterior.marginals.cov.shape[-1], posterior.state.dof
    m, r, c, d = batch.jacobian.shape
    slab, node = np.divmod(batch.nodes, inner)
    lower = slab.min(axis=1)
    if batch.extras is not None:
        lower = np.minimum(lower, max(count - 2, 0))
    slopes, rows = np.zeros((m, 2, size, r)), np.arange(m)[:, None]
    for j in range(c):
        columns = node[:, j, None] * dof + batch.dofs.start + np.arange(d)
        within = slab[:, j] < count  # nodes beyond the last have no weight
        end = np.where(within, slab[:, j] - lower, 0)[:, None]
        part = np.where(within[:, None, None], batch.jacobian[:, :, j].swapaxes(1, 2), 0.0)
        slopes[rows, end, columns] += part
    if batch.extras is not None:
        own = batch.extras.swapaxes(1, 2).reshape(m, 2, -1, r)
        slopes[:, :, size - own.shape[2] :] += own
    slabs = np.stack([lower, np.minimum(lower + 1, count - 1)], axis=1)
    slopes = np.ascontiguousarray(slopes.transpose(0, 3, 1, 2))
    return marginals.spread(slabs, np.zeros_like(slabs), slopes, np.zeros((m, r, r)))
