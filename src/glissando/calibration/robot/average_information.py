"""Gradient and average information of the readings' evidence with respect to parameters.

Minus the log evidence (22) is ½ eᵀR⁻¹e + ½ (log det A − log det A₀ + log det R) and a constant,
with A the information of the states, A₀ that of the prior alone, e all residuals and R their
covariances (in log det R, the readings' only). The first term is least at the estimate, so it is
differentiated with the estimate fixed; the second with the estimate moved by a Gauss–Newton step.
The curvature is the average of observed and expected information, which needs first derivatives
only (Gilmour, Thompson and Cullis, Average information REML, Biometrics 51, 1995):
mᵀR⁻¹m + ½ uᵀR⁻¹u, with the derivatives m of residuals and u = (∂R) R⁻¹ e of covariances, after the
part that the states explain is projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from glissando.calibration.robot.case import RecordingCase
from glissando.calibration.robot.hyperparameters import Document
from glissando.calibration.robot.predictive import Start
from glissando.errors import GlissandoError
from glissando.estimation.channels import place_in_channel
from glissando.estimation.evidence import log_normalizer
from glissando.estimation.starting_point import with_parameters
from glissando.geometry.se3 import Array
from glissando.io.robot_file import parse_robot
from glissando.model.factors import Residuals
from glissando.model.priors.prior import Prior
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import corrected
from glissando.model.state import State
from glissando.model.table import Table
from glissando.solver.block_tridiagonal import factor
from glissando.solver.linearize import NormalEquations, linearize
from glissando.solver.located_readings import LocatedReadings, locate
from glissando.solver.normal_equations import system_shape

NUDGE, FINE = 1e-3, 1e-5
"""Steps of finite differences, of a parameter's logarithm. The fine one, with central differences,
is for parameters that move the predicted values by many standard deviations, nearly all of which
the states explain, second-order terms included."""
_STILL = 0.01  # standard deviations, over all residuals, by which NUDGE may move their means
_MOST = 1e4  # largest ratio of observed to expected information


class Change(NamedTuple):
    """Derivatives of minus the log evidence by one parameter.

    Attributes:
        misfit: Derivative of ½ eᵀR⁻¹e.
        width: Derivative of ½ (log det A − log det A₀ + log det R).
        shift: Norm of the derivative of the residuals' means, in standard deviations.
        left: Vector whose product with `right` of another parameter is their information.
        right: The same vector with the states' part multiplied by the inverse of A.
    """

    misfit: float
    width: float
    shift: float
    left: Array
    right: Array

    def halfway_to(self, other: Change) -> Change:
        """Mean of two derivatives."""
        misfit, shift = 0.5 * (self.misfit + other.misfit), 0.5 * (self.shift + other.shift)
        left, right = 0.5 * (self.left + other.left), 0.5 * (self.right + other.right)
        return Change(misfit, 0.5 * (self.width + other.width), shift, left, right)


def slopes(changes: Sequence[Change | None], count: int) -> tuple[Array, Array]:
    """Gradient (P,) and information (P, P) of minus the log evidence, per degree of freedom.

    For a covariance that is too large by a factor exp(z), average and expected information differ
    by a factor exp(∓z); with their geometric mean, a Newton step restores z up to an error z³ / 24.
    For parameters that move means, both are equal.

    Args:
        changes: Derivatives by each parameter (P,); None where there is no estimate.
        count: Degrees of freedom.

    Returns:
        Gradient and information, zero for a parameter without an estimate.
    """
    size = len(changes)
    slope, scale, information = np.zeros(size), np.ones(size), np.zeros((size, size))
    for i, change in enumerate(changes):
        if change is not None:
            slope[i] = change.misfit + change.width
            both = change.width * change.misfit < 0.0 and NUDGE * change.shift < _STILL
            ratio = abs(change.width / change.misfit) if both else 1.0
            scale[i] = np.clip(ratio, 1.0 / _MOST, _MOST) ** 0.25
            information[i] = [0.0 if c is None else change.left @ c.right for c in changes]
    values, vectors = np.linalg.eigh(scale[:, None] * (information + information.T) * scale)
    information = (vectors * np.maximum(0.5 * values, 0.0)) @ vectors.T
    return slope / count, information / count


class EvidenceAt:
    """Evidence of cases near a robot file, linearised at given estimates."""

    def __init__(
        self, cases: Sequence[RecordingCase], document: Document, starts: Sequence[Start]
    ) -> None:
        """Linearise every case.

        Args:
            cases: Windows of recordings.
            document: The robot file.
            starts: Estimate of each case with that file.
        """
        robot = _robot(document)
        self._cases = [_Linearized(*each, robot) for each in zip(cases, starts, strict=True)]

    def change(self, nudged: Document, *finely: Document) -> Change:
        """Derivatives by one parameter.

        Args:
            nudged: The robot file with the parameter moved by `NUDGE`.
            finely: The robot files with the parameter moved by `FINE` and by −`FINE`, which are
                used if `NUDGE` moves the means of residuals by too much.
        """
        change, width = self._change(nudged, NUDGE), self._width(nudged)
        if NUDGE * change.shift >= _STILL:
            forth, back = map(self._change, finely, (FINE, -FINE))
            change = forth.halfway_to(back)
        return change._replace(width=width)

    def _change(self, document: Document, nudge: float) -> Change:
        """Difference quotients to a robot file whose parameter is moved by `nudge`; width 0."""
        robot = _robot(document)
        parts = [case.change(robot, nudge) for case in self._cases]
        misfit, shift = sum(part.misfit for part in parts), [part.shift for part in parts]
        left, right = (np.concatenate([getattr(p, n) for p in parts]) for n in ("left", "right"))
        return Change(misfit, 0.0, float(np.hypot.reduce(shift)), left, right)

    def _width(self, document: Document) -> float:
        """Difference quotient of the log determinants to a robot file moved by `NUDGE`."""
        robot = _robot(document)
        return sum(case.change_of_width(robot, NUDGE) for case in self._cases)


class _Linearized:
    """A case, linearised at an estimate."""

    def __init__(self, case: RecordingCase, start: Start, robot: Robot) -> None:
        assert start.state is not None
        self._case, self._start, self._state = case, start, start.state
        prior, located = robot.prior, self._located(robot)
        size = located.parameters.process.size + self._state.numbers
        self._memory = np.empty(system_shape(located.grid.time.size, size))
        equations = linearize(prior, located, self._state, self._state)
        self._cholesky = factor(equations.system)
        self._terms, self._rhs = equations.terms, equations.rhs
        self._remaining_step = self._cholesky.solve(equations.rhs)
        self._misfit, self._width = _cost(equations), self._width_of(equations, robot)

    def _located(self, robot: Robot) -> LocatedReadings:
        """Readings located on the grid, with sensor parameters and arclengths of the estimate."""
        known = [parameter for parameter in robot.sensor_parameters if parameter.known]
        grid, prior = self._case.grid(robot), robot.prior
        readings = [corrected(r, known) for r in self._case.readings(robot)]
        placed = [place_in_channel(r, prior, grid, self._state) for r in readings]
        located = locate(grid, placed, robot.sensor_parameters)
        return with_parameters(located, self._start.sensor_parameters)

    def _width_of(self, at: NormalEquations, robot: Robot) -> float:
        """½ (log det A + log det R) less the log normaliser of the prior's factors."""
        whole = 0.5 * (factor(at.system).log_det + at.log_det_noise)
        grid, prior = self._case.grid(robot), robot.prior
        return whole - log_normalizer(prior, grid, at.state, at.state)

    def change_of_width(self, robot: Robot, nudge: float) -> float:
        """Difference quotient of the log determinants, each at its own robot's estimate."""
        perturbed = linearize(*self._problem(robot))
        step = self._cholesky.solve(perturbed.rhs - self._rhs)
        of_nodes, of_parameters = perturbed.split(step)
        state, located = self._state.retract(of_nodes), perturbed.located.moved(of_parameters)
        equations = linearize(robot.prior, located, state, state, self._memory)
        return (self._width_of(equations, robot) - self._width) / nudge

    def _problem(self, robot: Robot) -> tuple[Prior, LocatedReadings, State, State, Array]:
        """Arguments of `linearize` for another robot at the fixed estimate."""
        return robot.prior, self._located(robot), self._state, self._state, self._memory

    def change(self, robot: Robot, nudge: float) -> Change:
        """Difference quotients to another robot at the fixed estimate."""
        problem = self._problem(robot)
        perturbed = linearize(*problem)
        remaining = np.vdot(self._remaining_step, perturbed.rhs - self._rhs)
        means, fixed_cov_rhs = _residual_changes(self._terms, perturbed.terms) / nudge, self._rhs
        misfit = float(_cost(perturbed) - remaining - self._misfit) / nudge
        if means.any():
            fixed_cov_rhs = linearize(*problem, self._terms).rhs
        covs = _covariance_changes(self._terms, perturbed.terms) / nudge
        left, right = [], []
        for share, own, of_states in (
            (1.0, means, fixed_cov_rhs - self._rhs),
            (np.sqrt(0.5), covs, perturbed.rhs - fixed_cov_rhs),
        ):
            of_states = of_states / nudge
            left += [share * own, -share * of_states.ravel()]
            right += [share * own, share * self._cholesky.solve(of_states).ravel()]
        shift = float(np.linalg.norm(means))
        return Change(misfit, 0.0, shift, np.concatenate(left), np.concatenate(right))


