"""Online: by which motion delayed streams are dated, and how much of that motion is noise.

A second smoother shows the motion of the streams without an estimated delay. It also answers to
readings of nothing but noise, as it would make a robot at rest move, and what that would tell of a
delay is taken off. See `delays`.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Protocol

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from glissando.estimation.delays import (
    at_times,
    delayed_streams,
    is_delay,
    moving_with,
    slope_in_time,
)
from glissando.estimation.slope_information import SlopeInformation, Slopes
from glissando.estimation.window_nodes import Nodes
from glissando.estimation.window_system import WindowSystem
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.grid import Index
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.state import State
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder

_ROUNDING = 1e-13  # of a diagonal entry of the information


class DelayCounting:
    """What is known of delays by readings that left a window, and what counts of later ones.

    A reading depends on its delay d by the slope of an estimated motion, of which a share is
    noise, see `slope_share`. States given a delay, p(x | d), hold all the same; what readings tell
    of the delay itself is noise by that share. So the joint density stays p(x | d) p(d), and
    information on d alone, which is negative, takes off p(d) what does not count. Were d held at a
    value until some counts, the readings that left the window by then would speak for that value
    ever after. What counted when its readings left the window is not judged again.
    """

    def __init__(self, process: EstimatedParameters) -> None:
        """Begin with what is stated."""
        self.columns = process.delay_columns
        delays = [p for p in process.each if is_delay(p)]
        self._delays = EstimatedParameters(process.grid, delays)
        self.begin(0.0, process.mean, np.diag(process.std**2))

    def begin(self, time: float, values: Array, cov: Array) -> None:
        """What is known at a time: of all sensor parameters, values (E,), covariance (E, E)."""
        at = self.columns
        self._time, self._values, self._cov = time, values[at], cov[np.ix_(at, at)]

    def lag(self, stream: str) -> float:
        """Root mean square of a stream's delay, s, by what left the window; 0 where it has none."""
        own = [stream in parameter.streams for parameter in self._delays.each]
        return float(np.sqrt(np.sum(np.diagonal(self._cov)[own] + self._values[own] ** 2)))

    def correction(
        self, time: float, values: Array, info: Array, start: Array, shares: Array
    ) -> tuple[Array, Array]:
        """Information on the delays (d, d) to add to all there is, and right-hand side (d,) by 0.

        A slope with noise finds a delay too near to where it is linearised, and errs the more the
        farther from there the delay may be: of a sum of squares of slopes that tells δ and is
        noise by a share n, the variance is 1/δ + n E(Δd)², the mean that of (1 − n) Δd.

        Args:
            time: Seconds.
            values: What all readings make of the delays (d,), s.
            info: Information (d, d) on them.
            start: Values (d,) at which readings are linearised.
            shares: How much of the slope of each counts (d,).
        """
        before, cov = self._delays.faded(time - self._time, self._values, self._cov)
        known = np.linalg.inv(cov)
        told = info - known
        rhs = info @ (values - start) - known @ (before - start)
        off = cov + np.diag((before - start) ** 2)
        noise = np.diag(1.0 - shares**2)
        weight = shares[:, None] * np.linalg.inv(np.eye(shares.size) + told @ noise @ off)
        counted = weight @ told * shares
        counted_rhs = weight @ rhs / np.where(shares > 0.0, shares, 1.0)
        more = 0.5 * (counted + counted.T) - told
        return more, counted_rhs - rhs + more @ start

    def leave(
        self, time: float, known: tuple[Array, Array], at: Index, start: Array, shares: Array
    ) -> tuple[Array, Array]:
        """Count what left a window; the correction to what it says of the delays of the next node.

        Args:
            time: Of that node, s.
            known: What it says of all numbers of that node, information (D, D), of which the lower
                half counts, and right-hand side (D,).
            at: Which of those are the delays (d,).
            start: Values (d,) at which these are linearised.
            shares: How much of the slope of each counts (d,).

        Returns:
            Information (d, d) and right-hand side (d,) to add.
        """
        lower, rhs = known
        info = np.tril(lower) + np.tril(lower, -1).T
        others = np.setdiff1d(np.arange(len(rhs)), at)
        across, own = info[np.ix_(others, at)], info[np.ix_(others, others)]
        own += _ROUNDING * np.diag(np.diagonal(own))
        solved = cho_solve(cho_factor(own, lower=True), np.column_stack([across, rhs[others]]))
        of_delays = info[np.ix_(at, at)] - across.T @ solved[:, :-1]
        values = start + np.linalg.solve(of_delays, rhs[at] - across.T @ solved[:, -1])
        more, more_rhs = self.correction(time, values, of_delays, start, shares)
        self._time, self._cov = time, np.linalg.inv(of_delays + more)
        self._values = self._cov @ (of_delays @ values + more_rhs)
        return more, more_rhs - more @ start


class Window(Protocol):
    """A window of a smoother that estimated delays do not reach."""

    nodes: Nodes

    @property
    def started(self) -> bool:
        """Whether there is a node."""

    @property
    def estimate_and_noise(self) -> tuple[State, State]:
        """Nodes (K, N) as estimated, and moved by what noise of the readings makes of a robot."""


