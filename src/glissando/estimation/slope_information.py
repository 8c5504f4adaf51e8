"""Online: how much of what dates delayed readings is motion, and how much is noise.

With s the slopes of readings by the time they were taken, S their covariance before any was read
and delays held, they tell sᵀS⁻¹s of their delay, s⁻². A window has it as sᵀR⁻¹s − bᵀA⁻¹b, where A
is the information on its nodes, R the noise and b = JᵀR⁻¹s: what nodes that leave take of it is
kept with the prior on the next, as what readings say of the state is. The same is found of slopes
that are nothing but noise: where a motion is smooth those may tell most of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from glissando.estimation.slope_share import share
from glissando.estimation.window_system import WindowSystem
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder

_MEMORY = 50.0  # intervals over which it is found
_DEVIATIONS = 3.0  # by which motion has to tell more than noise, at each of many updates
_KINDS = 2  # of slopes: of motion and of noise


class Slopes(NamedTuple):
    """Slopes of a stream's readings.

    Attributes:
        stream: The stream's name.
        factors: Its linearised readings (M).
        by_time: Slopes (2, M, r) by the time, s⁻¹: of motion and of noise.
    """

    stream: str
    factors: Factors
    by_time: Array


class SlopeInformation:
    """What motion and noise tell some streams of their delays, as a window goes on.

    Attributes:
        total: Of each stream (·, 3) what motion tells and what noise tells, s⁻², since the window
            began, and of how many numbers of readings.
    """

    def __init__(self, streams: Sequence[str], columns: Sequence[int]) -> None:
        """Begin without readings.

        Args:
            streams: Names of the streams.
            columns: Which sensor parameters are delays.
        """
        self._streams, self._columns = list(streams), columns
        self._recent = np.zeros((len(self._streams), 3))

    def begin(self, layout: Layout, info: Array) -> None:
        """Begin a window with one node, of whose numbers `info` (D, D) is known."""
        self._delays = [layout.nodes * layout.dof + column for column in self._columns]
        held, count = info.copy(), len(self._streams)
        self._hold(held[None])
        held[self._delays, self._delays] = 1.0
        self._system = WindowSystem(layout, held, np.zeros(len(info)), _KINDS * count)
        self._oldest, self._left, self.total, self._counted = np.zeros((4, count, 3))

    def _hold(self, blocks: Array) -> None:
        """Take what is known of delays out of blocks (K, D, D), in place."""
        blocks[:, self._delays] = 0.0
        blocks[:, :, self._delays] = 0.0

    def append(self) -> None:
        """One node more."""
        self._system.append()

    def drop(self) -> None:
        """Leave the oldest node behind, and count what was read since the last one left."""
        self._recent = (1.0 - 1.0 / _MEMORY) * self._recent + self.total - self._counted
        self._counted = self.total
        self._left = self._left + self._oldest
        self._left[:, :_KINDS] -= self._solved()[..., 0]
        self._system.drop()

    def copied(self) -> SlopeInformation:
        """The same, to go on with without a change to this one."""
        out = copy(self)
        out._system = self._system.copied()
        return out

    def share(self, stream: str) -> float:
        """How much of the motion's slope counts for a stream."""
        told, of_noise, numbers = self._recent[self._streams.index(stream)].tolist()
        return share(told, of_noise, numbers, _DEVIATIONS)

    def note(self, sums: NormalEquationsBuilder, slopes: Sequence[Slopes]) -> None:
        """Find what the readings of the whole window tell.

        Args:
            sums: Of all factors of the window, with delays that move.
            slopes: Those of each stream, of some of its readings at a time.
        """
        held = self._system.builder(0)
        for own, others in zip(held.sums, sums.sums, strict=True):
            own[:] = others
        for blocks in (held.begin, held.end, held.across):
            self._hold(blocks)
        held.begin[:, self._delays, self._delays] = 1.0
        self._system.solve(0, held)
        self._oldest, self.total = np.zeros((2, len(self._streams), 3))
        for i, stream in enumerate(self._streams):
            mine = [found for found in slopes if found.stream == stream]
            for kind in range(_KINDS):
                self._respond(mine, kind, _KINDS * i + kind)
            for found in mine:
                self._add(i, found)
        self.total += self._left
        self.total[:, :_KINDS] -= self._solved().sum(axis=-1)

    def _respond(self, slopes: Sequence[Slopes], kind: int, which: int) -> None:
        """Solve for slopes in the place of residuals."""
        builder = NormalEquationsBuilder.apart(self._system.layout, len(self._system))
        for found in slopes:
            terms = replace(found.factors.terms, residual=found.by_time[kind])
            factors = replace(found.factors, terms=terms, extras=None)
            builder.accumulate(factors, found.factors.terms.robust_weights())
        self._system.respond(0, builder, which)

    def _add(self, row: int, slopes: Slopes) -> None:
        """Add sᵀR⁻¹s of some readings, and how many numbers they are."""
        terms, m = slopes.factors.terms, slopes.by_time.shape[1]
        squares = np.empty((m, 3))
        squares[:, 2] = slopes.by_time.shape[2]
        for kind in range(_KINDS):
            white = terms.whiten(slopes.by_time[kind])
            squares[:, kind] = terms.robust_weights() * np.sum(white**2, axis=1)
        self.total[row] += squares.sum(axis=0)
        oldest = slopes.factors.nodes.min(axis=1) < self._system.layout.nodes
        self._oldest[row] += squares[oldest].sum(axis=0)

    def _solved(self) -> Array:
        """Each slab's part of bᵀA⁻¹b, by stream and kind (streams, 2, K)."""
        squares = np.sum(self._system.responses**2, axis=-1)
        return squares.reshape(len(self._streams), _KINDS, -1)
