"""The slope of the log-determinant is that of finite differences of whole systems."""

import numpy as np
import pytest

from glissando import CoilReadings
from glissando.estimation.log_det_slope import log_det_slope
from glissando.model.priors.prior import load_kernels
from glissando.solver.block_tridiagonal import Marginals, factor
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate
from mechanical_rod import GRID, NODES_S, mechanical, moving


@pytest.mark.parametrize("seed", range(3))
def test_the_slope_is_that_of_whole_systems(seed):
    rng, prior = np.random.default_rng(seed), mechanical()
    load_kernels(prior)
    state, time = moving(rng, prior), GRID.time
    places = np.full(time.size, NODES_S[-1])
    cov = np.repeat([1e-6, 1e-4], [3, 2])
    coil = CoilReadings(time=time, arclength=places, values=state.pose[:, -1], cov=cov)
    located, none = locate(GRID, [coil]), locate(GRID, [])

    def volume(step):
        at = state.retract(step)
        every, alone = (factor(linearize(prior, r, at, at).system) for r in (located, none))
        return 0.5 * (every.log_det - alone.log_det)

    parts = [factor(linearize(prior, r, state, state).system).marginals() for r in (located, none)]
    added = Marginals(parts[0].cov - parts[1].cov, parts[0].cross - parts[1].cross)
    slope = log_det_slope(prior, GRID, state, added)
    std = np.sqrt(np.einsum("kii->ki", parts[0].cov)).reshape(slope.shape)
    step = np.zeros(slope.shape)
    step[..., 8] = 0.1 * std[0, :, 8] * rng.standard_normal(GRID.shape[1])
    whole = 0.5 * (volume(step) - volume(-step))
    assert np.vdot(slope, step) == pytest.approx(whole, rel=0.01, abs=1e-6)
