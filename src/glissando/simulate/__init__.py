"""Independent physics: what a robot with a sliding sensor does, and what its sensors would say.

Nothing here knows the estimator's priors, so that an estimate can be judged on it.
"""

from glissando.simulate.rod import Loads, NoShapeError, Rod, SimulationError, Tendon, Wrench
from glissando.simulate.shape import Section, Shape
from glissando.simulate.statics import solve_shape

__all__ = [
    "Loads",
    "NoShapeError",
    "Rod",
    "Section",
    "Shape",
    "SimulationError",
    "Tendon",
    "Wrench",
    "solve_shape",
]
