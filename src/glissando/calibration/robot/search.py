"""Newton steps towards the parameters of a robot file under which data are most likely.

Each objective beside the centre costs one Gauss–Newton step from the estimate there: the optimum
moves by that step to first order (the implicit function theorem). Where truth is foretold, its
samples tell slope and curvature by one nudge of each parameter (Fisher scoring). The evidence of
readings has no samples: slope and curvature along each parameter are central differences, and
curvature between parameters is learned from step to step (BFGS).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from glissando.calibration.robot import fisher_information
from glissando.calibration.robot.hyperparameters import Document, Parameter, moved
from glissando.calibration.robot.objective import Centre, Objective
from glissando.calibration.robot.predictive import Score
from glissando.calibration.robot.workers import score_beside
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array

_NUDGE = 0.1  # of a logarithm, for second differences
_SMALL_NUDGE = 1e-3  # for first differences
_GAIN = 1e-3  # gain a degree of freedom below which the search ends
_SHARES = (1.0, 0.5, 0.25, 0.125)  # of a step that are tried
_REACH = np.log(1e4)  # how far a number may move
_PRIOR_STD = np.log(3.0)  # of a logarithm


@dataclass
class Search:
    """Newton steps down minus the log posterior of the parameters, per degree of freedom.

    Attributes:
        document: The robot file to start from.
        parameters: What is learned.
        objective: The objective.
        pool: Where objectives beside the centre are evaluated.
        centre: The robot file at which the search is.
        x: How far the parameters are moved there (P,).
        value: Minus the log posterior there.
        std: Standard deviation of each parameter (P,), the others fixed.
    """

    document: Document
    parameters: list[Parameter]
    objective: Objective
    pool: Executor
    centre: Centre
    x: Array
    value: float = field(init=False)
    std: Array = field(init=False)
    _curvature: Array = field(init=False)
    _former: tuple[Array, Array] | None = None  # the last step and the slope before it

    def __post_init__(self) -> None:
        self.independent = self.centre.score.independent
        self.value = self._with_prior(-self.centre.score.value, self.x)

    def step(self, tell: Callable[[float], None]) -> int:
        """Take a step; return how many more are expected, by the gain that this one promised.

        Args:
            tell: Called with the part of the step that is done, after each objective.
        """
        slope = self.differentiate(tell)
        step: Array = np.asarray(-np.linalg.solve(self._curvature, slope), dtype=float)
        step *= min(1.0, _PRIOR_STD / max(float(np.abs(step).max()), 1e-12))
        promise = float(-slope @ step - 0.5 * step @ self._curvature @ step)
        if promise < _GAIN:
            self._try(step, slope, beside=True)
            return 0
        better = any(self._try(share * step, slope) for share in _SHARES)
        return math.ceil(np.log10(promise / _GAIN)) if better else 0

    def differentiate(self, tell: Callable[[float], None]) -> Array:
        """Slope (P,) at the centre; keeps the curvature and the standard deviations there."""
        if self.centre.score.foretold:
            slope, curvature = self._by_samples(tell)
            self._curvature = curvature
        else:
            slope, along = self._by_differences(tell)
            curvature = np.diag(along)
            self._learn_curvature(slope, np.maximum(np.abs(along), self._least))
        along = np.diagonal(curvature)
        precision = np.maximum(along * self.independent, 1e-12)
        self.std = np.where(along > 0.0, precision**-0.5, np.inf)
        return slope

    @property
    def _least(self) -> float:
        """Curvature of the prior of a parameter."""
        return float(_PRIOR_STD**-2.0 / self.independent)

    def _by_samples(self, tell: Callable[[float], None]) -> tuple[Array, Array]:
        """Slope (P,) and expected curvature (P, P) by the samples of truth."""
        size = self.x.size
        points = [self.x, *(self.x + _SMALL_NUDGE * np.eye(size))]
        centre, *beside = self._scores(points, tell)
        slope, curvature = np.zeros(size), np.zeros((size, size))
        self._beside = np.inf
        if centre is not None:
            self._beside = self._with_prior(-centre.value, self.x)
            slope, curvature = fisher_information.slopes(centre, beside, _SMALL_NUDGE)
        return slope + self._least * self.x, curvature + self._least * np.eye(size)

    def _by_differences(self, tell: Callable[[float], None]) -> tuple[Array, Array]:
        """Slope (P,) and curvature (P,) along each parameter; zero where there is no estimate."""
        nudges = _NUDGE * np.eye(self.x.size)
        points = [self.x, *(self.x + nudges), *(self.x - nudges)]
        scores = self._scores(points, tell)
        good = np.array([score is not None for score in scores])
        totals = np.array(
            [
                np.inf if score is None else self._with_prior(-score.value, x)
                for score, x in zip(scores, points, strict=True)
            ]
        )
        self._beside = float(totals[0])
        sides = np.where(good, totals, totals[0])[1:].reshape(2, -1)
        known = good[0] * good[1:].reshape(2, -1)
        slope, curvature = np.zeros((2, self.x.size))
        if good[0]:
            slope = (sides[0] - sides[1]) / (_NUDGE * np.maximum(known.sum(axis=0), 1))
            curvature = (sides[0] + sides[1] - 2.0 * totals[0]) / _NUDGE**2
        return slope, curvature * known.all(axis=0)

    def _scores(self, points: list[Array], tell: Callable[[float], None]) -> list[Score | None]:
        """Scores of robot files beside the centre; None where there is no estimate."""
        documents = [moved(self.document, self.parameters, x) for x in points]
        scores: list[Score | None] = []
        for score in self.pool.map(score_beside, [self.centre] * len(points), documents):
            scores.append(score)
            tell(len(scores) / (len(points) + 1))
        return scores

    def _learn_curvature(self, slope: Array, diagonal: Array) -> None:
        """The curvature: between parameters by BFGS (damped, Powell 1978), along them as given."""
        if self._former is None:
            self._curvature = np.diag(diagonal)
            return
        step, before = self._former
        change, foreseen = slope - before, self._curvature @ step
        most, seen = float(step @ foreseen), float(step @ change)
        if seen < 0.2 * most:
            part = 0.8 * most / (most - seen)
            change = part * change + (1.0 - part) * foreseen
        updated = self._curvature - np.outer(foreseen, foreseen) / most
        updated += np.outer(change, change) / float(step @ change)
        scale = np.sqrt(diagonal / np.diagonal(updated))
        self._curvature = scale[:, None] * updated * scale

    def _try(self, step: Array, slope: Array, *, beside: bool = False) -> bool:
        """Whether a step is worth it, also if only to first order; if so, it is taken."""
        x = np.clip(self.x + step, -_REACH, _REACH)
        centre: Centre | None = None
        with suppress(GlissandoError, np.linalg.LinAlgError):
            document = moved(self.document, self.parameters, x)
            centre = self.objective.score(document, self.centre, beside=beside)
        if centre is None:
            return False
        value = self._with_prior(-centre.score.value, x)
        if not value < min(self.value, self._beside if beside else np.inf):
            return False
        self._former = x - self.x, slope
        self.x, self.value, self.centre = x, value, centre
        return True

    def _with_prior(self, value: float, x: Array) -> float:
        """The objective with the prior about the initial values."""
        return value + 0.5 * float(np.sum((x / _PRIOR_STD) ** 2)) / self.independent
