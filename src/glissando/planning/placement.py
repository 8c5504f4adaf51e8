"""Which sensors to buy and where to put them: the set within a budget that makes zones certain.

The robot holds its shape while every sensor reads for a while. Each candidate then measures a few
of the directions of motion that zones ask for, so a set is judged by one small inverse. Sets are
found greedily and improved by exchanges. How much better any other set of the same budget could be
is bounded by the convex problem in which candidates are bought in part. Source: Joshi and Boyd
(2009), Sensor selection via convex optimization; equation (23).
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

_NUMBERS = 1000  # of all nodes together, about
_INSIDE = 2  # readings that stand for those of a cell
_LEFT = 1e-2  # of the variance after all sensors: directions that gain less are left out together
_PAIRS = 6  # sensors of a set up to which pairs are exchanged
_GAIN = 1e-6  # of the variance: exchanges that gain less are not worth it


@dataclass(frozen=True)
class Placement:
    """A set of sensors, and what it leaves uncertain.

    Attributes:
        budget: What it was allowed to cost.
        cost: What it costs.
        chosen: The sensors, in the order in which they were found.
        std: Root of the mean position variance in the zones, m.
        bound: What no set within the budget goes below, m.
    """

    budget: float
    cost: float
    chosen: tuple[Candidate, ...]
    std: float
    bound: float


@dataclass(frozen=True)
class PlacementProblem:
    """Candidates by what they measure of d directions that are known to variance one.

    Attributes:
        candidates: The sensors (C,).
        rows: What each measures, whitened (r, d).
        weight: Weight (d, d) of those directions in the zones.
        left: Mean position variance of the zones that no candidate can lower, m².
        horizon: How long the sensors read, s.
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
        """What each adds (C, d, d)."""
        return np.stack([rows.T @ rows for rows in self.rows])

    def variance(self, share: Array) -> float:
        """Mean position variance in the zones, m², with a share (C,) from 0 to 1 of each sensor."""
        return self.left + float(np.sum(self._cov(share) * self.weight))

    def slopes(self, share: Array) -> Array:
        """Slopes (C,) of `variance` by the shares."""
        cov = self._cov(share)
        return -np.einsum("cij,ji->c", self.information, cov @ self.weight @ cov)

    def gains(self, share: Array, which: Sequence[int]) -> Array:
        """How much each of some more sensors (G,) lowers the variance, m²."""
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
    """What each candidate adds to what is known of zones, for a robot that rests.

    A candidate's noise is all that is unknown of it: the robot's sensor parameters are left out.

    Args:
        robot: The robot: its prior is what is known without sensors.
        candidates: The sensors that could be bought.
        zones: The zones that count.
        horizon: How long sensors read, s; on a robot of many numbers the problem's is shorter.

    Raises:
        GlissandoError: There is no candidate, the horizon is no time, or a zone counts later.
        UnobservableError: The prior leaves the base unknown.
    """
    if not candidates:
        raise GlissandoError("There is nothing to choose from; give one candidate or more.")
    if not (np.isfinite(horizon) and horizon > 0.0):
        raise GlissandoError(f"A time of {horizon:g} s is none; give seconds above 0.")
    belief = belief_of(robot)
    size = belief.hold_shape(Grid(belief.arclength, [0.0])).numbers
    cells = max(1, min(round(horizon * robot.time_rate), _NUMBERS // size - 1))
    horizon = min(horizon, cells / robot.time_rate)  # time nodes are as close as the robot asks
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
        rows, open_ = ahead.points(place, when)
        wanted = _dense(ahead, Rows(rows.cell, rows.lower, rows.jacobian[:, :3]))
        wanted *= np.repeat(np.sqrt(weight), 3)[:, None, None]
        left = float(np.einsum("z,zii->", weight, open_[:, :3, :3]))
        return replace(_reduced(ahead, candidates, blocks, wanted, left), horizon=horizon)


def _dense(ahead: PredictedInformation, rows: Rows) -> Array:
    """Rows (M · r, K, D) as functions of all nodes."""
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
    """The problem in the directions that readings see, which are all that they can make certain."""
    cholesky = factor(ahead.system)
    seen, wanted_rows = (
        cholesky.whitened(rows).reshape(len(rows), -1) for rows in (np.concatenate(blocks), wanted)
    )
    gained, directions = np.linalg.eigh(seen.T @ seen)
    worth = np.sum((wanted_rows @ directions) ** 2, axis=0) * gained / (1.0 + gained)
    order, most = np.argsort(worth), _LEFT * (left + np.sum(wanted_rows**2) - worth.sum())
    basis = directions[:, order[np.cumsum(worth[order]) > most]]
    ends = np.cumsum([len(block) for block in blocks])[:-1]
    parts = [
        part if len(part) < part.shape[1] else np.asarray(np.linalg.qr(part, mode="r"))
        for part in np.split(seen @ basis, ends)
    ]
    along = wanted_rows @ basis
    beside = float(np.sum(wanted_rows**2) - np.sum(along**2))
    return PlacementProblem(candidates, parts, along.T @ along, left + beside)


def place_sensors(problem: PlacementProblem, budgets: Sequence[float]) -> Iterator[Placement]:
    """The best sets found for each budget, with a bound on what any set could do.

    Args:
        problem: The candidates.
        budgets: What sets may cost, in rising order.

    Raises:
        GlissandoError: A budget buys nothing, is not finite, or is less than the one before.
    """
    cost, before = problem.cost, list[int]()
    for budget, less in zip(budgets, (0.0, *budgets), strict=False):
        if budget < less:
            raise GlissandoError(
                f"Budgets of {less:g} and then {budget:g} fall; give them in rising order."
            )
        if not cost.min() <= budget < np.inf:
            raise GlissandoError(
                f"A budget of {budget:g} cannot be: the cheapest sensor costs {cost.min():g}, all "
                f"together {cost.sum():g}."
            )
    bounds = [lower_bound(problem, budget) for budget in budgets]
    for i, budget in enumerate(budgets):
        starts = [_greedy(problem, budget, by_cost) for by_cost in (True, False)]
        sets = [_exchanged(problem, budget, start) for start in (*starts, before)]
        before = min(sets, key=lambda chosen: problem.variance(_share(problem, chosen)))
        share = _share(problem, before)
        yield Placement(
            budget,
            float(cost @ share),
            tuple(problem.candidates[i] for i in before),
            float(np.sqrt(problem.variance(share))),
            float(np.sqrt(max(bounds[i:]))),  # what bounds a larger budget bounds this
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
    """One more sensor after the other: what lowers the variance most, or most for its cost."""
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


def _exchanged(problem: PlacementProblem, budget: float, chosen: list[int]) -> list[int]:
    """The set, while another beside it lowers the variance; the best beside it comes next."""

    def variance(chosen: list[int]) -> float:
        return problem.variance(_share(problem, chosen))

    while True:
        best = min(_beside(problem, budget, chosen), key=variance, default=chosen)
        if not variance(best) < (1.0 - _GAIN) * variance(chosen):
            return chosen
        chosen = best


def _beside(problem: PlacementProblem, budget: float, chosen: list[int]) -> Iterator[list[int]]:
    """Sets with others in place of one sensor, or of two, and those with one more at any price."""
    outs: list[tuple[int, ...]] = [(out,) for out in chosen]
    if len(chosen) <= _PAIRS:
        outs += combinations(chosen, 2)
    for out in outs:
        rest = [each for each in chosen if each not in out]
        for by_cost in (True, False):
            yield _greedy(problem, budget, by_cost, rest, out)
    for new in np.flatnonzero((_share(problem, chosen) == 0.0) & (problem.cost <= budget)):
        rest, left = _paid_for(problem, budget, chosen, int(new))
        for by_cost in (True, False):
            yield _greedy(problem, budget, by_cost, rest, left)


def _paid_for(
    problem: PlacementProblem, budget: float, chosen: Sequence[int], new: int
) -> tuple[list[int], list[int]]:
    """The set with a sensor more, less those that are missed least for their cost; and these."""
    affordable, out, cost = [*chosen, new], list[int](), problem.cost
    while cost[affordable].sum() > budget + 1e-9:
        whole = problem.variance(_share(problem, affordable))
        miss = [
            (problem.variance(_share(problem, [k for k in affordable if k != i])) - whole) / cost[i]
            for i in affordable[:-1]
        ]
        out.append(affordable.pop(int(np.argmin(miss))))
    return affordable, out


def lower_bound(problem: PlacementProblem, budget: float) -> float:
    """A mean position variance, m², that no set within a budget goes below.

    The variance is convex in the shares: a plane that touches it lies below it everywhere.
    """
    cost, whole = problem.cost, problem.variance(np.zeros(len(problem.candidates)))
    share = np.full(cost.size, min(1.0, budget / cost.sum()))
    best = scipy.optimize.minimize(
        lambda x: problem.variance(x) / whole,
        share,
        jac=lambda x: problem.slopes(x) / whole,
        method="SLSQP",
        bounds=[(0.0, 1.0)] * cost.size,
        constraints={"type": "ineq", "fun": lambda x: budget - cost @ x, "jac": lambda x: -cost},
        options={"maxiter": 200, "ftol": 1e-9},
    )
    at = np.clip(best.x, 0.0, 1.0)
    slopes, room, least = problem.slopes(at), budget, 0.0
    for i in np.argsort(slopes / cost):  # the plane's least value: what lowers it most for its cost
        part = min(1.0, room / cost[i])
        least, room = least + part * slopes[i], room - part * cost[i]
    plane = problem.variance(at) + least - float(slopes @ at)
    return max(plane, problem.left, 0.0)  # a plane that touches far away falls below these
