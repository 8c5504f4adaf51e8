"""Newton search for the maximum a posteriori parameters of a robot file.

Gradient and curvature take one perturbation of each parameter. For the likelihood of truth, the
curvature is the Fisher information (Fisher scoring); a prediction at perturbed parameters costs one
Gauss–Newton step from the estimate at the centre, which moves the optimum correctly to first order
(implicit function theorem). For the evidence of readings, it is the average information.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from glissando.calibration.robot import average_information, fisher_information
from glissando.calibration.robot.average_information import Change
from glissando.calibration.robot.hyperparameters import Document, Parameter, moved
from glissando.calibration.robot.objective import Centre, Objective
from glissando.calibration.robot.predictive import Score
from glissando.calibration.robot.workers import nearby_changes, nearby_score
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array

_GAIN = 1e-3  # predicted gain per degree of freedom below which the search ends
_SHARES = (1.0, 0.5, 0.25, 0.125)  # step lengths of the line search
_REACH = np.log(1e4)  # bound on the total change of a parameter
_EXPECTED = 3  # steps expected before the first one is taken
_PRIOR_STD = np.log(3.0)  # of a parameter's logarithm
_FARTHEST = np.log(10.0)  # bound on the change of a parameter in one step


@dataclass
class Search:
    """Newton minimisation of the negative log posterior of the parameters, per degree of freedom.

    Attributes:
        document: Initial robot file.
        parameters: Parameters to learn.
        objective: Log-likelihood to maximise.
        pool: Executor that evaluates the objective at perturbed parameters.
        processes: Number of processes of the pool.
        centre: Score and estimates at the current parameters.
        x: Current parameters (P,), relative to the initial robot file.
        value: Negative log posterior at the current parameters.
        std: Marginal standard deviations (P,) of the parameters.
        left: Expected number of further steps, from the predicted gain of the last one.
        stuck: Whether the last line search achieved no gain although one was predicted.
    """

    document: Document
    parameters: list[Parameter]
    objective: Objective
    pool: Executor
    processes: int
    centre: Centre
    x: Array
    value: float = field(init=False)
    std: Array = field(init=False)
    left: int = _EXPECTED
    stuck: bool = False
    _curvature: Array = field(init=False)

    def __post_init__(self) -> None:
        self.independent = self.centre.score.independent
        self.value = self._with_prior(-self.centre.score.value, self.x)

    def step(self, tell: Callable[[float], None]) -> None:
        """Take one Newton step with line search.

        Args:
            tell: Called after each evaluation with the fraction of the step that is done.
        """
        slope = self.differentiate(tell)
        step = self._within_reach(slope)
        promise = float(-slope @ step - 0.5 * step @ self._curvature @ step)
        if promise < _GAIN:
            self._try(step, beside=True)
            self.left = 0
            return
        self.stuck = not any(self._try(share * step) for share in _SHARES)
        self.left = 0 if self.stuck else math.ceil(np.log10(promise / _GAIN))

    @property
    def at_bounds(self) -> NDArray[np.bool_]:
        """Whether each parameter (P,) is at the bound of the search."""
        return np.abs(self.x) > _REACH - 1e-6

    def differentiate(self, tell: Callable[[float], None]) -> Array:
        """Gradient (P,) at the centre; also stores curvature and standard deviations."""
        by = self._by_samples if self.centre.score.predicted else self._by_evidence
        slope, curvature, noise = by(tell)
        least = float(_PRIOR_STD**-2.0 / self.independent)  # of the prior
        self._curvature = curvature + least * np.eye(self.x.size)
        self.std = self._standard_deviations(noise)
        return slope + least * self.x

    def _standard_deviations(self, noise: Array | None) -> Array:
        """Marginal standard deviations (P,).

        With the gradient's covariance `noise` (P, P) per degree of freedom, the sandwich covariance
        is used, if larger than that of independent samples; the prior is an upper bound.
        """
        cov = np.linalg.inv(self._curvature) / self.independent
        variance = np.diagonal(cov)
        if noise is not None:
            of_slope = self.independent * noise + _PRIOR_STD**-2.0 * np.eye(self.x.size)
            variance = np.maximum(variance, np.einsum("ij,jk,ik->i", cov, of_slope, cov))
        return np.minimum(np.sqrt(variance), _PRIOR_STD)

    def _within_reach(self, slope: Array) -> Array:
        """Newton step (P,) under bounds on each parameter."""
        root = np.linalg.cholesky(self._curvature)
        low = np.maximum(-_FARTHEST, -_REACH - self.x)
        high = np.minimum(_FARTHEST, _REACH - self.x)
        found = lsq_linear(root.T, -np.linalg.solve(root, slope), (low, high), method="bvls")
        return np.asarray(found.x)

    def _perturbed_documents(self, nudge: float) -> list[Document]:
        """Robot file at the centre, and with each parameter perturbed in turn."""
        points = [self.x, *(self.x + nudge * np.eye(self.x.size))]
        return [moved(self.document, self.parameters, x) for x in points]

    def _by_samples(self, tell: Callable[[float], None]) -> tuple[Array, Array, Array | None]:
        """Gradient (P,), Fisher information and covariance of the gradient (P, P), from truth."""
        documents, scores = (
            self._perturbed_documents(fisher_information.NUDGE),
            list[Score | None](),
        )
        for score in self.pool.map(nearby_score, [self.centre] * len(documents), documents):
            scores.append(score)
            tell(len(scores) / (len(documents) + 1))
        centre, *beside = scores
        if centre is None:
            self._first_order_value = np.inf
            return np.zeros(self.x.size), np.zeros((self.x.size, self.x.size)), None
        self._first_order_value = self._with_prior(-centre.value, self.x)
        nudge = fisher_information.NUDGE
        noise = fisher_information.slope_covariance(centre, beside, nudge)
        return *fisher_information.slopes(centre, beside, nudge), noise

    def _by_evidence(self, tell: Callable[[float], None]) -> tuple[Array, Array, None]:
        """Gradient (P,) and average information (P, P) of the evidence of the readings."""
        self._first_order_value = self.value
        coarse, fine = average_information.NUDGE, average_information.FINE
        centre = moved(self.document, self.parameters, self.x)
        nudged = list(
            zip(*(self._perturbed_documents(h)[1:] for h in (coarse, fine, -fine)), strict=True)
        )
        parts = [nudged[i :: self.processes] for i in range(min(self.processes, len(nudged)))]
        changes: list[Change | None] = [None] * len(nudged)
        call = partial(nearby_changes, self.centre, centre)
        for i, part in enumerate(self.pool.map(call, parts)):
            changes[i :: self.processes] = part
            tell((i + 1) / (len(parts) + 1))
        return *average_information.slopes(changes, self.centre.score.samples), None

    def _try(self, step: Array, *, beside: bool = False) -> bool:
        """Take a step if it lowers the objective; with `beside`, evaluated to first order only."""
        x = self.x + step
        centre: Centre | None = None
        with suppress(GlissandoError, np.linalg.LinAlgError):
            document = moved(self.document, self.parameters, x)
            centre = self.objective.score(document, self.centre, beside=beside)
        if centre is None:
            return False
        value = self._with_prior(-centre.score.value, x)
        if not value < min(self.value, self._first_order_value if beside else np.inf):
            return False
        self.x, self.value, self.centre = x, value, centre
        return True

    def _with_prior(self, value: float, x: Array) -> float:
        """Objective plus the prior about the initial values."""
        return value + 0.5 * float(np.sum((x / _PRIOR_STD) ** 2)) / self.independent
