"""What learning makes most likely: readings, or truth given an estimate from them.

The objective is the Laplace log marginal likelihood of the readings (equation 22) or, where truth
is given, its predictive log-likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.calibration.robot.case import Case
from glissando.calibration.robot.hyperparameters import Document
from glissando.calibration.robot.predictive import (
    Score,
    Start,
    constants_of,
    predict,
    quiet_estimate,
)
from glissando.errors import GlissandoError, RecordingError
from glissando.estimation.posterior import Posterior
from glissando.io.robot_file import parse_robot
from glissando.io.toml_table import Table
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.solver.gauss_newton import SolverOptions

_TIGHT = SolverOptions(max_iterations=20, tolerance=1.0)
_ONE_STEP = SolverOptions(max_iterations=1, tolerance=np.inf)


@dataclass(frozen=True)
class Centre:
    """A robot file that was scored, and what its estimates leave to those of files about it."""

    score: Score
    starts: Sequence[Start]


@dataclass(frozen=True)
class Objective:
    """Log-likelihood per degree of freedom of truth, else of the readings, in cases.

    Attributes:
        cases: The cases.
        calibrate: Whether frame and mounts of the truth are calibrated.
        constants: Frame, mounts and delays of the truth.
    """

    cases: Sequence[Case]
    calibrate: bool
    constants: tuple[SensorParameter, ...] = ()

    def centre(self, document: Document, about: Centre | None = None) -> Centre:
        """Score a robot file by converged estimates, begun at those of another one, if given.

        Raises:
            GlissandoError: If the robot file is wrong or cannot be estimated.
        """
        return self._scored(document, about, _TIGHT)

    def score(self, document: Document, about: Centre) -> Score:
        """Score a robot file beside a centre, to first order in how far it is from there.

        Raises:
            GlissandoError: If the robot file is wrong or cannot be estimated.
        """
        return self._scored(document, about, _ONE_STEP).score

    def _scored(self, document: Document, about: Centre | None, options: SolverOptions) -> Centre:
        robot = parse_robot(Table(document, "learned", GlissandoError))
        readings = [self._readings(case, robot) for case in self.cases]
        starts = [Start()] * len(self.cases) if about is None else about.starts
        posteriors = [
            quiet_estimate(
                robot.prior, case.grid(robot), each, robot.sensor_parameters, options, start
            )
            for case, each, start in zip(self.cases, readings, starts, strict=True)
        ]
        truths = [case.truth(robot) for case in self.cases]
        if any(truths):
            score = self._predictive(posteriors, truths, about)
        else:
            count = sum(len(r) * r.row_count for each in readings for r in each)
            total = sum(posterior.solve.log_evidence for posterior in posteriors)
            score = Score(total / count, count, count)
        return Centre(score, [Start.of(posterior) for posterior in posteriors])

    def _predictive(
        self,
        posteriors: Sequence[Posterior],
        truths: Sequence[list[Readings]],
        about: Centre | None,
    ) -> Score:
        """Score of the truth of all cases; constants are calibrated on the longest one."""
        longest = max(range(len(truths)), key=lambda i: sum(map(len, truths[i])))
        constants = self.constants
        if self.calibrate:
            constants = constants if about is None else about.score.constants
            constants = constants or constants_of(truths[longest])
            best = predict(posteriors[longest], truths[longest], constants, free=True)
            constants = best.constants
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
