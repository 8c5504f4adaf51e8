"""A path chosen place by place, each the one that helps most: an oracle of the planner.

The method shares nothing with the planner but the readings: covariances instead of information,
low-rank updates of one dense matrix, places out of a list instead of a descent. A gain rarely grows
as more is known, so old gains are bounds that spare most evaluations (Minoux 1978).
"""

from __future__ import annotations

import heapq

import numpy as np

from glissando.geometry.se3 import Array
from glissando.planning.path_objective import PathObjective, by_cell
from glissando.planning.path_space import PathSpace

_PLACES = 8  # places of the reach among which a stop is chosen


class DenseModes:
    """Covariance (K d, K d) of the modes at all times, updated reading by reading."""

    def __init__(self, path_objective: PathObjective) -> None:
        self.path_objective, self.modes = path_objective, path_objective.problem.modes
        system = self.modes.system
        k_count, size = system.diagonal.shape[:2]
        information = np.zeros((k_count, size, k_count, size))
        for k in range(k_count):
            information[k, :, k] = system.diagonal[k]
        for k, lower in enumerate(system.lower):
            information[k + 1, :, k], information[k, :, k + 1] = lower, lower.T
        self.cov = np.linalg.inv(information.reshape(k_count * size, -1))
        self.columns = path_objective.cell[:, None] * size + np.arange(2 * size)

    def _change(self, rows: Array, cell: int) -> Array:
        """The root (K d, m) of what readings (m, 2 d) in a time cell take off the covariance."""
        own = slice(cell * rows.shape[1] // 2, (cell + 2) * rows.shape[1] // 2)
        cross = self.cov[:, own] @ rows.T
        root = np.linalg.cholesky(rows @ cross[own] + np.eye(len(rows)))
        return np.linalg.solve(root, cross.T).T

    def update(self, rows: Array, cell: int) -> None:
        """Take readings into account."""
        change = self._change(rows, cell)
        self.cov -= change @ change.T

    def zone_cov(self) -> Array:
        """Covariance (Z, p, p) of the zones' points."""
        rows = self.path_objective.rows
        cov = self.cov[self.columns[:, :, None], self.columns[:, None, :]]
        cov = cov - self.modes.pair[self.path_objective.cell]
        return self.path_objective.prior_cov + rows @ cov @ rows.mT

    def value(self) -> float:
        """The objective now."""
        return self.path_objective.objective(self.zone_cov(), self.path_objective.weight)[0]

    def value_with(self, zone_cov: Array, rows: Array, cell: int) -> float:
        """The objective after such readings, if the zones' covariance is `zone_cov` before them."""
        change = self.path_objective.rows @ self._change(rows, cell)[self.columns]
        cov = zone_cov - change @ change.mT
        return self.path_objective.objective(cov, self.path_objective.weight)[0]


def plan_greedily(path_objective: PathObjective, path_space: PathSpace) -> float:
    """The value of a path through stops chosen one by one, each for the length of a time cell."""
    problem = path_objective.problem
    places = np.linspace(path_space.lower, path_space.upper, _PLACES)
    inside = problem.steps_per_cell
    tables = [
        by_cell(path_objective.readings(np.full(problem.steps, place))[0], inside)
        for place in places
    ]
    modes, stops = DenseModes(path_objective), {-1: path_space.start}
    cov, value = modes.zone_cov(), modes.value()
    queue = [(-np.inf, cell, i) for cell in range(len(tables[0])) for i in range(_PLACES)]
    while queue:
        _, cell, i = heapq.heappop(queue)
        if cell in stops or not _reachable(path_space, stops, cell, places[i], inside):
            continue
        gain = value - modes.value_with(cov, tables[i][cell], cell)
        if queue and -gain > queue[0][0] + 1e-15:
            heapq.heappush(queue, (-gain, cell, i))
            continue
        modes.update(tables[i][cell], cell)
        stops[cell] = float(places[i])
        cov, value = modes.zone_cov(), modes.value()
    control = path_space.follow(_through(path_space, stops, inside))
    return path_objective.value(path_space.arclength(control))


def _reachable(
    space: PathSpace, stops: dict[int, float], cell: int, place: float, inside: int
) -> bool:
    """Whether the sensor can rest there during a cell and at the other stops in theirs."""
    for other, stop in stops.items():  # the start counts as the cell before the first
        way, span = abs(stop - place), (abs(other - cell) - 1) * inside * space.step
        least = way / space.speed + space.speed / space.acceleration
        if way < space.speed**2 / space.acceleration:
            least = 2.0 * np.sqrt(way / space.acceleration)
        if way > 1e-9 and span < least:
            return False
    return True


def _through(space: PathSpace, stops: dict[int, float], inside: int) -> Array:
    """Target (T + 2,) of a path through the stops."""
    cells, cell = np.array(sorted(c for c in stops if c >= 0)), inside * space.step
    ends = np.stack([cells * cell, (cells + 1) * cell - 1e-9], axis=1).ravel()
    place = np.repeat([stops[c] for c in cells], 2)
    return np.interp(space.control_times, [0.0, *ends], [stops[-1], *place])
