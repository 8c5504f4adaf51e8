"""Independent physics: what a robot with a sliding sensor does, and what its sensors would say.

Nothing here knows the estimator's priors, so that an estimate can be judged on it.
"""

from glissando.simulate.bench import Actuation, Bench, load_bench
from glissando.simulate.imperfections import Imperfections
from glissando.simulate.motion import Motion, solve_motion
from glissando.simulate.rod import Loads, NoShapeError, Rod, SimulationError, Tendon, Wrench
from glissando.simulate.session import Session, simulate_session, write_session
from glissando.simulate.shape import Section, Shape
from glissando.simulate.slide import SlideLimits, SlidePath, read_slide
from glissando.simulate.statics import solve_shape

__all__ = [
    "Actuation",
    "Bench",
    "Imperfections",
    "Loads",
    "Motion",
    "NoShapeError",
    "Rod",
    "Section",
    "Session",
    "Shape",
    "SimulationError",
    "SlideLimits",
    "SlidePath",
    "Tendon",
    "Wrench",
    "load_bench",
    "read_slide",
    "simulate_session",
    "solve_motion",
    "solve_shape",
    "write_session",
]
