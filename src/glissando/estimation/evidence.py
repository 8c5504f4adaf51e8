"""Normaliser of a prior, for the evidence of readings.

A prior is given as factors. The integral of their product over all states is not 1: it depends on
the prior's parameters and, where a rod's two ends determine it, on its mechanics.
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.errors import UnobservableError
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior, load_kernels
from glissando.model.state import State
from glissando.solver.block_tridiagonal import factor
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate
from glissando.solver.square_root import root_information


def log_normalizer(prior: Prior, grid: Grid, state: State, noise_state: State) -> float:
    """Logarithm of the constant that normalises the product of the prior's normalised factors.

    Source: equation (22).

    Args:
        prior: The prior.
        grid: The nodes.
        state: Nodes (K, N) to linearise at.
        noise_state: Nodes (K, N) from whose rates the weights are computed.

    Raises:
        UnobservableError: The prior alone leaves states undetermined.
    """
    load_kernels(prior)
    with one_thread():
        equations = linearize(prior, locate(grid, []), state, noise_state)
        base_info = np.zeros(equations.system.diagonal.shape[:2])
        if not prior.fixes_base:
            base_info[0, : state.dof] = 1.0  # the first base, with unit variance
        try:
            log_det = factor(equations.system.add_to_diagonal(base_info)).log_det
        except (np.linalg.LinAlgError, UnobservableError):
            if not prior.fixes_base:
                raise
            every = prior.factors(grid, state, noise_state, slice(0, grid.time.size))
            root = root_information(every, grid.shape, state.dof)  # has twice the digits
            diagonal = np.abs(np.diagonal(root.diagonal, axis1=1, axis2=2))
            log_det = 2.0 * float(np.log(diagonal).sum())
    return 0.5 * (log_det + equations.log_det_noise)
