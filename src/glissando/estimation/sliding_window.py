"""Sliding window over the last time nodes of a motion, with a prior from everything older.

Intervals between time nodes are linearised separately, so that only those which changed are summed
and eliminated again. A node that leaves the window is marginalised: its Schur complement is a prior
on the next node, whose linearisation point is fixed from then on (first-estimate Jacobians).
Source: equation (20); Huang, Mourikis and Roumeliotis (2010) on first estimates.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy, deepcopy
from dataclasses import replace

import numpy as np

from glissando._kernels import normal_equations as kernels
from glissando._kernels import window as window_kernels
from glissando._kernels.arrays import whole
from glissando.estimation.delay_dating import DelayDating
from glissando.estimation.held_readings import HeldReadings
from glissando.estimation.linearized_readings import (
    Innovations,
    LinearizedReadings,
    sums_of_noise,
)
from glissando.estimation.posterior import Posterior
from glissando.estimation.solve_report import SolveReport
from glissando.estimation.state_estimate import StateEstimate
from glissando.estimation.transported import has_rolled, transport, transported
from glissando.estimation.window_factors import WindowFactors
from glissando.estimation.window_nodes import Nodes
from glissando.estimation.window_parameters import WindowParameters
from glissando.estimation.window_system import WindowSystem
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index, reads_from
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, State
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder, kernel_arguments
from glissando.solver.outcome import Outcome


class SlidingWindow:
    """Time nodes of a prior on `arclength` (N,), solved together with `sensor_parameters`.

    Attributes:
        parameters: Estimates of the sensor parameters, kept when the window begins again.
        lone: Time that the first node represents until there is another, s.
    """

    def __init__(
        self, prior: Prior, arclength: Array, sensor_parameters: Sequence[SensorParameter] = ()
    ) -> None:
        self.arclength = arclength
        self.sensor_parameters = tuple(p for p in sensor_parameters if not p.known)
        self._factors = WindowFactors(prior, arclength, self.sensor_parameters)
        self.before: float | None = None
        self.lone = 1.0
        self._grid = Grid(arclength, [0.0])
        self._process = EstimatedParameters(self._grid, self.sensor_parameters)
        self.parameters = WindowParameters(self._process)
        self._root = np.zeros((0, 0))  # its square is the covariance of the newest step
        self._rng: np.random.Generator | None = None  # of drawn noise, where that is needed
        self._first = 0

    @property
    def prior(self) -> Prior:
        """The prior of the motion."""
        return self._factors.prior

    @property
    def dating(self) -> DelayDating | None:
        """Dating of the readings of streams with an estimated delay, if there are any."""
        return self._factors.dating

    def date_by(self, others: SlidingWindow) -> None:
        """Date delayed streams by the motion of another window, see `DelayDating`."""
        others._rng = np.random.default_rng(0)
        self._factors.dating = DelayDating(others, self._process)

    def begin(self, time: float, state: State) -> None:
        """Begin with one node, linearised at `state` (N,), and the last sensor parameters."""
        values, cov = self.parameters.begin(time)
        self.before = None
        self.nodes = self._node(time, state, values)
        self.layout = Layout(self.arclength.size, state.dof, self._process.size)
        size, own = self.layout.size, slice(state.numbers, None)
        info, rhs = np.zeros((size, size)), np.zeros(size)
        own_info = self._process.std**-2.0  # added by the drift factor of the first node
        info[own, own] = np.linalg.inv(cov) - np.diag(own_info)
        rhs[own] = own_info * (values - self._process.mean)
        self._system = WindowSystem(self.layout, info, rhs)
        if self.dating is not None:
            self.dating.begin(self.layout, info, time, (values, cov))
        self._noise = np.zeros((1, size))
        self._root = np.zeros((0, 0))

    def settle(self) -> None:
        """Record the estimates of sensor parameters, for when the window begins again.

        The estimate is changed so that only a share of the information on delays counts.

        Raises:
            NotLinearError: A delay is farther off than its stated uncertainty allows.
        """
        if not self._process.size:
            return
        if self.dating is not None:
            self.nodes = self.nodes.stepped(self.dating.counted(self.nodes, self._system))
            self._root = self._system.root.copy()
        values, own = self.nodes.newest[1], self._root[:, self.nodes.state.numbers :]
        self.parameters.settle(float(self.nodes.time[-1]), values, own.T @ own)

    @property
    def longest_delay(self) -> float:
        """Largest shift, s, of a reading from its time stamp by estimated delays."""
        values, std = self._process.mean, self._process.std
        if self._root.size:
            own = self._root[:, self.nodes.state.numbers :]
            values, std = self.nodes.newest[1], np.sqrt(np.sum(own**2, axis=0))
        return self.parameters.longest_delay(values, std)

    @property
    def intact(self) -> int:
        """Number of nodes, from the oldest on, that are solved; no solution may begin beyond."""
        return self._system.intact

    @property
    def started(self) -> bool:
        """Whether there is a node."""
        return hasattr(self, "nodes")

    def grid(self, first: int = 0) -> Grid:
        """The grid of the nodes from `first` on."""
        before = float(self.nodes.time[first - 1]) if first else self.before
        return self._grid.at_times(self.nodes.time[first:], before, self.lone)

    def since(self, first: int) -> float:
        """Time from which readings belong to the intervals from node `first` on, s."""
        time = self.nodes.time
        return reads_from(float(time[first]), float(time[first - 1]) if first else self.before)

    def append(self, time: float) -> None:
        """Append a node, predicted from the newest by constant velocity (and strain rate)."""
        (state, parameters), lasts = self.nodes.newest, time - float(self.nodes.time[-1])
        ahead = replace(state, pose=se3.retract(state.pose, lasts * state.velocity))
        if state.strain_rate is not None:
            ahead = replace(ahead, strain=state.strain + lasts * state.strain_rate)
        self.nodes = self.nodes.followed_by(time, ahead, parameters)
        if self._rng is not None:
            self._noise = np.concatenate([self._noise, np.zeros((1, self.layout.size))])
        self._system.append()

    def copied(self) -> SlidingWindow:
        """A copy that can be changed without changing this window."""
        return self.with_prior(self.prior)

    def with_prior(self, prior: Prior) -> SlidingWindow:
        """A copy with another prior for intervals that are linearised from now on."""
        out = copy(self)
        out._system, out._factors = self._system.copied(), self._factors.with_prior(prior)
        out._factors.dating = self.dating and self.dating.copied()
        return out

    def _node(self, time: float, state: State, parameters: Array) -> Nodes:
        numbers = state.numbers + self._process.size
        still, own = np.zeros((1, numbers)), np.zeros((1, state.pose.shape[0], state.dof))
        return Nodes(np.array([time]), state.take(np.newaxis), parameters[None], still, own)

    def drop(self) -> None:
        """Marginalise the oldest node into a prior on the next, which is not relinearised.

        Source: equation (20).
        """
        self._system.drop()
        self.before = float(self.nodes.time[0])
        self.nodes = self.nodes.take(slice(1, None))
        if self.dating is not None:
            self.dating.leave(self.nodes, self._system)
        if self._rng is not None:
            self._noise = self._noise[1:]
        self._first = max(0, self._first - 1)

    def _fixed(self, first: int) -> int:
        """First node that may be relinearised if solving from `first`; the oldest unless fixed."""
        return first + (first > 0 or self.before is not None)

    @property
    def points(self) -> tuple[Nodes, Array]:
        """Linearisation points of the nodes, and the right-hand side of the prior about them."""
        return self.nodes, self._system.rhs

    @points.setter
    def points(self, before: tuple[Nodes, Array]) -> None:
        """Restore earlier linearisation points."""
        self.nodes, self._system.rhs = before

    def relinearize(self, first: int) -> None:
        """Linearise the nodes after `first` at their estimates; the oldest too unless fixed."""
        fixed = self._fixed(first)
        if not fixed:  # the prior of the sensor parameters is about their old point
            self._system.rhs = self._system.rhs - self._system.info @ self.nodes.step[0]
        self.nodes = self.nodes.at_estimate(fixed)

    def restate(self, state: State) -> None:
        """Set the estimates and linearisation points of all nodes to states (K, N)."""
        nodes = replace(self.nodes, state=state)
        self.nodes = nodes.stepped(np.zeros_like(nodes.step))

    def takes_as_row(self, readings: Readings) -> bool:
        """Whether readings may be stored as rows, together with those of other streams."""
        return self._factors.takes_as_row(readings)

    def solve(self, first: int, readings: HeldReadings) -> None:
        """Linearise and eliminate all intervals from node `first` on, and solve for all steps.

        Args:
            first: First node.
            readings: All readings at and after that node.
        """
        sums = self._linearized(first, readings)
        self.nodes = self.nodes.stepped(self._system.solve(first, sums))
        self._root = self._system.root.copy()
        if self.dating is not None and not first:
            self.dating.note(sums)
        if self._rng is not None:
            noise = sums_of_noise(
                self._factors.terms, self.layout, len(self.nodes) - first, self._rng
            )
            self._noise = self._system.respond(first, noise)

    @property
    def estimate_and_noise(self) -> tuple[State, State]:
        """Estimated nodes (K, N), and these moved by the response to drawn noise of readings."""
        state = self.nodes.estimate[0]
        noise = self._noise[:, : state.numbers].reshape(*state.pose.shape[:2], -1)
        return state, state.retract(noise)

    def _linearized(self, first: int, readings: HeldReadings) -> NormalEquationsBuilder:
        """Sum the factors of the intervals from `first` on. Source: equation (19)."""
        if self.dating is not None:
            free, longest = self._fixed(first), self.longest_delay
            self.nodes = self.dating.see(self.nodes, first, free, longest)
        nodes, grid = self.nodes.take(slice(first, None)), self.grid(first)
        builder, self._first = self._system.builder(first), first
        self._factors.add(nodes, grid, readings, builder)
        return builder

    def miss(self, first: int) -> float:
        """Error of the last step by nonlinearity, in standard deviations of the newest poses.

        A step is straight where motions are curved: its error is half its length times the largest
        angle by which it rotated any node that is relinearised.
        """
        free = self.nodes.step[self._fixed(first) :]
        if not free.size:
            return 0.0
        layout = self.layout
        return float(window_kernels.missed(self._root, free, layout.nodes, layout.dof))

    def innovations(self, fresh: Mapping[str, int]) -> Iterator[Innovations]:
        """Squared innovations of each stream's last `fresh` readings, each against all others."""
        held = self._factors.held
        for terms in self._factors.terms:
            which = terms.last(fresh, held)
            if which.size:
                yield from terms.innovations(which, self._squared(terms, which), held)

    def _squared(self, terms: LinearizedReadings, which: Index) -> Array:
        """Squared innovations of `which` readings of a batch."""
        inverse, coupling, slot = self._system.factor
        nis: Array = kernels.squared_innovations(
            *kernel_arguments(terms.batch), which, self.layout.nodes, self.layout.dof, inverse,
            coupling, slot[self._first :], self.nodes.step[self._first :], terms.weights[which],
        )  # fmt: skip
        return nis

    def newest(self) -> tuple[State, Array]:
        """Estimate (N,) at the newest time and its covariance (D, D), in the axes of the state."""
        start, end = self.nodes.state.take(-1), self.nodes.newest[0]
        cov = self._root.T @ self._root
        if has_rolled(start, end):
            transport(start.slope_to(end)[None], cov[None])
        return end, cov

    def newest_step(self) -> tuple[Array, Array]:
        """Step (D,) of the newest node from its linearisation point, and covariance (D, D)."""
        return self.nodes.step[-1], self._root.T @ self._root

    def newest_nodes(self) -> StateEstimate:
        """Estimate at the newest time at the nodes (N,), with covariances (N, 18, 18)."""
        layout, (start, end) = self.layout, (self.nodes.state.take(-1), self.nodes.newest[0])
        cov = window_kernels.node_covariances(self._root, layout.nodes, layout.dof, DOF)
        if has_rolled(start, end):
            transport(whole(start.slope_to(end)[:, None, :DOF, :DOF]), cov)
        end = deepcopy(end)  # a caller may write to it
        return StateEstimate(end.pose, end.strain, end.velocity, cov)

    def posterior(self) -> Posterior:
        """The window as a posterior, like that of a recording."""
        state, values = deepcopy(self.nodes.estimate)  # a caller may write to it
        system, rhs = self._system.system()
        report = SolveReport(Outcome.UPDATED, 1, 0.0, rhs.size, 0.0, 0.0, 0, {})
        pairs = zip(self._process.each, self._process.columns, strict=True)
        parameters = [(p, values[:, at]) for p, at in pairs]
        start = self.nodes.state
        known = system, transported(start, state, self._system.cholesky.marginals())
        return Posterior(self.prior, self.grid(), state, *known, report, parameters, (start, start))