class DelayDating:
    """What dates the delayed readings of a window.

    Attributes:
        motion: Nodes (K, N) of the window as streams without a delay show them.
        sums: The sums of a whole window that were noted last.
        information: What that motion and its noise tell of the delays.
        counting: What of it counts.
    """

    motion: State
    sums: NormalEquationsBuilder

    def __init__(self, others: Window, process: EstimatedParameters) -> None:
        """Date by the motion of a window of the other streams, of these sensor parameters."""
        self._others, self._size = others, process.size
        self._columns = process.delay_columns
        self._delays = [p for p in process.each if is_delay(p)]
        self.information = SlopeInformation(delayed_streams(process), self._columns)
        self.counting = DelayCounting(process)
        self._slopes: list[Slopes] = []
        self._reaches = False

    def copied(self) -> DelayDating:
        """The same, to go on with without a change to this one."""
        out = copy(self)
        out.information, out.counting = self.information.copied(), copy(self.counting)
        return out

    def begin(self, layout: Layout, info: Array, time: float, known: tuple[Array, Array]) -> None:
        """Begin a window with one node.

        Args:
            layout: How its numbers are laid out.
            info: Information on them (D, D).
            time: Its time, s.
            known: Values (E,) and covariance (E, E) of the sensor parameters then.
        """
        self.information.begin(layout, info)
        self.counting.begin(time, *known)

    def leave(self, nodes: Nodes, system: WindowSystem) -> None:
        """Count what a window just left behind; these nodes (K, N) stay."""
        self.information.drop()
        at, start = self._linearized_at(nodes, 0)
        time, known = float(nodes.time[0]), (system.info, system.rhs)
        system.add(at, *self.counting.leave(time, known, at, start, self.shares))

    def counted(self, nodes: Nodes, system: WindowSystem) -> Array:
        """The step (K, D) of a window where of what readings tell of delays the share counts."""
        at, start = self._linearized_at(nodes, -1)
        own, values = system.root[:, at], start + nodes.step[-1, at]
        time, info = float(nodes.time[-1]), np.asarray(np.linalg.inv(own.T @ own))
        more, rhs = self.counting.correction(time, values, info, start, self.shares)
        return system.solve_with(self.sums, at, more, rhs - more @ start)

    def _linearized_at(self, nodes: Nodes, node: int) -> tuple[Index, Array]:
        """Which of a node's numbers are delays (d,), and at which values they are linearised."""
        columns = np.array(self._columns)
        start: Array = nodes.parameters[node, columns]
        return nodes.state.numbers + columns, start

    def see(self, nodes: Nodes, first: int, free: int, longest: float) -> Nodes:
        """Find the motion of a window.

        Args:
            nodes: Its nodes (K, N).
            first: From which one on readings are linearised.
            free: The first whose linearisation may move: what moves with a delay is found anew.
            longest: How long a delay may be, s; nodes that reach back less date nothing.

        Returns:
            The nodes, with how they move with a delay.
        """
        self._reaches = bool(nodes.time[-1] - nodes.time[0] >= longest)
        motion, other = self._motions(nodes)
        slope, noisy = (slope_in_time(m, nodes.time) for m in (motion, other))
        own = slope_in_time(nodes.state, nodes.time) - slope
        nodes = replace(nodes, own=np.concatenate([nodes.own[:free], own[free:]]))
        self.motion = motion.take(slice(first, None))
        self._by_time = np.stack([slope, noisy - slope])[:, first:]
        self._slopes = []
        return nodes

    def moving(self, factors: Factors, nodes: Nodes) -> Factors:
        """Factors of a motion that moves with the delays, see `delays.moving_with`."""
        return moving_with(factors, nodes.own, self._columns, self._size)

    def see_slopes(self, stream: str, factors: Factors) -> None:
        """Take the slopes of a stream's readings along the motion and along its noise."""
        if factors.extras is None:
            return
        m, r = factors.terms.residual.shape
        extras = factors.extras.reshape(m, r, 2, -1)
        if not extras[..., self._columns].any():
            return
        k, n = np.divmod(factors.nodes, self._by_time.shape[2])
        slopes = self._by_time[:, k, n][..., factors.dofs]
        by_time = np.einsum("mrcd,amcd->amr", factors.jacobian, slopes)
        self._slopes.append(Slopes(stream, factors, by_time))

    @property
    def shares(self) -> Array:
        """How much of the motion's slope counts for each delay (d,): what is no noise."""
        shares = [
            min(self.information.share(stream) for stream in parameter.streams)
            for parameter in self._delays
        ]
        return np.array(shares) if self._reaches else np.zeros(len(shares))

    def note(self, sums: NormalEquationsBuilder) -> None:
        """Note what the motion tells in a whole window of these sums."""
        self.sums = sums
        self.information.note(sums, self._slopes)

    def _motions(self, nodes: Nodes) -> list[State]:
        """The motion at the times of nodes, and with noise; none before there is any."""
        others = self._others
        if not others.started:
            return 2 * [nodes.state.take(np.zeros(len(nodes), dtype=int))]
        return [at_times(m, others.nodes.time, nodes.time) for m in others.estimate_and_noise]
