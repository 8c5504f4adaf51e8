"""Objective of learning: likelihood of the readings, or of truth given an estimate from them.

The objective is the Laplace log marginal likelihood of the readings (equation 22) or, if there is
truth, the predictive log-likelihood of truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.calibration.robot.case import RecordingCase
from glissando.calibration.robot.hyperparameters import Document
from glissando.calibration.robot.joint_calibration import lasting
from glissando.calibration.robot.predictive import (
    Score,
    Start,
    constants_of,
    predict,
)
from glissando.errors import GlissandoError, RecordingError
from glissando.estimation.batch import estimate_in_passing
from glissando.estimation.posterior import Posterior
from glissando.io.robot_file import parse_robot
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.table import Table
from glissando.solver.gauss_newton import SolverOptions

_TIGHT = SolverOptions(max_iterations=20, tolerance=1.0)
_AWAY = 1e9  # offset between the interval numbers of two cases
_ONE_STEP = SolverOptions(max_iterations=1, tolerance=np.inf)


@dataclass(frozen=True)
class Centre:
    """Score of a robot file, and initial guesses for estimates with similar files.

    Attributes:
        score: The score; only its constants are defined if the file has not been scored.
        starts: Initial guess for each case.
    """

    score: Score
    starts: Sequence[Start]


@dataclass(frozen=True)
class Objective:
    """Log-likelihood per degree of freedom of truth or, without truth, of the readings.

    Attributes:
        cases: Windows of recordings.
        calibrate: Whether frame and mounts of the truth are calibrated.
    """

    cases: Sequence[RecordingCase]
    calibrate: bool

    def start(
        self, constants: tuple[SensorParameter, ...] = (), first: Start | None = None
    ) -> Centre:
        """Initial centre, with constants of the truth and an initial guess for the first case."""
        unknown = Score(np.nan, 0, 0.0, constants)
        return Centre(unknown, [first or Start(), *[Start()] * (len(self.cases) - 1)])

    def score(self, document: Document, about: Centre, *, beside: bool = False) -> Centre:
        """Score a robot file.

        Args:
            document: Robot file.
            about: Centre at whose estimates the iterations start.
            beside: Whether to take a single Gauss–Newton step from there, which is exact to first
                order in the change of the file.

        Raises:
            GlissandoError: If the robot file is wrong or cannot be estimated.
        """
        options = _ONE_STEP if beside else _TIGHT
        robot = parse_robot(Table(document, "learned", GlissandoError))
        readings = [self._readings(case, robot) for case in self.cases]
        truths = [case.truth(robot) for case in self.cases]
        posteriors = [
            estimate_in_passing(
                robot.prior,
                case.grid(robot),
                each,
                robot.sensor_parameters,
                options,
                initial=start.state,
                initial_parameters=start.sensor_parameters,
                dates=False,  # changes predictions by less than the gain of a step
            )
            for case, each, start in zip(self.cases, readings, about.starts, strict=True)
        ]
        if any(truths):
            score = self._predictive(posteriors, truths, about.score.constants)
        else:
            count = sum(len(r) * r.row_count for each in readings for r in each)
            total = sum(posterior.log_evidence for posterior in posteriors)
            score = Score(total / count, count, count)
        return Centre(score, [Start.of(posterior) for posterior in posteriors])

    def _predictive(
        self,
        posteriors: Sequence[Posterior],
        truths: Sequence[list[Readings]],
        constants: tuple[SensorParameter, ...],
    ) -> Score:
        """Score of the truth of all cases; constants are calibrated on the case with most samples.

        Delays of the truth in `constants` are the first case's and are not used for the others.
        """
        longest = max(range(len(truths)), key=lambda i: sum(map(len, truths[i])))
        if self.calibrate:
            constants = constants or constants_of(truths[longest])
            best = predict(posteriors[longest], truths[longest], constants, free=True)
            constants = best.constants
        of_cases = [constants, *[lasting(constants)] * (len(truths) - 1)]
        scores = [
            predict(posterior, truth, known, free=False)
            for posterior, truth, known in zip(posteriors, truths, of_cases, strict=True)
        ]
        samples = sum(s.samples for s in scores)
        if not samples:
            raise RecordingError("There is no truth in the window; choose another.")
        value = sum(s.value * s.samples for s in scores) / samples
        predicted = tuple(each for score in scores for each in score.predicted)
        moments = tuple(m + _AWAY * i for i, score in enumerate(scores) for m in score.moments)
        independent = sum(score.independent for score in scores)
        return Score(value, samples, independent, constants, predicted, moments)

    @staticmethod
    def _readings(case: RecordingCase, robot: Robot) -> list[Readings]:
        readings = case.readings(robot)
        if not sum(map(len, readings)):
            raise RecordingError("The window holds no readings to learn from; choose another.")
        return readings
