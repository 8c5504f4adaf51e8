"""The last time nodes of a motion, with everything older kept as a prior on the oldest of them.

Intervals between time nodes are linearised by themselves and eliminated forwards, so that only
those which changed are done again. What leaves the window stays as the Schur complement on the next
node, whose linearisation point is held from then on: first-estimate Jacobians. Source:
equation (20); Huang, Mourikis and Roumeliotis (2010) on first estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import blas, lapack

from glissando.errors import UnobservableError
from glissando.estimation.interval_system import (
    Layout,
    add_factors,
    spread_out,
    squared_innovations,
    substituted,
)
from glissando.estimation.posterior import Posterior, SolveReport, StateEstimate
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.grid import Grid, Index
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameters import EstimatedParameters, SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, POSE, State
from glissando.solver.block_tridiagonal import BlockTridiagonal, Marginals, inverse_of_triangle
from glissando.solver.measurement_factors import MeasurementFactors


@dataclass
class Node:
    """A time node: where it is linearised, the step from there, and what elimination left.

    `state` (N,) and `extras` (E,) are the linearisation point, `step` (D,) leads to the estimate;
    `carried` is the information matrix and vector that older nodes left here; `block` (2 D, 2 D)
    and `pull` (2 D,) are those of the interval that begins here; `inverse` (D, D) of the Cholesky
    factor, `ahead` (D, D) and `solved` (D,) what it makes of them.
    """

    time: float
    state: State
    extras: Array
    step: Array
    carried: tuple[Array, Array]
    block: Array
    pull: Array
    inverse: Array
    ahead: Array
    solved: Array


@dataclass(frozen=True)
class Innovations:
    """Readings of one stream at the solution: which rows, and their squared innovations (M,)."""

    stream: int
    rows: Index
    nis: Array
    dof: int


class SlidingWindow:
    """Time nodes of a prior on `arclength` (N,), solved together with `sensor_parameters`."""

    def __init__(
        self, prior: Prior, arclength: Array, sensor_parameters: Sequence[SensorParameter] = ()
    ) -> None:
        self.prior, self.arclength = prior, arclength
        self.sensor_parameters = tuple(u for u in sensor_parameters if not u.known)
        self.nodes: list[Node] = []
        self.before: float | None = None
        self._extras = EstimatedParameters(Grid(arclength, [0.0]), self.sensor_parameters)
        self._factors: list[tuple[int, Index, Factors]] = []
        self._first = 0

    @property
    def times(self) -> Array:
        """Times (K,) of the nodes."""
        return np.array([node.time for node in self.nodes])

    @property
    def _layout(self) -> Layout:
        return Layout(self.arclength.size, self.nodes[0].state.dof, self._extras.size)

    def grid(self, first: int = 0) -> Grid:
        """The grid of the nodes from `first` on."""
        before = self.nodes[first - 1].time if first else self.before
        return Grid(self.arclength, self.times[first:], before)

    def begin(self, time: float, state: State) -> None:
        """Start with one node, linearised at `state` (N,)."""
        self.nodes = [self._node(time, state, self._extras.mean)]

    def append(self, time: float) -> None:
        """One more node, where constant velocity (and strain rate) lead from the newest."""
        newest = self.nodes[-1]
        state, extras = self._estimate(newest)
        ahead = np.zeros((self.arclength.size, state.dof))
        ahead[:, :6] = (time - newest.time) * state.velocity
        if state.strain_rate is not None:
            ahead[:, 6:12] = (time - newest.time) * state.strain_rate
        self.nodes.append(self._node(time, state.retract(ahead), extras))

    def _node(self, time: float, state: State, extras: Array) -> Node:
        step = np.zeros(self.arclength.size * state.dof + self._extras.size)
        nothing = np.zeros(1)  # until it is linearised and eliminated
        none = nothing, nothing
        return Node(time, state, extras, step, none, *none, *none, nothing)

    def _estimate(self, node: Node) -> tuple[State, Array]:
        of_nodes = self.arclength.size * node.state.dof
        step = node.step[:of_nodes].reshape(self.arclength.size, -1)
        return node.state.retract(step), node.extras + node.step[of_nodes:]

    def drop(self) -> None:
        """Leave the oldest node behind, as a prior on the next, which is not linearised again."""
        self.before = self.nodes.pop(0).time
        self._first = max(0, self._first - 1)

    def free(self, first: int) -> list[Node]:
        """The nodes after `first`, whose linearisation may move; the oldest too unless held."""
        return self.nodes[first + (first > 0 or self.before is not None) :]

    def relinearize(self, first: int) -> None:
        """Linearise the nodes after `first` at their estimates; the oldest too unless held."""
        for node in self.free(first):
            node.state, node.extras = self._estimate(node)
            node.step = np.zeros_like(node.step)

    def place(self, first: int, readings: Sequence[Readings]) -> MeasurementFactors:
        """Readings of the nodes from `first` on and of the intervals after them, on their grid."""
        values = np.array([node.extras for node in self.nodes[first:]])
        return MeasurementFactors(
            self.grid(first), readings, self.sensor_parameters, values, keep_all=True
        )

    def solve(self, first: int, placed: MeasurementFactors) -> None:
        """Linearise all that begins at the nodes from `first` on, eliminate, find every step."""
        self._linearize(first, placed)
        self._eliminate(first)
        ahead = None
        for node in reversed(self.nodes):
            solved = node.solved if ahead is None else node.solved - node.ahead @ ahead
            node.step = ahead = node.inverse.T @ solved

    def miss(self, first: int) -> float:
        """How far the last step may have missed, in standard deviations of the newest poses.

        A step goes straight where motions curve: half its length times the largest angle by which
        it turned any node that is linearised again.
        """
        n_count, dof = self._layout.nodes, self._layout.dof
        free = np.array([node.step[: n_count * dof] for node in self.free(first)])
        if not free.size:
            return 0.0
        variance = np.einsum("ij,ij->j", self.nodes[-1].inverse, self.nodes[-1].inverse)
        length = np.abs(free[-1] / np.sqrt(variance[: n_count * dof])).reshape(n_count, dof)
        turn = np.abs(free.reshape(-1, dof)[:, 3:6]).max()
        return float(0.5 * turn * length[:, POSE].max())

    def _linearize(self, first: int, placed: MeasurementFactors) -> None:
        nodes, grid = self.nodes[first:], placed.grid
        state = _stacked([node.state for node in nodes])
        values = np.array([node.extras for node in nodes])
        placed = placed.moved(values - placed.values)
        layout, size = self._layout, self._layout.size
        blocks = np.zeros((len(nodes), 2 * size, 2 * size))
        pulls = np.zeros((len(nodes), 2 * size))
        self._factors, self._first = [], first
        for i, times in enumerate(placed.blocks):
            for batch in self.prior.factors(grid, state, state, times):
                add_factors(batch, layout, blocks, pulls)
            rows, batches = placed.rows(i), placed.factors(self.prior, state, state, i)
            for (stream, row), batch in zip(rows, batches, strict=True):
                add_factors(batch, layout, blocks, pulls)
                self._factors.append((stream, row, batch))
        if self._extras.size:
            self._chain(grid, values, blocks, pulls)
        for node, block, pull in zip(nodes, blocks, pulls, strict=True):
            node.block, node.pull = block, pull

    def _chain(self, grid: Grid, values: Array, blocks: Array, pulls: Array) -> None:
        """Add what ties unknowns of one time node to those of the next, and to what is expected."""
        decay, spread = EstimatedParameters(grid, self.sensor_parameters).chain()
        size = blocks.shape[1] // 2
        at = np.arange(size - self._extras.size, size)
        off = values - self._extras.mean
        if grid.before is None:
            info = spread[0] ** -2.0
            blocks[0, at, at] += info
            pulls[0, at] -= info * off[0]
        for k, fade in enumerate(decay):
            info, miss = spread[k + 1] ** -2.0, off[k + 1] - fade * off[k]
            blocks[k, at, at] += fade**2 * info
            blocks[k, at + size, at + size] += info
            blocks[k, at, at + size] -= fade * info
            blocks[k, at + size, at] -= fade * info
            pulls[k, at] += fade * info * miss
            pulls[k, at + size] -= info * miss

    def _eliminate(self, first: int) -> None:
        size = self.nodes[0].step.size
        own, next_ = slice(0, size), slice(size, None)
        for i, node in enumerate(self.nodes[first:], start=first):
            matrix = node.block[own, own] + node.carried[0]
            chol, failed = lapack.dpotrf(matrix.T, lower=1, clean=1)
            if failed:
                raise UnobservableError(
                    f"Prior and readings leave a direction of the state at {node.time:g} s "
                    f"undetermined. Give the robot a [base], or use a stream that fixes it."
                )
            node.inverse = inverse_of_triangle(chol)
            node.solved = node.inverse @ (node.pull[own] + node.carried[1])
            if i + 1 < len(self.nodes):
                node.ahead = blas.dtrmm(1.0, node.inverse, node.block[next_, own].T, lower=1)
                self.nodes[i + 1].carried = (
                    node.block[next_, next_] - node.ahead.T @ node.ahead,
                    node.pull[next_] - node.ahead.T @ node.solved,
                )

    def marginals(self, first: int = 0) -> Marginals:
        """Covariances of the nodes from `first` on, and of neighbours. Source: equation (21)."""
        nodes = self.nodes[first:]
        size = nodes[0].step.size
        cov, cross = np.empty((len(nodes), size, size)), np.empty((len(nodes) - 1, size, size))
        for k in reversed(range(len(nodes))):
            inverse = half = nodes[k].inverse
            if k + 1 < len(nodes):
                ahead = nodes[k].ahead @ cov[k + 1]
                half = inverse + ahead @ (nodes[k].ahead.T @ inverse)
                cross[k] = -(inverse.T @ ahead)
            block = inverse.T @ half
            cov[k] = 0.5 * (block + block.T)
        return Marginals(cov, cross)

    def judge(self, fresh: Sequence[int]) -> list[Innovations]:
        """Squared innovations of each stream's rows from `fresh` on, each against all others."""
        kept = [
            (stream, rows, batch) if new.all() else (stream, rows[new], batch.take(new))
            for stream, rows, batch in self._factors
            if (new := rows >= fresh[stream]).any()
        ]
        if not kept:
            return []
        n_count, all_nodes = self.arclength.size, self.nodes[self._first :]
        begin = min(int(batch.nodes[:, 0].min()) for _, _, batch in kept) // n_count
        begin = max(0, min(begin, len(all_nodes) - 2))  # unknowns are those of an interval
        nodes, out, first = all_nodes[begin:], [], 0
        steps = np.concatenate([node.step for node in nodes])
        batches = [batch for _, _, batch in kept]
        if begin:
            batches = [replace(batch, nodes=batch.nodes - begin * n_count) for batch in batches]
        spread = [spread_out(batch, self._layout, len(nodes)) for batch in batches]
        rows = np.concatenate([j.reshape(-1, steps.size) for _, j in spread])
        known = substituted(rows, [n.inverse for n in nodes], [n.ahead for n in nodes])
        for (stream, rows, _), (residual, jacobian) in zip(kept, spread, strict=True):
            mine = known[first : first + residual.size].reshape(jacobian.shape)
            nis = squared_innovations(residual + jacobian @ steps, mine)
            out.append(Innovations(stream, rows, nis, residual.shape[1]))
            first += residual.size
        return out

    def newest(self) -> tuple[State, Array]:
        """Estimate (N,) of the newest time and its covariance (D, D)."""
        inverse = self.nodes[-1].inverse
        return self._estimate(self.nodes[-1])[0], inverse.T @ inverse

    def newest_nodes(self) -> StateEstimate:
        """The newest time at the nodes (N,), each with its own covariance (N, 18, 18)."""
        newest, layout = self.nodes[-1], self._layout
        own = newest.inverse[:, : layout.nodes * layout.dof]
        halves = np.ascontiguousarray(own.T).reshape(layout.nodes, layout.dof, -1)[:, :DOF]
        state = self._estimate(newest)[0]
        return StateEstimate(
            state.pose, state.strain, state.velocity, halves @ np.swapaxes(halves, 1, 2)
        )

    def posterior(self) -> Posterior:
        """All that the window knows, as an estimate of a recording gives it."""
        found = [self._estimate(node) for node in self.nodes]
        size = self.nodes[0].step.size
        diagonal = np.array([node.block[:size, :size] for node in self.nodes])
        diagonal[0] += self.nodes[0].carried[0]
        for k, node in enumerate(self.nodes[:-1]):
            diagonal[k + 1] += node.block[size:, size:]
        lower = np.array([node.block[size:, :size] for node in self.nodes[:-1]])
        system = BlockTridiagonal(diagonal, lower.reshape(-1, size, size))
        solve = SolveReport("online", 1, diagonal[:, 0].size, 0.0, 0.0, 0, {})
        ends = np.cumsum([0, *(u.size for u in self.sensor_parameters)])
        extras = np.array([extra for _, extra in found])
        known = [
            (u, extras[:, a : a + u.size])
            for u, a in zip(self.sensor_parameters, ends, strict=False)
        ]
        state = _stacked([state for state, _ in found])
        return Posterior(self.prior, self.grid(), state, system, self.marginals(), solve, known)


def _stacked(states: Sequence[State]) -> State:
    """States (K, N) of K states (N,)."""
    fields = zip(*(state.fields() for state in states), strict=True)
    return State(*(np.array(field) for field in fields))
