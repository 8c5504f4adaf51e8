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
"""Dampings, in parts of the scale, that give a system far from its end its digits back."""
_FIRST, _MOST = 1e-4, 1e8  # damping after a whole step is refused; the one at which to give up
_FINER, _FINEST = 0.01, 1e-12  # what that first damping shrinks by when it helps; its least
_MOST_RESCUES = 5  # times that they do; then it says what it lacks


_NO_DIGITS = (
    "The prior determines every number, but its variances lie so many decades apart that rounding "
    "leaves no digits of some: make those of strains that hardly change larger, take fewer "
    "arclength nodes, or a window that lasts longer than a millisecond or two."
)


@contextmanager
def saying_why(*, determined: bool) -> Iterator[None]:
    """Say that a system is singular by rounding alone, where the prior determines every number.

    Raises:
        UnobservableError: It is singular.
    """
    try:
        yield
    except UnobservableError:
        if not determined:
            raise
        raise UnobservableError(_NO_DIGITS) from None


@dataclass(frozen=True)
class Step:
    """A step, and what it promises.

    Attributes:
        cholesky: The factor that it comes from, damping included.
        step: The step (K, D).
        length: Its length, standard deviations.
        predicted: The fall in cost that it promises.
        damped: Whether it was shortened.
    """

    cholesky: Cholesky
    step: Array
    length: float
    predicted: float
    damped: bool


class Damping:
    """Marquardt's damping, in parts of a scale, which adapts to how steps turn out.

    Args:
        determined: Whether the prior alone determines every number.
    """

    def __init__(self, *, determined: bool) -> None:
        self._value, self._first = 0.0, _FIRST
        self._rescues = _MOST_RESCUES if determined else 0

    @property
    def exhausted(self) -> bool:
        """Whether steps are damped to nothing and the cost still does not fall."""
        return self._value > _MOST

    def step(self, here: NormalEquations, workspace: Cholesky | None) -> Step:
        """The next step, its factor written over another.

        Far from its end a system may be singular by rounding alone, its diagonal of thirteen
        decades: where the prior determines every number, a trace of damping gives its digits back.

        Raises:
            UnobservableError: Something is undetermined.
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
        """Damp less after a step that kept its promise, more after one that did not.

        Shrinking in proportion to how well the promise was kept avoids refusing every other step
        (Nielsen, 1999). In a long valley whole steps are refused again and again, and a step that
        is damped at all may be a thousand times too short: each time that the first damping helps,
        the next one begins smaller, and damping falls as far before a whole step is tried.

        Args:
            gain: The part of the promised fall that came true, NaN included.
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
