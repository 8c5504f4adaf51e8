"""Batch estimation: a whole recording at once."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.errors import (
    NotConvergedWarning,
    OutsideGridError,
    SensorError,
    UnobservableError,
)
from glissando.estimation.posterior import Posterior, SolveReport
from glissando.estimation.starting_point import starting_point, with_parameters
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.gauss_newton import Progress, Solution, SolverOptions, Stopwatch, minimize
from glissando.solver.located_readings import locate


def estimate(
    prior: Prior,
    grid: Grid,
    readings: Sequence[Readings],
    *,
    sensor_parameters: Sequence[SensorParameter] = (),
    initial: State | None = None,
    initial_parameters: Sequence[tuple[SensorParameter, Array]] = (),
    options: SolverOptions | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Posterior over pose, strain and velocity, continuous in arclength and time.

    The iteration starts at rest, over coarse time nodes.

    Args:
        prior: What is believed before any reading.
        grid: Nodes over arclength (m) and time (s).
        readings: Readings of each sensor.
        sensor_parameters: Parameters of the sensors, matched by the readings' names; estimated with
            the states where they are uncertain, applied where they are known.
        initial: Nodes (K, N) to start from instead.
        initial_parameters: Sensor parameters with their values (K, size) to start from, as an
            earlier posterior of this grid holds them.
        options: When to stop.
        progress: Called after each iteration.

    Raises:
        OutsideGridError: A reading or the initial state is not on the grid.
        UnobservableError: Prior and readings leave a direction of the state undetermined.
        SensorError: Readings are not in a list, or a sensor is not sound.

    Warns:
        NotConvergedWarning: The iteration stopped early; the posterior's report says so, too.
    """
    _require_sound(prior, grid, readings, initial)
    clock, options = Stopwatch(), options or SolverOptions()
    known = [parameter for parameter in sensor_parameters if parameter.known]
    with one_thread():
        located = locate(grid, [corrected(r, known) for r in readings], sensor_parameters)  # (16)
        located = with_parameters(located, initial_parameters)
        start, before = initial, 0
        if start is None:
            start, located, before = starting_point(prior, located, progress, clock)
        solution = minimize(prior, located, start, options, _after(before, progress), clock)  # (19)
        evidence = _log_evidence(solution)  # (22)
        with clock("covariance"):
            marginals = solution.cholesky.marginals(consume=True)  # (21)
    report = _report(solution, before, evidence, clock)
    if not report.converged:
        message = f"The estimate has {report.status}. {report.outcome.remedy}"
        warnings.warn(message, NotConvergedWarning, stacklevel=2)
    parameters = solution.located.parameters.by_name()
    return Posterior(
        prior, grid, solution.state, solution.equations.system, marginals, report, parameters
    )


def _require_sound(
    prior: Prior, grid: Grid, readings: Sequence[Readings], initial: State | None
) -> None:
    """Raise for what cannot be estimated, before anything is computed."""
    if isinstance(readings, Readings):
        raise SensorError("Readings go in a list, a sensor each: estimate(prior, grid, [coil]).")
    if initial is not None and initial.pose.shape[:2] != grid.shape:
        raise OutsideGridError(
            f"The initial state has {initial.pose.shape[:2]} nodes and the grid {grid.shape}; give "
            f"a state of this grid."
        )
    if not prior.fixes_base and not any(r.fixes_base and len(r) for r in readings):
        raise UnobservableError(
            "Nothing fixes the base: the robot has no [base] and no pose, coil or position stream "
            "is used. Give the robot a [base], or use a stream that fixes it."
        )


def _after(before: int, progress: Progress | None) -> Progress | None:
    """The same progress, counting on from iterations before."""
    if progress is None or before == 0:
        return progress
    return lambda iteration, cost, length: progress(before + iteration, cost, length)


def _log_evidence(solution: Solution) -> float:
    """The Laplace log marginal likelihood, up to a constant. Source: equation (22)."""
    noise = sum(terms.log_det_cov() for terms in solution.equations.terms)
    cost = solution.equations.cost_of(solution.equations)
    return -cost - 0.5 * (noise + solution.cholesky.log_det)


def _report(solution: Solution, before: int, log_evidence: float, clock: Stopwatch) -> SolveReport:
    """The record of the solve that goes with the posterior."""
    at = solution.equations
    suspects = sum(int(np.sum(terms.robust_weights() < 0.5)) for terms in at.terms)
    return SolveReport(
        solution.outcome,
        before + solution.iterations,
        solution.last_step,
        at.rhs.size,
        at.cost_of(at),
        log_evidence,
        suspects,
        clock.total(),
    )
