"""The names of the package; `__init__.py` imports the module of each when it is first used."""

from glissando.errors import (
    GlissandoError,
    NotConvergedWarning,
    OutsideGridError,
    RecordingError,
    RobotFileError,
    SensorError,
    UnobservableError,
)
from glissando.estimation.batch import estimate
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.posterior import Posterior, StateEstimate
from glissando.estimation.static import StaticPosterior, estimate_static
from glissando.geometry import se3 as se3
from glissando.io.netcdf import load_posterior, save_posterior, to_xarray
from glissando.io.robot_file import load_robot
from glissando.model.grid import Grid, uniform_grid
from glissando.model.noise import GemanMcClure, Huber
from glissando.model.priors.separable import BaseVariance, SeparablePrior
from glissando.model.priors.white_noise import BaseDensity, WhiteNoisePrior
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import (
    CoilReadings,
    FbgReadings,
    GyroReadings,
    OrientationReadings,
    PoseReadings,
    PositionReadings,
    StrainReadings,
)
from glissando.model.state import State
from glissando.solver.gauss_newton import SolverOptions

__all__ = [
    "BaseDensity",
    "BaseVariance",
    "CoilReadings",
    "FbgReadings",
    "FixedLagSmoother",
    "GemanMcClure",
    "GlissandoError",
    "Grid",
    "GyroReadings",
    "Huber",
    "NotConvergedWarning",
    "OrientationReadings",
    "OutsideGridError",
    "PoseReadings",
    "PositionReadings",
    "Posterior",
    "Readings",
    "RecordingError",
    "Robot",
    "RobotFileError",
    "SensorError",
    "SensorParameter",
    "SeparablePrior",
    "SolverOptions",
    "State",
    "StateEstimate",
    "StaticPosterior",
    "StrainReadings",
    "UnobservableError",
    "WhiteNoisePrior",
    "estimate",
    "estimate_static",
    "load_posterior",
    "load_robot",
    "save_posterior",
    "to_xarray",
    "uniform_grid",
]

__version__: str
