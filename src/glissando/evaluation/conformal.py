"""Guarantees that need no model: a tube of whole blocks, and sets for the next reading online.

Split conformal prediction scores blocks of held-out truth by the largest normalised error at any
place; the tube is as wide as the right one of these scores. Online, adaptive conformal inference
widens and narrows sets so that their long-run miss rate is bounded for any data whatever.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence

import numpy as np

from glissando.errors import GlissandoError
from glissando.evaluation.metrics import Errors
from glissando.geometry.se3 import Array
from glissando.model.tube import Tube

_ROUNDING = 1e-6  # of a block, by which its last sample may come early
_REMEMBERED = 500  # scores that an adaptive set looks back on


def require_tube(seconds: float, level: float = 0.95) -> None:
    """Raise GlissandoError unless blocks can have this length, s, and a tube this level."""
    if not (math.isfinite(seconds) and seconds >= 0.0):
        raise GlissandoError(f"Blocks of {seconds:g} s cannot be; give 0 s or more.")
    if not 0.0 < level < 1.0:
        raise GlissandoError(f"A level of {level:g} is no probability; give one such as 0.95.")


def block_scores(errors: Sequence[Errors], seconds: float) -> Array:
    """Largest position error (B,) of each block of time, over all samples and sites.

    Errors are in standard deviations of the estimate alone, as the tube that holds them is drawn.

    Args:
        errors: Errors of each site.
        seconds: Length of a block, s; blocks without truth are left out, and the rest at the end
            that fills none. 0 makes every time one.

    Raises:
        GlissandoError: The length is negative or not finite.
    """
    require_tube(seconds)
    time = np.concatenate([np.zeros(0), *(e.time for e in errors)])
    score = np.concatenate([np.zeros(0), *(e.sigmas for e in errors)])
    time, score = time[~np.isnan(score)], score[~np.isnan(score)]
    if not time.size:
        return np.zeros(0)
    block = np.floor((time - time.min()) / seconds) if seconds else time
    if seconds:
        every = np.unique(time)
        end = every[-1] + (float(np.median(np.diff(every))) if every.size > 1 else 0.0)
        whole = block < np.floor((end - every[0]) / seconds + _ROUNDING)
        block, score = block[whole], score[whole]
        if not block.size:
            return np.zeros(0)
    _, which = np.unique(block, return_inverse=True)
    largest = np.zeros(which.max() + 1)
    np.maximum.at(largest, which, score)
    return largest


def conformal_tube(scores: Array, seconds: float, level: float = 0.95) -> Tube:
    """The narrowest tube that split conformal prediction promises a level for.

    Its width is the ⌈(B + 1) level⌉-th smallest of B scores.

    Args:
        scores: Scores (B,) of blocks that nothing was learned from.
        seconds: Length of a block, s.
        level: Probability that a further block lies wholly inside.

    Raises:
        GlissandoError: The length or the level is none, or there are too few blocks for it.
    """
    require_tube(seconds, level)
    needed = math.ceil(round((scores.size + 1) * level, 9))
    if needed > scores.size:
        least = math.ceil(round(level / (1.0 - level), 9))
        raise GlissandoError(
            f"A tube of {100 * level:g} % needs {least} blocks or more, and there are "
            f"{scores.size}; give longer recordings, shorter blocks, or a lower level."
        )
    return Tube(level, float(np.sort(scores)[needed - 1]), int(scores.size), seconds)


def inside_tube(tube: Tube, scores: Array) -> float:
    """Share of blocks, scores (B,), that lie wholly inside a tube."""
    return float(np.mean(scores <= tube.sigmas))


class AdaptiveSet:
    """Sets for the next score of a stream whose long-run miss rate is bounded for any data.

    The set holds scores up to a quantile of those of late. After a miss the next set is wider,
    else narrower: α ← α + γ (1 − level − missed). After T scores the miss rate differs from
    1 − level by less than `bound`, for whatever comes, corrupted or adversarial. Source: Gibbs and
    Candès, *Adaptive Conformal Inference Under Distribution Shift* (NeurIPS 2021), Proposition 4.1.
    """

    def __init__(self, level: float = 0.95, rate: float = 0.02) -> None:
        """Begin without scores.

        Args:
            level: Share of scores that sets should hold in the long run.
            rate: γ, how fast sets adapt.

        Raises:
            GlissandoError: The level or the rate lies outside (0, 1).
        """
        if not (0.0 < level < 1.0 and 0.0 < rate < 1.0):
            raise GlissandoError(f"Level {level:g} and rate {rate:g} must lie between 0 and 1.")
        self.level, self.rate = level, rate
        self.count = self.misses = 0
        self._miss_level = 1.0 - level
        self._recent: deque[float] = deque(maxlen=_REMEMBERED)
        self._ordered: list[float] = []

    @property
    def threshold(self) -> float:
        """The largest score in the next set: infinite for all scores, −inf for none."""
        if self._miss_level <= 0.0:
            return math.inf
        if self._miss_level >= 1.0:
            return -math.inf
        rank = math.ceil((1.0 - self._miss_level) * (len(self._ordered) + 1))
        return self._ordered[rank - 1] if rank <= len(self._ordered) else math.inf

    def update(self, score: float) -> bool:
        """Take the next score; returns whether its set missed it.

        NaN is a miss of finite sets, and every score one of a set that holds nothing.
        """
        threshold = self.threshold
        missed = threshold == -math.inf or not (threshold == math.inf or score <= threshold)
        self.count += 1
        self.misses += missed
        self._miss_level += self.rate * (1.0 - self.level - missed)
        if math.isfinite(score):
            if len(self._recent) == _REMEMBERED:
                del self._ordered[bisect_left(self._ordered, self._recent[0])]
            self._recent.append(score)
            insort(self._ordered, score)
        return missed

    @property
    def miss_rate(self) -> float:
        """Share of scores that were missed; NaN before the first."""
        return self.misses / self.count if self.count else math.nan

    @property
    def bound(self) -> float:
        """By how much the miss rate can differ from 1 − level at most, after so many scores."""
        if not self.count:
            return math.inf
        return (max(self.level, 1.0 - self.level) + self.rate) / (self.rate * self.count)
