"""The published white-noise factors along arclength, as a prior that our estimator takes.

The error of an interval of length h is ``[xi - h strain0 ; Jr^-1(xi) strain1 - strain0]`` with
``xi = log(T0^-1 T1)``, its covariance that of six independent integrated white noises: GTSAM's
factor, see `gtsam_wnoa`, here with its exact Jacobian.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from glissando import State, WhiteNoisePrior
from glissando.geometry import se3
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid
from glissando.model.noise import sqrt_information


class PublishedStatic(WhiteNoisePrior):
    """A kinematic prior of single moments with the published factors along arclength."""

    def factors(self, grid: Grid, state: State, about: State, times: slice) -> Iterator[Factors]:
        """Those of the kinematic prior, intervals of pose and strain replaced."""
        for batch in super().factors(grid, state, about, times):
            if batch.terms.residual.shape[1] == 12:
                yield self._interval(grid, state, batch)
            else:
                yield batch

    def _interval(self, grid: Grid, state: State, batch: Factors) -> Factors:
        flat = state.flatten()
        start, end = flat.take(batch.nodes[:, 0]), flat.take(batch.nodes[:, 1])
        h = np.diff(grid.arclength)[batch.nodes[:, 0] % grid.arclength.size][:, None]
        xi = se3.log(se3.inverse(start.pose) @ end.pose)
        spread = se3.right_jacobian_inverse(xi)
        back = se3.adjoint(se3.inverse(end.pose) @ start.pose)
        carried = np.einsum("mij,mj->mi", spread, end.strain)
        bend = -spread @ se3.right_jacobian_slope(xi, carried)
        error = np.concatenate([xi - h * start.strain, carried - start.strain], axis=1)
        jacobian = np.zeros((len(h), 12, 2, 12))
        jacobian[:, :6, 0, :6], jacobian[:, :6, 1, :6] = -spread @ back, spread
        jacobian[:, 6:, 0, :6], jacobian[:, 6:, 1, :6] = -bend @ spread @ back, bend @ spread
        jacobian[:, :6, 0, 6:] = -h[:, :, None] * np.eye(6)
        jacobian[:, 6:, 0, 6:], jacobian[:, 6:, 1, 6:] = -np.eye(6), spread
        psd = np.diag(self.psd_strain_arclength)
        powers = np.array([[h**3 / 3.0, h**2 / 2.0], [h**2 / 2.0, h]])[..., 0]
        cov = np.einsum("ijm,ab->miajb", powers, psd).reshape(-1, 12, 12)
        return Factors(batch.nodes, slice(0, 12), jacobian, Residuals(error, sqrt_information(cov)))
