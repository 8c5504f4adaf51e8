"""Newton steps towards the parameters of a robot file under which data are most likely.

Slope and curvature along each parameter are central differences of objectives on all cores, and
each of these costs one Gauss–Newton step from the estimate in their middle: the optimum moves by
that step to first order (the implicit function theorem). Curvature between parameters is learned
from step to step (BFGS).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from glissando.calibration.robot.hyperparameters import Document, Parameter, moved
from glissando.calibration.robot.objective import Centre, Objective
from glissando.calibration.robot.workers import BAD, evaluate
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array

_NUDGE = 0.1  # of a logarithm, for differences
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
        """Take a step; return how many more are expected, by the gain that this one promised."""
        slope, curvature = self.slopes(tell)
        self.std = np.where(
            curvature > 0.0, np.maximum(curvature * self.independent, 1e-12) ** -0.5, np.inf
        )
        least = _PRIOR_STD**-2.0 / self.independent
        self._update(slope, np.maximum(np.abs(curvature), least))
        step: Array = np.asarray(-np.linalg.solve(self._curvature, slope), dtype=float)
        step *= min(1.0, _PRIOR_STD / max(float(np.abs(step).max()), 1e-12))
        promise = float(-slope @ step - 0.5 * step @ self._curvature @ step)
        if promise < _GAIN:
            self._try(step, slope, beside=True)
            return 0
        better = any(self._try(share * step, slope) for share in _SHARES)
        return math.ceil(np.log10(promise / _GAIN)) if better else 0

    def slopes(self, tell: Callable[[float], None]) -> tuple[Array, Array]:
        """Slope (P,) and curvature (P,) along each parameter; zero where there is no estimate.

        Args:
            tell: Called with the part of a step that is done, after each objective.
        """
        nudges = _NUDGE * np.eye(self.x.size)
        points = [self.x, *(self.x + nudges), *(self.x - nudges)]
        documents = [moved(self.document, self.parameters, x) for x in points]
        values: list[float] = []
        for value in self.pool.map(evaluate, [self.centre] * len(points), documents):
            values.append(value)
            tell(len(values) / (len(points) + 1))
        totals = np.array([self._with_prior(f, x) for f, x in zip(values, points, strict=True)])
        good = np.array(values) < BAD
        sides = np.where(good, totals, totals[0])[1:].reshape(2, -1)
        known = good[0] * good[1:].reshape(2, -1)
        slope = (sides[0] - sides[1]) / (_NUDGE * np.maximum(known.sum(axis=0), 1))
        curvature = (sides[0] + sides[1] - 2.0 * totals[0]) / _NUDGE**2
        self._beside = float(totals[0])
        return slope * known.any(axis=0), curvature * known.all(axis=0)

    def _update(self, slope: Array, diagonal: Array) -> None:
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
