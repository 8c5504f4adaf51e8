"""Online: information on delays from the motion, and the part of it that is noise.

With s the slopes of readings in time and S their prior covariance with delays fixed, readings have
the information sᵀS⁻¹s on their delay, s⁻². In terms of the nodes it is sᵀR⁻¹s − bᵀA⁻¹b, with A the
information on the nodes, R the noise and b = JᵀR⁻¹s: nodes are eliminated one by one as they leave
a window, when their readings have been linearised for the last time. The same is computed for
slopes of pure noise: where a motion is smooth they may contribute most of the information.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from glissando.estimation.slope_share import share
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder

_MEMORY = 50.0  # intervals over which information is averaged
_DEVIATIONS = 3.0  # standard deviations by which motion must exceed noise, at each of many updates
_KINDS = 2  # kinds of slopes: of motion and of noise
_ROUNDING = 1e-13  # relative to a diagonal entry of the information


class Slopes(NamedTuple):
    """Slopes of a stream's readings.

    Attributes:
        stream: The stream's name.
        factors: Linearised readings (M) of the stream.
        by_time: Slopes (2, M, r) in time, s⁻¹: of motion and of noise.
    """

    stream: str
    factors: Factors
    by_time: Array


class SlopeInformation:
    """Information from motion and from noise on the delays of streams, as nodes leave a window.

    Attributes:
        total: For each stream (·, 3): information from motion and from noise, s⁻², since the window
            began and up to its oldest node, and number of scalar readings.
    """

    def __init__(self, streams: Sequence[str], columns: Sequence[int]) -> None:
        """Begin without readings.

        Args:
            streams: Names of the streams.
            columns: Columns of the sensor parameters that are delays.
        """
        self._streams, self._columns = list(streams), columns
        self._recent = np.zeros((len(self._streams), 3))

    def begin(self, layout: Layout, info: Array) -> None:
        """Begin a window with one node, on which there is prior information `info` (D, D)."""
        delays = [layout.nodes * layout.dof + column for column in self._columns]
        self._layout, self._others = layout, np.setdiff1d(np.arange(layout.size), delays)
        self._info = info[np.ix_(self._others, self._others)]
        self._rhs = np.zeros((self._others.size, len(self._streams) * _KINDS))
        self._squares, self.total = np.zeros((2, len(self._streams), 3))

    def copied(self) -> SlopeInformation:
        """A copy that can be changed without changing this one."""
        return copy(self)

    def share(self, stream: str) -> float:
        """Share of the motion's slope that counts for a stream."""
        of_motion, of_noise, numbers = self._recent[self._streams.index(stream)].tolist()
        return share(of_motion, of_noise, numbers, _DEVIATIONS)

    def note(self, sums: NormalEquationsBuilder, slopes: Sequence[Slopes]) -> None:
        """Record the last linearisation of a whole window.

        Args:
            sums: Sums of all factors, which are not overwritten before nodes leave.
            slopes: Slopes of the readings of all streams, in batches of one stream.
        """
        self._sums, self._slopes, self._oldest = sums, slopes, 0

    def drop(self) -> None:
        """Eliminate the oldest node, and count the information of readings up to the next."""
        interval, sums = self._oldest, self._sums
        rows = np.ix_(self._others, self._others)
        begin, end, across = (each[interval][rows] for each in (sums.begin, sums.end, sums.across))
        at_begin, at_end = self._slope_sums(interval)
        root, solved = _eliminated(self._info + begin, self._rhs + at_begin)
        coupling = solve_triangular(root, across.T, lower=True, check_finite=False)
        self._squares[:, :_KINDS] -= self._by_stream(solved)
        self._info, self._rhs = end - coupling.T @ coupling, at_end - coupling.T @ solved
        before, self.total = self.total, self._squares.copy()
        self.total[:, :_KINDS] -= self._by_stream(_eliminated(self._info, self._rhs)[1])
        self._recent = (1.0 - 1.0 / _MEMORY) * self._recent + self.total - before
        self._oldest += 1

    def _by_stream(self, solved: Array) -> Array:
        """Contributions to bᵀA⁻¹b by stream and kind, from the forward solution."""
        return np.sum(solved**2, axis=0).reshape(-1, _KINDS)

    def _slope_sums(self, interval: int) -> Array:
        """Sums b (2, D, ·) of an interval's readings at both ends; adds to sᵀR⁻¹s."""
        layout, rows = self._layout, (len(self._streams), _KINDS)
        n, last = layout.nodes, max(len(self._sums.begin) - 2, 0)
        of_nodes = np.zeros((2 * n, layout.dof, *rows))
        of_parameters = np.zeros((2, layout.parameters, *rows))
        for stream, factors, by_time in self._slopes:
            within = np.minimum(factors.nodes[:, 0] // n, last) == interval
            own, row = factors.take(within), self._streams.index(stream)
            terms, weights = own.terms, own.terms.robust_weights()[:, None]
            slopes = np.einsum("mij,amj->ami", terms.sqrt_info, by_time[:, within])
            pulls = np.einsum("mij,ami->maj", terms.sqrt_info, weights * slopes)
            b = np.einsum("mjcd,maj->mcda", own.jacobian, pulls)
            np.add.at(of_nodes[:, own.dofs, row], own.nodes - interval * n, b)
            if own.extras is not None:
                extras = own.extras.reshape(*terms.residual.shape, 2, layout.parameters)
                of_parameters[:, :, row] += np.einsum("mjte,maj->tea", extras, pulls)
            self._squares[row, :_KINDS] += np.sum(weights * slopes**2, axis=(1, 2))
            self._squares[row, _KINDS] += terms.residual.size
        out = np.concatenate([of_nodes.reshape(2, -1, *rows), of_parameters], axis=1)
        return out.reshape(2, layout.size, -1)[:, self._others]


def _eliminated(info: Array, rhs: Array) -> tuple[Array, Array]:
    """Cholesky factor of information (D, D), and right-hand sides (D, ·) solved with it."""
    root = cholesky(info + _ROUNDING * np.diag(np.diagonal(info)), lower=True, check_finite=False)
    return root, solve_triangular(root, rhs, lower=True, check_finite=False)
