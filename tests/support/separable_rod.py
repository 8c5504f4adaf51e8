"""A soft rod bent at rest, its separable prior, and the process that it claims to be.

About a still rod of constant strain the prior is that process exactly, at nodes and along
arclength; between time nodes the body's frame moves, and what a cell says errs by the third power
of its duration over the time scale or less. Nothing it says depends on the grid or the duration.
"""

from dataclasses import replace

import numpy as np
import pytest

from draws import motion, sixes
from glissando import Grid
from glissando.model.priors.separable import BaseVariance, SeparablePrior

GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25])
NODES = 12
REST = np.array([0.02, -0.01, 1.03, 1.2, -0.8, 0.5])
PSD = np.array([1e-3, 1.2e-3, 2e-3, 3.0, 4.0, 2.0])
BASE = BaseVariance(
    np.array([1e-4, 2e-4, 1e-4, 1e-2, 2e-2, 1e-2]), np.array([1e-3, 1e-3, 2e-3, 2.0, 1.0, 1.5])
)
SCALE = 0.8
JOINT = 0.25
JUMP = np.array([1e-3, 1e-3, 1e-3, 3.0, 2.0, 0.5])
TWO = {
    "psd_strain_arclength": np.stack([PSD, 0.5 * PSD[[1, 2, 0, 5, 3, 4]]]),
    "joints": np.array([JOINT]),
    "jumps": JUMP[None],
}
PROCESS = {
    "psd": PSD,
    "base_pose_var": BASE.pose,
    "base_strain_var": BASE.strain,
    "time_scale": SCALE,
    "rest_strain": REST,
}
PRIORS = pytest.mark.parametrize("changes", [{}, TWO], ids=["uniform", "two segments"])


def separable(**changes):
    """A prior of a soft rod bent at rest, with every variance different."""
    settings = {
        "psd_strain_arclength": PSD,
        "time_scale": SCALE,
        "base": BASE,
        "rest_strain": REST,
    }
    return SeparablePrior(**{**settings, **changes})


def rated(rng, state):
    """The state with strain rates."""
    return replace(state, strain_rate=sixes(rng, *state.strain.shape[:-1], reach=0.3, angle=3.0))


def moving(rng, grid=GRID):
    """A bent and moving rod on a grid whose neighbours nearly agree."""
    return rated(rng, motion(rng, grid))


def process_of(changes):
    if not changes:
        return PROCESS
    return {**PROCESS, "psd": changes["psd_strain_arclength"], "joints": ((JOINT, JUMP),)}
