"""The evidence of readings: how likely a prior makes them.

A prior is given as factors. What these leave out is how large their product is over all states,
which depends on the prior's numbers and, where a rod's two ends determine it, on its mechanics.
"""

from __future__ import annotations

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior, load_kernels
from glissando.model.state import State
from glissando.solver.block_tridiagonal import BlockTridiagonal, factor
from glissando.solver.linearize import NormalEquations, linearize
from glissando.solver.located_readings import locate
from glissando.solver.normal_equations import system_shape


def prior_equations(prior: Prior, grid: Grid, state: State, noise_state: State) -> NormalEquations:
    """What the prior alone says of the nodes (K, N) of a state.

    Args:
        prior: The prior.
        grid: The nodes.
        state: Nodes to linearise at.
        noise_state: Nodes whose rates its weights come from.
    """
    load_kernels(prior)
    workspace = np.empty(system_shape(grid.time.size, state.numbers))
    return linearize(prior, locate(grid, [], ()), state, noise_state, workspace)


def proper(prior: Prior, equations: NormalEquations) -> BlockTridiagonal:
    """The system of a prior alone, with a first base of unit variance where it knows none.

    Args:
        prior: The prior.
        equations: What it says alone.
    """
    system = equations.system
    if prior.fixes_base:
        return system
    known = np.zeros(system.diagonal.shape[:2])
    known[0, : equations.state.dof] = 1.0
    return system.add_to_diagonal(known)


def log_normalizer(prior: Prior, grid: Grid, state: State, noise_state: State) -> float:
    """Logarithm of what the prior's factors, each of them normalised, must be multiplied by.

    Source: equation (22).

    Args:
        prior: The prior.
        grid: The nodes.
        state: Nodes to linearise at.
        noise_state: Nodes whose rates its weights come from.

    Raises:
        UnobservableError: The prior alone leaves states undetermined.
    """
    with one_thread():
        alone = prior_equations(prior, grid, state, noise_state)
        log_det = factor(proper(prior, alone)).log_det
    return 0.5 * (log_det + alone.log_det_noise)
