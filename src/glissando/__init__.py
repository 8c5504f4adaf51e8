"""Where every part of a continuum robot is, at every moment, and how sure.

A recording's readings and a Gaussian prior, continuous in arclength and time, become a posterior:
pose, strain and velocity with their covariance anywhere along the robot, any time.

>>> import numpy as np
>>> from glissando import CoilReadings, load_robot, estimate, uniform_grid
>>> robot = load_robot("tdcr466")
>>> grid = uniform_grid(robot.length, nodes=5, start=0.0, stop=1.0, rate=10.0)
>>> tip = np.tile(np.eye(4), (11, 1, 1))
>>> tip[:, 2, 3] = 0.466
>>> coil = CoilReadings(time=np.linspace(0, 1, 11), arclength=np.full(11, 0.466), values=tip,
...                     cov=[1e-6, 1e-6, 1e-6, 1e-4, 1e-4])
>>> posterior = estimate(robot.prior, grid, [coil])
>>> at = posterior.at(arclength=[0.233, 0.466], time=0.5)
>>> bool(at.std_position[1] < at.std_position[0])  # surest where the coil is
True
"""

from glissando.errors import (
    GlissandoError,
    NotConvergedWarning,
    OutsideGridError,
    RecordingError,
    RobotFileError,
    SensorError,
    UnobservableError,
)
from glissando.estimation.batch import SolverOptions, estimate
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

__version__ = "0.1.0"
