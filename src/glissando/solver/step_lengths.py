"""When an iteration ends: steps that are negligible, and those that would follow as well."""

from __future__ import annotations

import numpy as np

_IDLE = 3.0  # tolerances: a step this short that gains nothing ends the search
_CALMER = 0.5  # part of the step before above which steps do not shrink
_STALLED = 5  # steps that together gain nothing end the search
_SLOWEST = 0.05  # least share by which steps count as shrinking
_STEADY = 0.05  # part of itself that a Gauss–Newton step leaves to go at best, near the end
_SURE = 0.2  # tolerances: a next step this short needs not be far shorter than the last
_FALLING = 0.1  # part of the step before below which steps are on their way to the end
_ROUND = 3  # steps that are compared with as many before, where they shrink unevenly


class StepLengths:
    """Lengths of steps, in standard deviations, and whether one is short enough to end with.

    Steps that shrink evenly leave a geometric series to go. Where no weight depends on the
    residuals, a step that is a small part of the one before is followed by smaller ones, and
    what it leaves decides. Steps that shrink unevenly, as they do where weights go to and fro, are
    compared with those three before. Readings that move across nodes leave kinks in the cost,
    below any confidence: steps that no longer shrink are as short as they get, and in a kink
    itself, where none leads down for long, they may be long and gain nothing. Where the cost bends
    more than its linearised residuals say, whole steps leap over the minimum, and damped ones creep
    up to it: the fall in cost tells that they are near. Weights that depend
    on the state may go to and fro with it, by less than the tolerance: then one side is as good as
    the other.

    Attributes:
        first: Length of the first step.
        length: Length of the last one.
        idle: Whether it is so short that the search ends if it gains nothing.
        short: Whether it, and with it all that would follow, is negligible.
        last: Whether steps that follow renewed weights no longer shrink, but go to and fro.
        doubtful: Whether it is short, but the next one by itself may be too long to end with.
    """

    def __init__(self, tolerance: float, *, kinks: bool, weighted: bool) -> None:
        self._tolerance, self._kinks, self._weighted = tolerance, kinks, weighted
        self.first, self.length, self._renewed = np.nan, np.inf, np.inf
        self._costs: list[float] = []
        self._damped = 0
        self._moves: list[float] = []
        self.idle = self.short = self.last = self.doubtful = False

    def note(self, length: float, *, damped: bool, renewed: bool, turns_back: bool = False) -> None:
        """Take the length of the next step.

        Args:
            length: Its length.
            damped: Whether it is damped.
            renewed: Whether it is the first with renewed weights, one of a series of such.
            turns_back: Whether it then leads back from where the one before of that series led.
        """
        before = np.inf if damped else self._renewed if renewed else self.length
        if np.isnan(self.first):
            self.first = length
        self._move(length, damped=damped, renewed=renewed)
        self._damped = self._damped + 1 if damped else 0
        self.idle = not damped and length < _IDLE * self._tolerance
        rate = length / before if before else np.inf
        self.short = not damped and (self._is_short(length, rate) or self._is_over)
        self.doubtful = not self._kinks and length > _SLOWEST * self._tolerance
        if renewed:
            small = length < self._tolerance and turns_back
            self.last = (self._kinks or small) and length > _CALMER * self._renewed
            self._renewed, self._costs = length, []
        self.length = length

    def confirms(self, length: float) -> bool:
        """Whether the next step, of that length, is as short as the last one promised."""
        rate = length / self.length
        if self._is_over:
            return length <= self._longest
        sure = rate < _FALLING or length < _SURE * self._tolerance
        return sure and self._is_short(length, rate)

    def _move(self, length: float, *, damped: bool, renewed: bool) -> None:
        """Note how long whole steps were, once from each place."""
        if damped:
            self._moves = []
        elif renewed and self._moves:
            self._moves[-1] = length
        else:
            self._moves = [*self._moves[1 - 2 * _ROUND :], length]

    @property
    def _longest(self) -> float:
        """The longest of the last steps."""
        return max(self._moves[-_ROUND:], default=np.inf)

    @property
    def _is_over(self) -> bool:
        """Whether rounds of steps that shrink as the last one did leave a negligible way."""
        if len(self._moves) < 2 * _ROUND:
            return False
        before, last = self._moves[:_ROUND], self._moves[_ROUND:]
        rates = [late / early for early, late in zip(before, last, strict=True)]
        rate = max(*rates, (last[-1] / last[0]) ** (_ROUND / (_ROUND - 1)))
        left = _ROUND * self._longest * rate / max(1.0 - rate, _SLOWEST)
        return max(self._longest, left) < self._tolerance

    def _is_short(self, length: float, rate: float) -> bool:
        """Whether a step is short enough, the `rate` times as long as the one before."""
        if self._kinks:
            return length < self._tolerance or (self.idle and rate > _CALMER)
        left = length * max(rate, _STEADY) / max(1.0 - rate, _SLOWEST)
        if not self._weighted and 0.0 < rate < _FALLING:
            return left < self._tolerance
        return max(length, left) < self._tolerance

    @property
    def creep(self) -> bool:
        """Whether all of the last steps were damped."""
        return self._damped >= _STALLED

    def stall(self, cost: float) -> bool:
        """Whether steps gain nothing any more, by the cost after each, with weights held."""
        self._costs.append(cost)
        if len(self._costs) <= _STALLED:
            return False
        return self._costs[-1 - _STALLED] - cost < 0.5 * self._tolerance**2
