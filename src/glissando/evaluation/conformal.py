"""Model-free guarantees: a tube for blocks of time, and prediction sets for the next reading.

Split conformal prediction scores blocks of held-out truth by the largest normalised error at any
place; the width of the tube is a quantile of these scores. Online, adaptive conformal inference
widens and narrows sets so that their long-run miss rate is bounded for any data.
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

_ROUNDING = 1e-6  # share of a block by which its last sample may be early
_REMEMBERED = 500  # most recent scores, from which the quantile of an adaptive set is taken


def require_tube(seconds: float, level: float = 0.95) -> None:
    """Raise GlissandoError unless the length of blocks, s, and the level of a tube are valid."""
    if not (math.isfinite(seconds) and seconds >= 0.0):
        raise GlissandoError(f"Blocks of {seconds:g} s cannot be; give 0 s or more.")
    if not 0.0 < level < 1.0:
        raise GlissandoError(f"A level of {level:g} is not a probability; give one such as 0.95.")


def block_scores(errors: Sequence[Errors], seconds: float) -> Array:
    """Largest normalised position error (B,) in each block of time, over all samples and sites.

    Errors are in standard deviations of the estimate, without the noise of truth, as the tube is.

    Args:
        errors: Errors of each site.
        seconds: Length of a block, s. Blocks without truth and an incomplete last block are left
            out. 0 makes each sample time a block.

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
    """The narrowest tube for which split conformal prediction guarantees a level.

    Its width is the ⌈(B + 1) level⌉-th smallest of B scores.

    Args:
        scores: Scores (B,) of held-out blocks, from which nothing was learned.
        seconds: Length of a block, s.
        level: Probability that a further block lies entirely inside the tube.

    Raises:
        GlissandoError: The length or level is invalid, or there are too few blocks for the level.
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
    """Share of blocks with scores (B,) that lie entirely inside a tube."""
    return float(np.mean(scores <= tube.sigmas))


class AdaptiveSet:
    """Prediction sets for the next score of a stream, with bounded long-run miss rate.

    A set contains scores up to a quantile of recent ones. After a miss the next set is wider, else
    narrower: α ← α + γ (1 − level − missed). After T scores the miss rate differs from 1 − level by
    at most `bound`, for any data, even corrupted or adversarial. Source: Gibbs and Candès,
    *Adaptive Conformal Inference Under Distribution Shift* (NeurIPS 2021), Proposition 4.1.
    """

    def __init__(self, level: float = 0.95, rate: float = 0.02) -> None:
        """Start without scores.

        Args:
            level: Share of scores that sets should contain in the long run.
            rate: Step size γ of the adaptation.

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
        """Largest score in the next set: inf if it contains all scores, −inf if none."""
        if self._miss_level <= 0.0:
            return math.inf
        if self._miss_level >= 1.0:
            return -math.inf
        rank = math.ceil((1.0 - self._miss_level) * (len(self._ordered) + 1))
        return self._ordered[rank - 1] if rank <= len(self._ordered) else math.inf

    def update(self, score: float) -> bool:
        """Add the next score, and return whether its set missed it.

        NaN is missed by every set with a finite threshold; an empty set misses every score.
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
        """Share of scores that were missed; NaN before the first score."""
        return self.misses / self.count if self.count else math.nan

    @property
    def bound(self) -> float:
        """Largest possible difference of the miss rate from 1 − level, after `count` scores."""
        if not self.count:
            return math.inf
        return (max(self.level, 1.0 - self.level) + self.rate) / (self.rate * self.count)
