"""A rod that something may push, by the simulator, and a coil's readings along it."""

import numpy as np

from glissando import CoilReadings
from glissando.geometry import se3
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Loads, Rod, Wrench, solve_shape

LENGTH, NODES = 0.5, np.linspace(0.0, 0.5, 8)
ROD = Rod.of_tubes(LENGTH, [(1.2e-3, 0.0)], young=60e9, poisson=0.33, density=6450.0)
GRAVITY = np.array([0.0, 0.0, 9.81])
NOISE = np.repeat([0.7e-3, 7e-3], [3, 2])
PLACES = np.linspace(0.1, 1.0, 8) * LENGTH
STD = [0.3, 0.3, 0.1]
FORCE, WHERE = np.array([0.1, -0.06, 0.0]), 0.31
PRIOR = MechanicalPrior(
    Mechanics(ROD.stiffness[None], np.array([ROD.mass_per_length]), gravity=GRAVITY),
    psd_load=np.repeat([1e-5, 1e-9], 3),
    psd_strain_error=np.repeat([1e-10, 1e-6], 3),
    var_tip=np.repeat([1e-6, 1e-10], 3),
    time_scale=1.0,
    var_base=np.full(6, 1e-10),
)


def shape(force, where=WHERE):
    """The rod under this force."""
    return solve_shape(ROD, [], Loads(gravity=GRAVITY, wrenches=[Wrench(where, force)]))


def coil(rng, bent, times=(0.0,)):
    """A coil's readings along the rod at some times."""
    time = np.repeat(times, PLACES.size)
    off = np.zeros((time.size, 6))
    off[:, :5] = NOISE * rng.standard_normal((time.size, 5))
    place = np.tile(PLACES, len(times))
    values = bent.at(place).pose @ se3.exp(off)
    return CoilReadings(time=time, arclength=place, values=values, cov=NOISE**2)


def joined(parts):
    """Readings of some times as those of one coil."""
    whole = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("time", "arclength", "values")
    }
    return CoilReadings(**whole, cov=NOISE**2)
