"""Steps of a linearised problem, damped where the cost does not fall (Levenberg, Marquardt)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from glissando.errors import UnobservableError
from glissando.geometry.se3 import Array
from glissando.solver.block_tridiagonal import Cholesky, factor
from glissando.solver.linearize import NormalEquations
from glissando.solver.step_search import WORTHWHILE

RESCUES = (1e-11, 1e-9, 1e-7)
"""Dampings, relative to the scale, tried in turn on a system that is singular by rounding."""
_FIRST, _MOST = 1e-4, 1e8  # damping after a refused whole step; damping at which to give up
_FINER, _FINEST = 0.01, 1e-12  # factor on the first damping each time it helps; its least value
_MOST_RESCUES = 5  # most systems to be rescued so; then the error is raised


_NO_DIGITS = (
    "The prior determines every number, but its variances lie so many decades apart that rounding "
    "leaves no digits of some: make those of strains that hardly change larger, take fewer "
    "arclength nodes, or a window that lasts longer than a millisecond or two."
)


@contextmanager
def saying_why(*, determined: bool) -> Iterator[None]:
    """Attribute a singular system to rounding where the prior determines every unknown.

    Raises:
        UnobservableError: The system is singular.
    """
    try:
        yield
    except UnobservableError:
        if not determined:
            raise
        raise UnobservableError(_NO_DIGITS) from None


@dataclass(frozen=True)
class Step:
    """A step of the linearised problem.

    Attributes:
        cholesky: Factor of the system, damping included.
        step: The step (K, D).
        length: Length of the step, standard deviations.
        predicted: Fall in cost that the linearisation predicts.
        damped: Whether the step is damped.
    """

    cholesky: Cholesky
    step: Array
    length: float
    predicted: float
    damped: bool


class Damping:
    """Marquardt's damping, relative to a scale and adapted to the gain of each step.

    Args:
        determined: Whether the prior alone determines every unknown.
    """

    def __init__(self, *, determined: bool) -> None:
        self._value, self._first = 0.0, _FIRST
        self._rescues = _MOST_RESCUES if determined else 0

    @property
    def exhausted(self) -> bool:
        """Whether the damping is at its limit and the cost still does not fall."""
        return self._value > _MOST

    def step(self, here: NormalEquations, workspace: Cholesky | None) -> Step:
        """Solve for the next step; its factor overwrites `workspace`.

        Far from the minimum a system may be singular by rounding alone, as its diagonal spans
        thirteen decades: where the prior determines every unknown, a slight damping cures this.

        Raises:
            UnobservableError: A direction of the state is undetermined.
        """
        if not self._value and self._rescues:
            with suppress(UnobservableError):
                return self._solved(here, workspace)
            self._rescues -= 1
            for rescue in RESCUES:
                self._value = rescue
                with suppress(UnobservableError):
                    return self._solved(here, workspace)
        return self._solved(here, workspace)

    def _solved(self, here: NormalEquations, workspace: Cholesky | None) -> Step:
        extra = self._value * here.scale
        system = here.system.add_to_diagonal(extra) if self._value else here.system
        cholesky = factor(system, workspace)
        step = cholesky.solve(here.rhs)
        length = np.sqrt(np.maximum(np.sum(step * (here.rhs - extra * step)), 0.0))
        predicted = 0.5 * np.sum(step * (here.rhs + extra * step))
        return Step(cholesky, step, float(length), float(predicted), self._value > 0.0)

    def adapt(self, gain: float) -> None:
        """Damp less after a step that lowered the cost as predicted, more after one that did not.

        Reducing the damping by an amount that depends on the gain avoids that every other step is
        refused (Nielsen, 1999). In a long valley whole steps are refused again and again, and the
        first damping may make a step a thousand times too short: each time that it helps, the next
        first damping is smaller, and damping falls as far before a whole step is tried.

        Args:
            gain: Actual fall in cost over the predicted one; may be NaN.
        """
        at_first = self._value == self._first
        if not gain > WORTHWHILE:
            if at_first:
                self._first = min(_FIRST, self._first / _FINER)
            self._value = max(self._first, 4.0 * self._value)
            return
        if at_first:
            self._first = max(_FINEST, self._first * _FINER)
        shrunk = self._value * max(0.2, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
        self._value = 0.0 if shrunk < self._first else shrunk
