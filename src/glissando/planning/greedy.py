"""A path chosen place by place, each the one that helps most: a check on the planner.

The second method shares nothing with the first but the readings: covariances instead of
information, low-rank updates of one dense matrix, places out of a list instead of a descent. A gain
rarely grows as more is known, so old gains are bounds that spare most evaluations (Minoux 1978).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.geometry.se3 import Array
from glissando.planning.path_objective import PathObjective, by_cell
from glissando.planning.path_space import PathSpace
from glissando.solver.block_tridiagonal import BlockTridiagonal


@dataclass
class Belief:
    """Covariance (K d, K d) of the modes at all times, updated reading by reading."""

    judge: PathObjective
    cov: Array

    @staticmethod
    def before(judge: PathObjective) -> Belief:
        """What is known before any reading of the time ahead."""
        return Belief(judge, np.asarray(np.linalg.inv(_dense(judge.outlook.modes.system))))

    def _gain(self, rows: Array, cell: int) -> tuple[Array, Array]:
        """cov(all, readings) (K d, m) and whitener (m, m) of readings (m, 2 d) in a time cell."""
        size = rows.shape[1] // 2
        cross = self.cov[:, cell * size : (cell + 2) * size] @ rows.T
        own = rows @ cross[cell * size : (cell + 2) * size]
        return cross, np.linalg.inv(np.linalg.cholesky(own + np.eye(len(rows))))

    def update(self, rows: Array, cell: int) -> None:
        """Take readings into account."""
        cross, whitener = self._gain(rows, cell)
        told = cross @ whitener.T
        self.cov -= told @ told.T

    def zone_cov(self) -> Array:
        """Covariance (Z, p, p) of the zones' points."""
        judge, size = self.judge, self.judge.outlook.modes.system.diagonal.shape[1]
        at = judge.cell[:, None] * size + np.arange(2 * size)
        pairs = self.cov[at[:, :, None], at[:, None, :]] - judge.outlook.modes.pair[judge.cell]
        return judge.before + judge.rows @ pairs @ np.swapaxes(judge.rows, -1, -2)

    def value_with(self, cov: Array, rows: Array, cell: int) -> float:
        """The objective after such readings, if the zones' covariance is `cov` before them."""
        judge, size = self.judge, rows.shape[1] // 2
        cross, whitener = self._gain(rows, cell)
        at = judge.cell[:, None] * size + np.arange(2 * size)
        told = judge.rows @ (cross @ whitener.T)[at]
        return judge.objective(cov - told @ np.swapaxes(told, -1, -2), judge.weight)[0]


def plan_greedily(judge: PathObjective, track: PathSpace, places: int = 8) -> tuple[Array, float]:
    """Control points (T + 2,) of a path through stops chosen one by one, and its value.

    A stop is one of `places` of the track, for the length of a time cell; the sensor can be at rest
    at all of them.
    """
    outlook = judge.outlook
    cells = len(outlook.modes.pair)
    inside = outlook.inside
    stops = np.linspace(track.lower, track.upper, places)
    with one_thread():
        tables = [by_cell(judge.readings(np.full(outlook.steps, s))[0], inside) for s in stops]
        belief, chosen = Belief.before(judge), {-1: track.start}
        cov = belief.zone_cov()
        value = judge.objective(cov, judge.weight)[0]
        queue = [(-np.inf, cell, i) for cell in range(cells) for i in range(places)]
        while queue:
            _, cell, i = heapq.heappop(queue)
            if cell in chosen or not _reachable(track, chosen, cell, stops[i], inside):
                continue
            gain = value - belief.value_with(cov, tables[i][cell], cell)
            if queue and -gain > queue[0][0] + 1e-15:
                heapq.heappush(queue, (-gain, cell, i))
                continue
            belief.update(tables[i][cell], cell)
            chosen[cell] = float(stops[i])
            cov = belief.zone_cov()
            value = judge.objective(cov, judge.weight)[0]
        control = track.follow(_through(track, chosen, inside))
        return control, judge.value(track.places(control))


def _reachable(
    track: PathSpace, chosen: dict[int, float], cell: int, stop: float, inside: int
) -> bool:
    """Whether the sensor can rest there during a cell and at the stops chosen before and after."""
    for other, place in chosen.items():  # the start counts as the cell before the first
        way, span = abs(place - stop), (abs(other - cell) - 1) * inside * track.step
        least = way / track.speed + track.speed / track.acceleration
        if way < track.speed**2 / track.acceleration:
            least = 2.0 * np.sqrt(way / track.acceleration)
        if way > 1e-9 and span < least:
            return False
    return True


def _through(track: PathSpace, chosen: dict[int, float], inside: int) -> Array:
    """Where a path through the stops wants to be (T + 2,)."""
    cells = sorted(c for c in chosen if c >= 0)
    ends = [[c * inside * track.step, (c + 1) * inside * track.step - 1e-9] for c in cells]
    time = np.concatenate([[0.0], *ends])
    place = np.concatenate([[chosen[-1]], *([chosen[c]] * 2 for c in cells)])
    return np.interp(track.control_times, time, place)


def _dense(matrix: BlockTridiagonal) -> Array:
    k, size = matrix.diagonal.shape[:2]
    out = np.zeros((k * size, k * size))
    for i in range(k):
        own, later = slice(i * size, (i + 1) * size), slice((i + 1) * size, (i + 2) * size)
        out[own, own] = matrix.diagonal[i]
        if i + 1 < k:
            out[later, own], out[own, later] = matrix.lower[i], matrix.lower[i].T
    return out
