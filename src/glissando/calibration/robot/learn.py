"""Learning the numbers of a robot file from recordings: densities, time scales, noise.

The objective is the Laplace log marginal likelihood of the readings (equation 22) or, where truth
is given, its predictive log-likelihood. Numbers are scaled by exponentials, so they stay positive,
with a prior around their start whose standard deviation is a factor of three: a number that the
recordings do not determine stays there. A document that cannot be estimated has a bad objective.
Gradients are finite differences, evaluated on all cores.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing import get_context

import numpy as np
from scipy.optimize import minimize

from glissando.calibration.robot.case import Case
from glissando.calibration.robot.hyperparameters import Document, Parameter, moved
from glissando.calibration.robot.predictive import (
    Score,
    constants_of,
    predict,
    quiet_estimate,
)
from glissando.errors import GlissandoError, RecordingError
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.io.robot_file import parse_robot
from glissando.io.toml_table import Table
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.gauss_newton import SolverOptions

_TIGHT = SolverOptions(max_iterations=20, tolerance=1.0)
_BAD = 1e3  # objective of a document that cannot be estimated
_NUDGE = 0.05  # of a logarithm, for differences
_GAIN = 1e-3  # gain a degree of freedom below which a step was idle
_IDLE = 3  # idle steps in a row that end the search
_REACH = np.log(1e4)  # how far a number may move
_PRIOR_STD = np.log(3.0)  # of a logarithm


Watch = Callable[[int, float], None]
"""Called after each step with its number and the objective."""


@dataclass(frozen=True)
class Learned:
    """A learned robot file.

    Attributes:
        document: The robot file.
        parameters: The parameters that were learned.
        moved: Logarithm of each parameter's factor (P,), or its shift in units.
        std: Standard deviation of that (P,), the others fixed; ln 3 where nothing was learned.
        before: Score of the robot file at the start.
        after: Score of the learned one.
        steps: Number of steps.
    """

    document: Document
    parameters: list[Parameter]
    moved: Array
    std: Array
    before: Score
    after: Score
    steps: int


_Start = tuple[State | None, Sequence[tuple[SensorParameter, Array]]]
"""Nodes, and the sensor parameters with their values."""


@dataclass
class Objective:
    """Score of robot files on cases; estimates of a centre start those of the files about it.

    Attributes:
        cases: The cases.
        calibrate: Whether frame and mounts of the truth are calibrated.
        constants: Frame, mounts and delays of the truth.
        centre: The file that was scored as a centre last.
    """

    cases: Sequence[Case]
    calibrate: bool
    constants: tuple[SensorParameter, ...] = ()
    centre: Document | None = None
    _starts: dict[int, _Start] = field(default_factory=dict)

    def score(self, document: Document, *, centre: bool = False) -> Score:
        """Log-likelihood per degree of freedom of truth, else of the readings.

        Args:
            document: Robot file.
            centre: Whether later estimates start from those of this file.

        Raises:
            GlissandoError: If the robot file is wrong or cannot be estimated.
        """
        robot = parse_robot(Table(document, "learned", GlissandoError))
        readings = [self._readings(case, robot) for case in self.cases]
        posteriors = [self._estimate(i, robot, each) for i, each in enumerate(readings)]
        if centre:
            self.centre = document
            ends = ((each.state, each.sensor_parameters) for each in posteriors)
            self._starts = dict(enumerate(ends))
        truths = [case.truth(robot) for case in self.cases]
        if any(truths):
            return self._predictive(posteriors, truths)
        count = sum(len(r) * r.row_count for each in readings for r in each)
        total = sum(posterior.solve.log_evidence for posterior in posteriors)
        return Score(total / count, count, count)

    def _predictive(
        self, posteriors: Sequence[Posterior], truths: Sequence[list[Readings]]
    ) -> Score:
        """Score of the truth of all cases; constants are calibrated on the longest one."""
        longest = max(range(len(truths)), key=lambda i: sum(map(len, truths[i])))
        constants = self.constants
        if self.calibrate:
            constants = constants or constants_of(truths[longest])
            best = predict(posteriors[longest], truths[longest], constants, free=True)
            constants = best.constants
            self.constants = self.constants or constants
        scores = [
            predict(posterior, truth, constants, free=False)
            for posterior, truth in zip(posteriors, truths, strict=True)
        ]
        samples = sum(s.samples for s in scores)
        if not samples:
            raise RecordingError("There is no truth in the window; choose another.")
        value = sum(s.value * s.samples for s in scores) / samples
        return Score(value, samples, sum(s.independent for s in scores), constants)

    @staticmethod
    def _readings(case: Case, robot: Robot) -> list[Readings]:
        readings = case.readings(robot)
        if not sum(map(len, readings)):
            raise RecordingError("The window holds no readings to learn from; choose another.")
        return readings

    def _estimate(self, i: int, robot: Robot, readings: list[Readings]) -> Posterior:
        grid, parameters = self.cases[i].grid(robot), robot.sensor_parameters
        start = self._starts.get(i, (None, ()))
        return quiet_estimate(robot.prior, grid, readings, parameters, _TIGHT, *start)


_objective: Objective | None = None  # of a worker process


def _prepare(objective: Objective, document: Document) -> None:
    global _objective
    _objective = objective
    _objective.score(document, centre=True)


def _evaluate(centre: Document, document: Document) -> float:
    assert _objective is not None
    try:
        if centre != _objective.centre:
            _objective.score(centre, centre=True)
        value = -_objective.score(document).value
    except (GlissandoError, np.linalg.LinAlgError):
        return _BAD
    return value if np.isfinite(value) else _BAD


def learn(
    document: Document,
    parameters: Sequence[Parameter],
    cases: Sequence[Case],
    *,
    calibrate: bool = False,
    constants: tuple[SensorParameter, ...] = (),
    steps: int = 20,
    watch: Watch | None = None,
) -> Learned:
    """Learn the parameters of an expanded document from cases.

    Args:
        document: The robot file to start from, see `expanded`.
        parameters: The parameters to learn.
        cases: The data.
        calibrate: Whether frame and mounts of the truth are calibrated, starting from `constants`.
        constants: Frame, mounts and delays of the truth.
        steps: Number of steps at most.
        watch: Called after each step.

    Raises:
        GlissandoError: If the robot file to start from cannot be estimated.
    """
    parameters = list(parameters)
    objective = Objective(cases, calibrate, constants)
    before = objective.score(document, centre=True)
    workers = min(os.cpu_count() or 1, 1 + len(parameters))
    spawned = get_context("spawn")
    with ProcessPoolExecutor(
        workers, spawned, _prepare, (Objective(cases, calibrate, constants), document)
    ) as pool:
        search = _Search(document, parameters, pool, watch, steps, before.independent)
        limits = [(-_REACH, _REACH)] * len(parameters)
        with suppress(_EnoughError):
            minimize(
                search.with_slope, np.zeros(len(parameters)), jac=True, method="L-BFGS-B",
                bounds=limits, options={"maxfun": steps, "ftol": 1e-5, "maxls": 8},
            )  # fmt: skip
        best = search.best[1]
        std = search.std(best)
    learned = moved(document, parameters, best)
    after = objective.score(learned)
    return Learned(learned, parameters, best, std, before, after, search.count)


class _EnoughError(Exception):
    """Ends the search when more steps would gain little."""


@dataclass
class _Search:
    """Minus log posterior of the parameters, and its derivatives; the first point is the centre."""

    document: Document
    parameters: list[Parameter]
    pool: ProcessPoolExecutor
    watch: Watch | None
    steps: int
    independent: float
    best: tuple[float, Array] = (np.inf, np.zeros(0))
    count: int = 0
    idle: int = 0

    def _all(self, points: Sequence[Array]) -> Array:
        documents = [moved(self.document, self.parameters, x) for x in points]
        prior = 0.5 * np.sum((np.array(points) / _PRIOR_STD) ** 2, axis=1)
        values = list(self.pool.map(_evaluate, [documents[0]] * len(documents), documents))
        return np.array(values) + prior / self.independent

    def with_slope(self, x: Array) -> tuple[float, Array]:
        """The objective and its gradient (P,)."""
        points = [x.copy(), *(x + _NUDGE * np.eye(x.size))]
        values = self._all(points)
        least = int(np.argmin(values))
        self.idle = 0 if values[least] < self.best[0] - _GAIN else self.idle + 1
        if values[least] < self.best[0]:
            self.best = (float(values[least]), points[least])
        self.count += 1
        if self.watch is not None:
            self.watch(self.count, -float(self.best[0]))
        if self.idle == _IDLE or self.count == self.steps:
            raise _EnoughError
        slope = np.where(values[1:] < _BAD, (values[1:] - values[0]) / _NUDGE, 0.0)
        return float(values[0]), slope

    def std(self, x: Array) -> Array:
        """Standard deviation (P,) of each number, from the curvature; infinite without any."""
        nudges = 4.0 * _NUDGE * np.eye(x.size)
        values = self._all([x, *(x + nudges), *(x - nudges)])
        ahead, behind = values[1 : 1 + x.size], values[1 + x.size :]
        curvature = (ahead + behind - 2.0 * values[0]) / (4.0 * _NUDGE) ** 2 * self.independent
        return np.where(curvature > 0.0, np.maximum(curvature, 1e-12) ** -0.5, np.inf)
