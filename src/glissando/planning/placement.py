"""Sensor placement: the set of candidates within a budget that makes zones least uncertain.

The robot holds its shape while all sensors read for some time. Each candidate then measures a few
of the directions in state space that matter to the zones, so a set is evaluated by one small
inverse. Sets are found greedily and improved by exchanges. A lower bound for all sets of the same
budget comes from the convex relaxation, in which fractions of candidates are bought. Source: Joshi
and Boyd (2009), Sensor selection via convex optimization; equation (23).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy.optimize

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.robot import Robot
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.planning.belief import belief_of
from glissando.planning.candidates import Candidate
from glissando.planning.prediction import PredictedInformation, Rows, look_ahead
from glissando.planning.zones import Zone, zone_points
from glissando.solver.block_tridiagonal import factor

_NUMBERS = 1000  # state variables of all nodes together, approximately
_INSIDE = 2  # readings per time cell that represent all readings in it
_LEFT = 1e-2  # share of the variance after all sensors that neglected directions gain in sum
_PAIRS = 6  # largest set in which pairs of sensors are exchanged
_GAIN = 1e-6  # least relative decrease of the variance for an exchange


@dataclass(frozen=True)
class Placement:
    """A set of sensors, and the uncertainty that remains with it.

    Attributes:
        budget: Largest cost allowed.
        cost: Cost of the set.
        chosen: The sensors, in the order in which they were found.
        std: Root of the mean position variance in the zones, m.
        bound: Lower bound of `std` for all sets within the budget, m.
    """

    budget: float
    cost: float
    chosen: tuple[Candidate, ...]
    std: float
    bound: float


@dataclass(frozen=True)
class PlacementProblem:
    """Measurements of all candidates in d directions of state space with unit prior variance.

    Attributes:
        candidates: The sensors (C,).
        rows: Whitened Jacobian (r, d) of each candidate's readings.
        weight: Weight (d, d) of the directions' covariance in the zones' variance, m².
        left: Mean position variance of the zones that no candidate can reduce, m².
        horizon: Time for which the sensors read, s.
    """

    candidates: Sequence[Candidate]
    rows: Sequence[Array]
    weight: Array
    left: float
    horizon: float = np.nan

    @property
    def cost(self) -> Array:
        """Costs (C,)."""
        return np.array([candidate.cost for candidate in self.candidates])

    @cached_property
    def information(self) -> Array:
        """Information matrices (C, d, d) of the candidates."""
        return np.stack([rows.T @ rows for rows in self.rows])

    def variance(self, share: Array) -> float:
        """Mean position variance in the zones, m², with fractions (C,) in [0, 1] of the sensors."""
        return self.left + float(np.sum(self._cov(share) * self.weight))

    def slopes(self, share: Array) -> Array:
        """Gradient (C,) of `variance` with respect to the fractions."""
        cov = self._cov(share)
        return -np.einsum("cij,ji->c", self.information, cov @ self.weight @ cov)

    def gains(self, share: Array, which: Sequence[int]) -> Array:
        """Decrease (G,) of the variance, m², by each of the sensors `which` added alone."""
        cov = self._cov(share)
        square, out = cov @ self.weight @ cov, []
        for rows in (self.rows[i] for i in which):
            innovation = np.eye(len(rows)) + rows @ cov @ rows.T
            out.append(np.trace(np.linalg.solve(innovation, rows @ square @ rows.T)))
        return np.array(out)

    def _cov(self, share: Array) -> Array:
        info = np.eye(len(self.weight)) + np.einsum("c,cij->ij", share, self.information)
        return np.asarray(np.linalg.inv(info))


def placement_problem(
    robot: Robot, candidates: Sequence[Candidate], zones: Sequence[Zone], *, horizon: float = 10.0
) -> PlacementProblem:
    """Set up the placement problem: information of each candidate about zones of a robot at rest.

    Candidates have measurement noise only; the robot's sensor parameters are neglected.

    Args:
        robot: The robot, whose prior is the knowledge without sensors.
        candidates: Sensors that could be bought.
        zones: Zones of interest.
        horizon: Time for which sensors read, s; reduced for robots with many state variables.

    Raises:
        GlissandoError: There is no candidate, the horizon is not positive and finite, or a zone
            counts only after the horizon.
        UnobservableError: The prior leaves the base unknown.
    """
    if not candidates:
        raise GlissandoError("There is nothing to choose from; give one candidate or more.")
    if not (np.isfinite(horizon) and horizon > 0.0):
        raise GlissandoError(f"A time of {horizon:g} s is none; give seconds above 0.")
    belief = belief_of(robot)
    size = belief.hold_shape(Grid(belief.arclength, [0.0])).numbers
    cells = max(1, min(round(horizon * robot.time_rate), _NUMBERS // size - 1))
    horizon = min(horizon, cells / robot.time_rate)  # time nodes at the robot's own rate
    for zone in zones:
        if zone.time is not None and zone.time[0] > horizon:
            raise GlissandoError(
                f"A zone counts from {zone.time[0]:g} s on, and sensors of this robot are placed "
                f"for {horizon:g} s; give zones without times."
            )
    grid = Grid(belief.arclength, np.linspace(0.0, horizon, cells + 1))
    with one_thread():
        parameters = EstimatedParameters(grid, [])
        ahead = look_ahead(belief.prior, grid, belief.hold_shape(grid), parameters, None)
        step = horizon / (cells * _INSIDE)
        time = np.asarray((np.arange(cells * _INSIDE) + 0.5) * step, dtype=np.float64)
        blocks = [
            _dense(ahead, ahead.rows_of(c.readings(ahead, time))) * np.sqrt(step * c.rate)
            for c in candidates
        ]
        middles = 0.5 * (grid.time[1:] + grid.time[:-1])
        place, when, weight = zone_points(zones, middles, (0.0, horizon), robot.length)
        rows, bridge_cov = ahead.points(place, when)
        zone_rows = _dense(ahead, Rows(rows.cell, rows.lower, rows.jacobian[:, :3]))
        zone_rows *= np.repeat(np.sqrt(weight), 3)[:, None, None]
        remaining = float(np.einsum("z,zii->", weight, bridge_cov[:, :3, :3]))
        return replace(_reduced(ahead, candidates, blocks, zone_rows, remaining), horizon=horizon)


def _dense(ahead: PredictedInformation, rows: Rows) -> Array:
    """Dense Jacobian (M · r, K, D) of rows with respect to all time nodes."""
    count, r = rows.jacobian.shape[:2]
    shape = ahead.system.diagonal.shape[:2]
    out = np.zeros((count, r, shape[0] * shape[1]))
    for i in range(count):
        out[i][:, rows.cell[i] * ahead.size + ahead.corners(int(rows.lower[i]))] = rows.jacobian[i]
    return out.reshape(count * r, *shape)


def _reduced(
    ahead: PredictedInformation,
    candidates: Sequence[Candidate],
    blocks: Sequence[Array],
    wanted: Array,
    left: float,
) -> PlacementProblem:
    """Placement problem reduced to the measured directions, whose variance readings can lower."""
    cholesky = factor(ahead.system)
    white_rows, white_zone_rows = (
        cholesky.whitened(rows).reshape(len(rows), -1) for rows in (np.concatenate(blocks), wanted)
    )
    eigenvalue, directions = np.linalg.eigh(white_rows.T @ white_rows)
    gain = np.sum((white_zone_rows @ directions) ** 2, axis=0) * eigenvalue / (1.0 + eigenvalue)
    order, most = np.argsort(gain), _LEFT * (left + np.sum(white_zone_rows**2) - gain.sum())
    basis = directions[:, order[np.cumsum(gain[order]) > most]]
    ends = np.cumsum([len(block) for block in blocks])[:-1]
    parts = [
        part if len(part) < part.shape[1] else np.asarray(np.linalg.qr(part, mode="r"))
        for part in np.split(white_rows @ basis, ends)
    ]
    reduced_rows = white_zone_rows @ basis
    neglected = float(np.sum(white_zone_rows**2) - np.sum(reduced_rows**2))
    return PlacementProblem(candidates, parts, reduced_rows.T @ reduced_rows, left + neglected)


def place_sensors(problem: PlacementProblem, budgets: Sequence[float]) -> Iterator[Placement]:
    """Find the best set for each budget, with a lower bound for all sets within it.

    Args:
        problem: The placement problem.
        budgets: Largest costs of the sets, in increasing order.

    Yields:
        A placement for each budget.

    Raises:
        GlissandoError: A budget buys nothing, is not finite, or is less than the one before.
    """
    cost, chosen_before = problem.cost, list[int]()
    for budget, previous in zip(budgets, (0.0, *budgets), strict=False):
        if budget < previous:
            raise GlissandoError(
                f"Budgets of {previous:g} and then {budget:g} fall; give them in rising order."
            )
        if not cost.min() <= budget < np.inf:
            raise GlissandoError(
                f"A budget of {budget:g} cannot be: the cheapest sensor costs {cost.min():g}, all "
                f"together {cost.sum():g}."
            )
    bounds = [lower_bound(problem, budget) for budget in budgets]
    for i, budget in enumerate(budgets):
        starts = [_greedy(problem, budget, by_cost) for by_cost in (True, False)]
        sets = [_improved_by_exchange(problem, budget, start) for start in (*starts, chosen_before)]
        chosen_before = min(sets, key=lambda chosen: problem.variance(_share(problem, chosen)))
        share = _share(problem, chosen_before)
        yield Placement(
            budget,
            float(cost @ share),
            tuple(problem.candidates[i] for i in chosen_before),
            float(np.sqrt(problem.variance(share))),
            float(np.sqrt(max(bounds[i:]))),  # the bound of a larger budget holds here too
        )


def _share(problem: PlacementProblem, chosen: Sequence[int]) -> Array:
    share = np.zeros(len(problem.candidates))
    share[list(chosen)] = 1.0
    return share


def _greedy(
    problem: PlacementProblem,
    budget: float,
    by_cost: bool,
    chosen: Sequence[int] = (),
    without: Sequence[int] = (),
) -> list[int]:
    """Set grown sensor by sensor, by the decrease of the variance, or by that over the cost."""
    cost, chosen = problem.cost, list(chosen)
    while True:
        share = _share(problem, chosen)
        free = np.flatnonzero((share == 0.0) & (cost <= budget - cost @ share + 1e-9))
        free = np.setdiff1d(free, without)
        if not free.size:
            return chosen
        gain = problem.gains(share, free.tolist())
        best = int(np.argmax(gain / cost[free] if by_cost else gain))
        if gain[best] <= _GAIN * problem.variance(share):
            return chosen
        chosen.append(int(free[best]))


def _improved_by_exchange(problem: PlacementProblem, budget: float, chosen: list[int]) -> list[int]:
    """Local optimum: the set is replaced by its best neighbour while that lowers the variance."""

    def variance(chosen: list[int]) -> float:
        return problem.variance(_share(problem, chosen))

    while True:
        neighbour = min(_neighbouring_sets(problem, budget, chosen), key=variance, default=chosen)
        if not variance(neighbour) < (1.0 - _GAIN) * variance(chosen):
            return chosen
        chosen = neighbour


def _neighbouring_sets(
    problem: PlacementProblem, budget: float, chosen: list[int]
) -> Iterator[list[int]]:
    """Neighbours of a set: one or two sensors replaced, or one added and others removed for it."""
    removals: list[tuple[int, ...]] = [(removed,) for removed in chosen]
    if len(chosen) <= _PAIRS:
        removals += combinations(chosen, 2)
    for removed in removals:
        rest = [each for each in chosen if each not in removed]
        for by_cost in (True, False):
            yield _greedy(problem, budget, by_cost, rest, removed)
    for new in np.flatnonzero((_share(problem, chosen) == 0.0) & (problem.cost <= budget)):
        rest, excluded = _made_affordable(problem, budget, chosen, int(new))
        for by_cost in (True, False):
            yield _greedy(problem, budget, by_cost, rest, excluded)


def _made_affordable(
    problem: PlacementProblem, budget: float, chosen: Sequence[int], new: int
) -> tuple[list[int], list[int]]:
    """Set with sensor `new` within the budget, and the sensors removed to pay for it.

    The sensors removed are those whose loss raises the variance least for their cost.
    """
    affordable, removed, cost = [*chosen, new], list[int](), problem.cost
    while cost[affordable].sum() > budget + 1e-9:
        whole = problem.variance(_share(problem, affordable))
        loss = [
            (problem.variance(_share(problem, [k for k in affordable if k != i])) - whole) / cost[i]
            for i in affordable[:-1]
        ]
        removed.append(affordable.pop(int(np.argmin(loss))))
    return affordable, removed


def lower_bound(problem: PlacementProblem, budget: float) -> float:
    """Lower bound of the mean position variance, m², of all sets within a budget.

    The variance is convex in the fractions, so a tangent plane lies below it everywhere.
    """
    cost, initial = problem.cost, problem.variance(np.zeros(len(problem.candidates)))
    share = np.full(cost.size, min(1.0, budget / cost.sum()))
    best = scipy.optimize.minimize(
        lambda x: problem.variance(x) / initial,
        share,
        jac=lambda x: problem.slopes(x) / initial,
        method="SLSQP",
        bounds=[(0.0, 1.0)] * cost.size,
        constraints={"type": "ineq", "fun": lambda x: budget - cost @ x, "jac": lambda x: -cost},
        options={"maxiter": 200, "ftol": 1e-9},
    )
    optimum = np.clip(best.x, 0.0, 1.0)
    slopes, unspent, least = problem.slopes(optimum), budget, 0.0
    for i in np.argsort(slopes / cost):  # minimum of the plane: largest decrease per cost first
        fraction = min(1.0, unspent / cost[i])
        least, unspent = least + fraction * slopes[i], unspent - fraction * cost[i]
    plane = problem.variance(optimum) + least - float(slopes @ optimum)
    return max(plane, problem.left, 0.0)  # a tangent plane far from the optimum may be lower
