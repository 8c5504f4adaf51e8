"""A rod of two segments under weight and unknown loads, and random states of it."""

import numpy as np

from draws import sixes
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.mechanics import Mechanics, tube_section
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.state import State

JOINT, POINT = 0.15, 0.3
NODES_S = np.array([0.0, 0.08, JOINT, 0.22, POINT, 0.4])
GRID = Grid(NODES_S, [0.0, 0.1, 0.25])
STEEL = {"young": 200e9, "poisson": 0.33}


def mechanical(**changes):
    """A steel rod, thinner beyond its joint, with a tool; a load may act at 0.3 m."""
    rows = np.stack([tube_section([(d, 0.0)], **STEEL) for d in (2.0e-3, 1.6e-3)])
    mechanics = Mechanics(
        rows,
        mass_per_length=np.array([0.025, 0.016]),
        joints=np.array([JOINT]),
        gravity=np.array([1.0, -2.0, -9.0]),
        tip_mass=3e-3,
        tip_center=np.array([1e-3, 0.0, 8e-3]),
    )
    fields = {
        "mechanics": mechanics,
        "psd_load": np.repeat([1e-2, 1e-5], 3),
        "psd_strain_error": np.repeat([1e-9, 1e-5], 3),
        "var_tip": np.repeat([1e-2, 1e-4], 3),
        "time_scale": 0.6,
        "var_base": np.repeat([1e-8, 1e-6], 3),
        "rest_strain": np.array([[0, 0, 1, 0.5, 0, 0.1], [0, 0, 1, 0, -0.3, 0]]),
        "rest_slope": np.array([[0, 0, 0, 1.0, 0, 0], [0, 0, 0, 0, 0.4, 0]]),
        "points": np.array([POINT]),
        "var_points": np.repeat([[0.04, 1e-4]], 3, axis=1),
    }
    return MechanicalPrior(**(fields | changes))


def moving(rng, prior, grid=GRID):
    """A state some way from rest, of strains that wrenches of a newton make."""
    rest = prior.rest_state(grid)
    shape = rest.strain.shape
    loads = rng.standard_normal(shape) * np.repeat([1.0, 0.1], 3)
    _, stiffness = prior.rod.wrench(rest.strain, np.broadcast_to(grid.arclength, grid.shape))
    rate = rng.standard_normal(shape) * np.repeat([1.0, 0.1], 3) / stiffness
    return State(
        rest.pose @ se3.exp(sixes(rng, *grid.shape, reach=0.05)),
        rest.strain + loads / stiffness,
        0.3 * rng.standard_normal(shape),
        rate,
    )
