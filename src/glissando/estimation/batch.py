"""Batch estimation of a whole recording."""

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

    The iteration starts at rest, on coarse time nodes, or at `initial`. If that start proves far
    off, rest is tried as well, and the better solution is returned. Where a robot with a strain
    prior is widely bent between read places and the search from rest is not quick, it starts at
    static shapes of one moment, and the likeliest solution is returned. A reading that all others
    refute is left out and listed in the report; streams with a robust loss keep all readings, and
    with a mechanical prior readings that a contact explains are kept. Readings of sensors in
    channels beside the backbone are located by the shape, iterated until both agree (M8).

    The posterior is about its mode, the likeliest motion; with a mechanical prior without inertia
    it is about its mean, as loads on a rod that moves differ between both (37).

    Args:
        model: The robot, or the prior of its motion.
        grid: Nodes over arclength (m) and time (s).
        readings: Readings of each sensor.
        sensor_parameters: Parameters of the sensors, matched by the readings' names; estimated with
            the states where they are uncertain, applied where they are known. If None, those of
            the robot; a prior has none.
        initial: Nodes (K, N) to start from; rates that the prior has and this state lacks are zero.
        initial_parameters: Sensor parameters with their values (K, size) to start from, such as
            those of an earlier posterior on this grid.
        options: Stopping criteria.
        progress: Called after each iteration.
        gate: Probability of an innovation below which a reading is refuted; None uses all readings.

    Raises:
        OutsideGridError: A reading or the initial state is not on the grid.
        UnobservableError: Prior and readings leave a direction of the state undetermined.
        SensorError: Readings are not in a list, a sensor is inconsistent, or no shape agrees with
            the readings even approximately.
        GlissandoError: An argument is of the wrong class.

    Warns:
        NotConvergedWarning: The iteration stopped early, as `Posterior.solve` also reports.
        FalseConfidenceWarning: Many readings contradict the estimate, or other motions are
            probable; `Posterior.solve` names them.
    """
    prior, sensor_parameters = model_of(model, sensor_parameters)
    require_batch(prior, grid, readings, sensor_parameters, initial, options)
    require_gate(gate)
    problem = BatchProblem(
        prior,
        grid,
        readings,
        sensor_parameters,
        options or SolverOptions(),
        progress,
        gate,
        mean=True,
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
    """Posterior of an intermediate estimate, without checks of arguments and without warnings.

    Args:
        prior: The prior of the motion.
        grid: Nodes over arclength (m) and time (s).
        readings: Readings of each sensor.
        sensor_parameters: Parameters of the sensors.
        options: Stopping criteria.
        initial: Nodes (K, N) to start from, if any.
        initial_parameters: Sensor parameters with their values (K, size) to start from.
        dates: Whether delays are determined by the motion of streams without a delay, see `delays`,
            which costs as much as two iterations; else their covariance is that of Gauss–Newton.
        gate: Probability of an innovation below which a reading is refuted; None uses all readings.
        keep_all: Whether the posterior includes sensor parameters that have no readings.
    """
    given = prior, grid, readings, sensor_parameters, options
    problem = BatchProblem(*given, gate=gate, dates=dates, keep_all=keep_all)
    return problem.placed((initial, initial_parameters))
