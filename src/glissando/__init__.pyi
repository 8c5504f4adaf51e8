"""The names of the package; `__init__.py` imports the module of each when it is first used."""

from .errors import FalseConfidenceWarning, GlissandoError, NotConvergedWarning
from .estimation.batch import estimate
from .estimation.fixed_lag import FixedLagSmoother
from .estimation.joint_estimate import JointEstimate
from .estimation.posterior import Posterior
from .estimation.solve_report import SolveReport
from .estimation.state_estimate import StateEstimate
from .estimation.static import estimate_static
from .estimation.static_posterior import StaticPosterior
from .estimation.static_samples import sample_static
from .evaluation.consistency import check
from .evaluation.metrics import errors_against
from .evaluation.plausibility.examine import examine
from .geometry import se3
from .io.netcdf import load_posterior, save_posterior
from .io.recording_folder import load_recording
from .io.robot_file import load_robot
from .io.robot_writer import save_robot
from .model.grid import Grid, uniform_grid
from .model.noise import GemanMcClure, Huber
from .model.priors.separable import BaseVariance, SeparablePrior
from .model.priors.white_noise import BaseDensity, WhiteNoisePrior
from .model.robot import Robot
from .model.sensors.accelerometer import AccelerometerReadings
from .model.sensors.parameters import SensorParameter
from .model.sensors.readings import Readings
from .model.sensors.sensors import (
    CoilReadings,
    FbgReadings,
    GyroReadings,
    OrientationReadings,
    PoseReadings,
    PositionReadings,
    StrainReadings,
)
from .model.state import State
from .planning.plan_slide import plan_slide
from .simulation.simulate import simulate
from .solver.gauss_newton import SolverOptions
from .visualization.page.page import save_view

__all__ = [
    "AccelerometerReadings",
    "BaseDensity",
    "BaseVariance",
    "CoilReadings",
    "FalseConfidenceWarning",
    "FbgReadings",
    "FixedLagSmoother",
    "GemanMcClure",
    "GlissandoError",
    "Grid",
    "GyroReadings",
    "Huber",
    "JointEstimate",
    "NotConvergedWarning",
    "OrientationReadings",
    "PoseReadings",
    "PositionReadings",
    "Posterior",
    "Readings",
    "Robot",
    "SensorParameter",
    "SeparablePrior",
    "SolveReport",
    "SolverOptions",
    "State",
    "StateEstimate",
    "StaticPosterior",
    "StrainReadings",
    "WhiteNoisePrior",
    "check",
    "errors_against",
    "estimate",
    "estimate_static",
    "examine",
    "load_posterior",
    "load_recording",
    "load_robot",
    "plan_slide",
    "sample_static",
    "save_posterior",
    "save_robot",
    "save_view",
    "se3",
    "simulate",
    "uniform_grid",
]

__version__: str
