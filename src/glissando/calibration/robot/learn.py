"""Learning a robot file's numbers from recordings: how strong, how fast, how noisy.

What is maximised is the Laplace log marginal likelihood of the readings (equation 22) or, where
truth is given, the predictive log-likelihood of it. Numbers are scaled by exponentials, so they
stay positive, and are expected where they start, one standard deviation being a factor of three:
what a recording says nothing of stays there. A try that cannot be estimated is a bad one, not an
end. Gradients are differences, tried on all cores.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import Protocol

import numpy as np
from scipy.optimize import minimize

from glissando.calibration.robot.hyperparameters import Document, Parameter, moved
from glissando.calibration.robot.predictive import constants_of, predict
from glissando.errors import GlissandoError, NotConvergedWarning, RecordingError
from glissando.estimation.batch import SolverOptions, estimate
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.io.recording import Recording
from glissando.io.robot_file import parse_robot
from glissando.io.toml_table import Table
from glissando.model.grid import Grid
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import State

_TIGHT = SolverOptions(max_iterations=10, tolerance=0.3)
_BAD = 1e3  # objective of a try that cannot be estimated
_NUDGE = 0.05  # of a logarithm, for differences
_WORTH = 1e-3  # gain a degree of freedom below which a step was idle
_IDLE = 3  # idle steps in a row that end the search
_REACH = np.log(1e4)  # how far a number may move
_EXPECTED = np.log(3.0)  # standard deviation of a logarithm before anything is learned


class Case(Protocol):
    """Something to learn from: a grid, readings and truth that depend on the robot file."""

    def grid(self, robot: Robot) -> Grid:
        """The grid to estimate on."""
        ...

    def readings(self, robot: Robot) -> list[Readings]:
        """What the sensors said."""
        ...

    def truth(self, robot: Robot) -> list[Readings]:
        """What to foretell; empty to maximise the likelihood of the readings."""
        ...


@dataclass(frozen=True)
class Score:
    """What a robot file is worth on all cases: the objective per degree of freedom.

    Of `samples` degrees of freedom so many are `independent`: all places of the robot err together.
    """

    value: float
    samples: int
    independent: float
    constants: tuple[SensorParameter, ...] = ()


Watch = Callable[[int, float], None]
"""Called after each step with its number and the objective."""


@dataclass(frozen=True)
class Learned:
    """What was learned: the document, what it was worth before and after, and how sure.

    `std` (P,) is how far each parameter's logarithm may be off, the others held: ln 3 for one of
    which nothing was learned.
    """

    document: Document
    parameters: list[Parameter]
    moved: Array
    std: Array
    before: Score
    after: Score
    steps: int


@dataclass
class Judge:
    """Scores documents on cases; remembers where the first ended, to start there again."""

    cases: Sequence[Case]
    calibrate: bool
    constants: tuple[SensorParameter, ...] = ()
    _starts: dict[int, State] = field(default_factory=dict)

    def score(self, document: Document) -> Score:
        """The objective: log-likelihood per degree of freedom of truth, else of the readings."""
        robot = parse_robot(Table(document, "learned", GlissandoError))
        found = [self._estimate(i, case, robot) for i, case in enumerate(self.cases)]
        truths = [case.truth(robot) for case in self.cases]
        if not any(truths):
            counts = [sum(r.values.shape[0] * r.row_count for r in rs) for _, rs in found]
            total = sum(posterior.solve.log_evidence for posterior, _ in found)
            return Score(total / sum(counts), sum(counts), sum(counts))
        return self._foretold([posterior for posterior, _ in found], truths)

    def _foretold(self, found: Sequence[Posterior], truths: Sequence[list[Readings]]) -> Score:
        """Truth of all cases; constants are calibrated on the longest and hold for all."""
        longest = max(range(len(truths)), key=lambda i: sum(map(len, truths[i])))
        constants = self.constants
        if self.calibrate:
            constants = constants or constants_of(truths[longest])
            constants = predict(found[longest], truths[longest], constants, free=True).constants
            self.constants = self.constants or constants
        told_all = [
            predict(posterior, truth, constants, free=False)
            for posterior, truth in zip(found, truths, strict=True)
        ]
        samples = sum(t.samples for t in told_all)
        if not samples:
            raise RecordingError("There is no truth in the window; choose another.")
        value = sum(t.score * t.samples for t in told_all) / samples
        independent = sum(t.independent for t in told_all)
        return Score(value, samples, independent, constants)

    def _estimate(self, i: int, case: Case, robot: Robot) -> tuple[Posterior, list[Readings]]:
        readings = case.readings(robot)
        if not sum(map(len, readings)):
            raise RecordingError("The window holds no readings to learn from; choose another.")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotConvergedWarning)
            posterior = estimate(
                robot.prior,
                case.grid(robot),
                readings,
                sensor_parameters=robot.sensor_parameters,
                initial=self._starts.get(i),
                options=_TIGHT,
            )
        self._starts.setdefault(i, posterior.state)
        return posterior, readings


_judge: Judge | None = None


def _prepare(judge: Judge, document: Document) -> None:
    global _judge
    _judge = judge
    _judge.score(document)


def _tried(document: Document) -> float:
    assert _judge is not None
    try:
        value = -_judge.score(document).value
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
    """Scale the parameters of an expanded document until they are most likely, given the cases.

    `constants` of the truth are put right; with `calibrate` its frame and mounts are found, from
    these or from none. Raises what the first estimate raises: a start must at least be possible.
    """
    parameters = list(parameters)
    judge = Judge(cases, calibrate, constants)
    before = judge.score(document)
    workers = min(os.cpu_count() or 1, 1 + len(parameters))
    spawned = get_context("spawn")
    with ProcessPoolExecutor(
        workers, spawned, _prepare, (Judge(cases, calibrate, constants), document)
    ) as pool:
        search = _Search(document, parameters, pool, watch, steps, before.independent)
        limits = [(-_REACH, _REACH)] * len(parameters)
        with suppress(_EnoughError):
            minimize(
                search.with_slope, np.zeros(len(parameters)), jac=True, method="L-BFGS-B",
                bounds=limits, options={"maxfun": steps, "ftol": 1e-5, "maxls": 8},
            )  # fmt: skip
        best = search.best[1]
        std = search.spread(best)
    learned = moved(document, parameters, best)
    after = judge.score(learned)
    return Learned(learned, parameters, best, std, before, after, search.count)


class _EnoughError(Exception):
    """Raised out of the search when more steps would not pay."""


class _Search:
    """The objective, less what numbers are expected to be, and its slope; all tries at once."""

    def __init__(
        self,
        document: Document,
        parameters: list[Parameter],
        pool: ProcessPoolExecutor,
        watch: Watch | None,
        steps: int,
        independent: float,
    ) -> None:
        self._steps, self._independent = steps, independent
        self._document, self._parameters = document, parameters
        self._pool, self._watch = pool, watch
        self.best = (np.inf, np.zeros(len(parameters)))
        self.count, self._idle = 0, 0

    def _all(self, points: Sequence[Array]) -> Array:
        documents = [moved(self._document, self._parameters, x) for x in points]
        surprise = 0.5 * np.sum((np.array(points) / _EXPECTED) ** 2, axis=1)
        return np.array(list(self._pool.map(_tried, documents))) + surprise / self._independent

    def with_slope(self, x: Array) -> tuple[float, Array]:
        """The objective and its gradient (P,)."""
        points = [x.copy(), *(x + _NUDGE * np.eye(x.size))]
        values = self._all(points)
        least = int(np.argmin(values))
        self._idle = 0 if values[least] < self.best[0] - _WORTH else self._idle + 1
        if values[least] < self.best[0]:
            self.best = (float(values[least]), points[least])
        self.count += 1
        if self._watch is not None:
            self._watch(self.count, -float(self.best[0]))
        if self._idle == _IDLE or self.count == self._steps:
            raise _EnoughError
        slope = np.where(values[1:] < _BAD, (values[1:] - values[0]) / _NUDGE, 0.0)
        return float(values[0]), slope

    def spread(self, x: Array) -> Array:
        """Standard deviation (P,) of each number, from the curvature; infinite without any."""
        nudges = 4.0 * _NUDGE * np.eye(x.size)
        values = self._all([x, *(x + nudges), *(x - nudges)])
        ahead, behind = values[1 : 1 + x.size], values[1 + x.size :]
        curvature = (ahead + behind - 2.0 * values[0]) / (4.0 * _NUDGE) ** 2 * self._independent
        return np.where(curvature > 0.0, np.maximum(curvature, 1e-12) ** -0.5, np.inf)


@dataclass(frozen=True)
class RecordingCase:
    """A window of a recording: streams to use, and streams to foretell (none: their evidence)."""

    recording: Recording
    window: tuple[float, float]
    use: Sequence[str]
    evaluate_path: Sequence[str] = ()

    def grid(self, robot: Robot) -> Grid:
        """The robot's grid over the window."""
        return robot.grid(*self.window)

    def readings(self, robot: Robot) -> list[Readings]:
        """The streams to use, inside the window."""
        return self.recording.readings(self.use, robot, self.window)[0]

    def truth(self, robot: Robot) -> list[Readings]:
        """The streams to foretell, inside the window."""
        found, _ = self.recording.readings(self.evaluate_path, robot, self.window, as_truth=True)
        return [stream for stream in found if len(stream)]
