"""Batch estimation: a whole recording at once."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from glissando.errors import FalseConfidenceWarning, NotConvergedWarning
from glissando.estimation.batch_problem import BatchProblem
from glissando.estimation.given import model_of, require_batch, require_gate
from glissando.estimation.outliers import CHANCE
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.gauss_newton import Progress, SolverOptions


def estimate(
    model: Prior | Robot,
    grid: Grid,
    readings: Sequence[Readings],
    *,
    sensor_parameters: Sequence[SensorParameter] | None = None,
    initial: State | None = None,
    initial_parameters: Sequence[tuple[SensorParameter, Array]] = (),
    options: SolverOptions | None = None,
    progress: Progress | None = None,
    gate: float | None = CHANCE,
) -> Posterior:
    """Posterior over pose, strain and velocity, continuous in arclength and time.

    The iteration starts at rest, over coarse time nodes. If it is given another start that turns
    out to be far off, it starts at rest as well, and the better end counts. A reading that all
    others refute is left out and named in the report; streams with a robust loss keep all of
    theirs, and with a mechanical prior those are kept that a touch explains. Readings of sensors in
    channels beside the backbone are placed by the shape until both agree (M8).

    Args:
        model: The robot, or the prior of its motion.
        grid: Nodes over arclength (m) and time (s).
        readings: Readings of each sensor.
        sensor_parameters: Parameters of the sensors, matched by the readings' names; estimated with
            the states where they are uncertain, applied where they are known. Those of the robot
            unless given; of a prior none.
        initial: Nodes (K, N) to start from instead; rates that the prior has and it lacks are zero.
        initial_parameters: Sensor parameters with their values (K, size) to start from, as an
            earlier posterior of this grid holds them.
        options: When to stop.
        progress: Called after each iteration.
        gate: Chance below which the innovation of a reading refutes it; None uses them all.

    Raises:
        OutsideGridError: A reading or the initial state is not on the grid.
        UnobservableError: Prior and readings leave a direction of the state undetermined.
        SensorError: Readings are not in a list, a sensor is not sound, or no shape comes near.
        GlissandoError: An argument is of another class than it should be.

    Warns:
        NotConvergedWarning: The iteration stopped early; the posterior's report says so, too.
        FalseConfidenceWarning: Many readings contradict the estimate; the report says which.
    """
    prior, sensor_parameters = model_of(model, sensor_parameters)
    require_batch(prior, grid, readings, sensor_parameters, initial, options)
    require_gate(gate)
    problem = BatchProblem(
        prior, grid, readings, sensor_parameters, options or SolverOptions(), progress, gate
    )
    posterior = problem.placed((initial, initial_parameters))
    report = posterior.solve
    if not report.converged:
        words = [f"The estimate has {report.status}.", report.worst, report.outcome.remedy]
        warnings.warn(" ".join(filter(None, words)), NotConvergedWarning, stacklevel=2)
    elif report.doubt:
        warnings.warn(report.doubt, FalseConfidenceWarning, stacklevel=2)
    return posterior


def estimate_in_passing(
    prior: Prior,
    grid: Grid,
    readings: Sequence[Readings],
    sensor_parameters: Sequence[SensorParameter],
    options: SolverOptions,
    *,
    initial: State | None = None,
    initial_parameters: Sequence[tuple[SensorParameter, Array]] = (),
    dates: bool = True,
    gate: float | None = None,
    keep_all: bool = False,
) -> Posterior:
    """A posterior on the way to another: nothing is checked, and nothing is warned of.

    Args:
        prior: What is believed before any reading.
        grid: Nodes over arclength (m) and time (s).
        readings: Readings of each sensor.
        sensor_parameters: Parameters of the sensors.
        options: When to stop.
        initial: Nodes (K, N) to start from, if any.
        initial_parameters: Sensor parameters with their values (K, size) to start from.
        dates: Whether delays are known by what streams without one show, see `delays`, which costs
            as much as two iterations; else they are as sure as Gauss–Newton steps have them.
        gate: Chance below which the innovation of a reading refutes it; None uses them all.
        keep_all: Whether sensor parameters of which no reading tells are in the posterior, too.
    """
    given = prior, grid, readings, sensor_parameters, options
    problem = BatchProblem(*given, gate=gate, dates=dates, keep_all=keep_all)
    return problem.placed((initial, initial_parameters))
