"""Criteria by which an iteration ends: the last step and all later ones are negligible."""

from __future__ import annotations

import numpy as np

_IDLE = 3.0  # tolerances: a step this short that does not lower the cost ends the search
_CALMER = 0.5  # ratio to the step before above which steps do not shrink
_STALLED = 5  # steps that together do not lower the cost end the search
_SLOWEST = 0.05  # least relative decrease from step to step that is extrapolated
_STEADY = 0.05  # least ratio of a Gauss–Newton step to the one before that is extrapolated
_SURE = 0.2  # tolerances: a next step this short need not be far shorter than the last
_FALLING = 0.1  # ratio to the step before below which steps converge
_ROUND = 3  # steps that are compared with as many before, where they shrink unevenly


class StepLengths:
    """Lengths of steps, in standard deviations, and the criteria by which they end an iteration.

    If steps shrink at a constant rate, the remaining distance is the sum of a geometric series.
    Where no weight depends on the residuals, a step far shorter than the one before is followed by
    shorter ones, and only that sum must be negligible. Steps that shrink unevenly, as with weights
    that oscillate, are compared with the third step before. Readings that move across nodes leave
    kinks in the cost, far smaller than its uncertainty: there, steps that no longer shrink are
    accepted, and at a kink itself they may be long without lowering the cost. Where the cost curves
    more than the linearised residuals predict, whole steps overshoot the minimum and damped ones
    approach it slowly: a negligible fall in cost shows that it is near. Weights that depend on the
    state may oscillate with it by less than the tolerance: then either state is accepted.

    Attributes:
        first: Length of the first step.
        length: Length of the last step.
        idle: Whether the last step is so short that the search ends if the cost does not fall.
        short: Whether the last step and all that would follow are negligible.
        last: Whether steps that follow renewed weights no longer shrink, but oscillate.
        doubtful: Whether a short last step must be confirmed by the length of the next.
    """

    def __init__(self, tolerance: float, *, kinks: bool, weighted: bool) -> None:
        self._tolerance, self._kinks, self._weighted = tolerance, kinks, weighted
        self.first, self.length, self._renewed = np.nan, np.inf, np.inf
        self._costs: list[float] = []
        self._damped = 0
        self._moves: list[float] = []
        self.idle = self.short = self.last = self.doubtful = False

    def note(self, length: float, *, damped: bool, renewed: bool, turns_back: bool = False) -> None:
        """Record the next step and evaluate the criteria.

        Args:
            length: Length of the step.
            damped: Whether the step is damped.
            renewed: Whether the step is the first after weights were renewed.
            turns_back: Whether the step opposes the last one that followed renewed weights.
        """
        before = np.inf if damped else self._renewed if renewed else self.length
        if np.isnan(self.first):
            self.first = length
        self._record_move(length, damped=damped, renewed=renewed)
        self._damped = self._damped + 1 if damped else 0
        self.idle = not damped and length < _IDLE * self._tolerance
        rate = length / before if before else np.inf
        self.short = not damped and (self._is_short(length, rate) or self._rounds_converged)
        self.doubtful = not self._kinks and length > _SLOWEST * self._tolerance
        if renewed:
            small = length < self._tolerance and turns_back
            self.last = (self._kinks or small) and length > _CALMER * self._renewed
            self._renewed, self._costs = length, []
        self.length = length

    def confirms(self, length: float) -> bool:
        """Whether a next step of this length is as short as the last one predicts."""
        rate = length / self.length
        if self._rounds_converged:
            return length <= self._longest
        sure = rate < _FALLING or length < _SURE * self._tolerance
        return sure and self._is_short(length, rate)

    def _record_move(self, length: float, *, damped: bool, renewed: bool) -> None:
        """Record the lengths of undamped steps, one for each state."""
        if damped:
            self._moves = []
        elif renewed and self._moves:
            self._moves[-1] = length
        else:
            self._moves = [*self._moves[1 - 2 * _ROUND :], length]

    @property
    def _longest(self) -> float:
        """Longest of the last `_ROUND` steps."""
        return max(self._moves[-_ROUND:], default=np.inf)

    @property
    def _rounds_converged(self) -> bool:
        """Whether rounds of steps that shrink like the last round leave a negligible distance."""
        if len(self._moves) < 2 * _ROUND:
            return False
        before, last = self._moves[:_ROUND], self._moves[_ROUND:]
        rates = [late / early for early, late in zip(before, last, strict=True)]
        rate = max(*rates, (last[-1] / last[0]) ** (_ROUND / (_ROUND - 1)))
        remaining = _ROUND * self._longest * rate / max(1.0 - rate, _SLOWEST)
        return max(self._longest, remaining) < self._tolerance

    def _is_short(self, length: float, rate: float) -> bool:
        """Whether a step, `rate` times as long as the one before, is short enough to end with."""
        if self._kinks:
            return length < self._tolerance or (self.idle and rate > _CALMER)
        remaining = length * max(rate, _STEADY) / max(1.0 - rate, _SLOWEST)
        if not self._weighted and 0.0 < rate < _FALLING:
            return remaining < self._tolerance
        return max(length, remaining) < self._tolerance

    @property
    def creep(self) -> bool:
        """Whether all of the last steps were damped."""
        return self._damped >= _STALLED

    def stall(self, cost: float) -> bool:
        """Whether the last steps did not lower the cost; `cost` is that after the last one."""
        self._costs.append(cost)
        if len(self._costs) <= _STALLED:
            return False
        return self._costs[-1 - _STALLED] - cost < 0.5 * self._tolerance**2