def _robot(document: Document) -> Robot:
    return parse_robot(Table(document, "learned", GlissandoError))


def _cost(at: NormalEquations) -> float:
    return at.cost_of(at)


def _residual_changes(before: Sequence[Residuals], after: Sequence[Residuals]) -> Array:
    """Changes of residuals (M,), whitened with the covariances before."""
    pairs = zip(before, after, strict=True)
    return np.concatenate(
        [_weighted(old, old.whiten(new.residual - old.residual)) for old, new in pairs]
    )


def _covariance_changes(before: Sequence[Residuals], after: Sequence[Residuals]) -> Array:
    """Changes of R times R⁻¹e (M,) to first order, whitened with the covariances before."""
    parts = []
    for old, new in zip(before, after, strict=True):
        wide = np.einsum("mji,mj->mi", new.sqrt_info, new.whiten(old.residual))
        back = np.linalg.solve(old.sqrt_info.swapaxes(1, 2), wide[..., None])[..., 0]
        parts.append(_weighted(old, old.whiten(old.residual) - back))
    return np.concatenate(parts)


def _weighted(terms: Residuals, white: Array) -> Array:
    """Whitened values (M,), weighted by the robust loss of the residuals."""
    return np.ravel(np.sqrt(terms.robust_weights())[:, None] * white)
