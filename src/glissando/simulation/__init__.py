"""Physical simulation of a robot with a sliding sensor, and of its sensors' readings.

The simulator is independent of the estimator's priors, so that estimates can be tested with it.
"""

from glissando.errors import NoShapeError, SimulationError
from glissando.model.slide_path import SlideLimits, SlidePath, read_slide
from glissando.simulation.actuation import Actuation
from glissando.simulation.bench import Bench, load_bench
from glissando.simulation.imperfections import Imperfections
from glissando.simulation.motion import Motion, solve_motion
from glissando.simulation.rod import Loads, Rod, Tendon, Wrench
from glissando.simulation.shape import Section, Shape
from glissando.simulation.simulated_session import Session, simulate_session, write_session
from glissando.simulation.statics import solve_shape

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
