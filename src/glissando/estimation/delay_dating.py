"""Online estimation of delays by the motion of other streams, corrected for the motion's noise.

A second smoother estimates the motion from the streams without an estimated delay. It is also
solved for readings of pure noise, which make a robot at rest appear to move, and the information on
a delay from that is subtracted. See `delays`.
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

_ROUNDING = 1e-13  # relative to a diagonal entry of the information


class DelayCounting:
    """Estimate of delays from readings that left a window, and the share of later ones that counts.

    A reading depends on its delay d by the slope of an estimated motion, of which a share is
    noise, see `slope_share`. The density of states given a delay, p(x | d), is still valid; the
    readings' information on the delay itself is noise by that share. So the joint density remains
    p(x | d) p(d), and negative information on d alone removes from p(d) what does not count. If d
    were fixed until some information counts, readings that left the window before would support the
    fixed value ever after. The share of readings is not changed after they left the window.
    """

    def __init__(self, process: EstimatedParameters) -> None:
        """Begin with the stated values."""
        self.columns = process.delay_columns
        delays = [p for p in process.each if is_delay(p)]
        self._delays = EstimatedParameters(process.grid, delays)
        self.begin(0.0, process.mean, np.diag(process.std**2))

    def begin(self, time: float, values: Array, cov: Array) -> None:
        """Begin at a time, with values (E,) and covariance (E, E) of all sensor parameters."""
        at = self.columns
        self._time, self._values, self._cov = time, values[at], cov[np.ix_(at, at)]

    def lag(self, stream: str) -> float:
        """Root mean square of a stream's delay, s, by readings that left the window; 0 without."""
        own = [stream in parameter.streams for parameter in self._delays.each]
        return float(np.sqrt(np.sum(np.diagonal(self._cov)[own] + self._values[own] ** 2)))

    def correction(
        self, time: float, values: Array, info: Array, start: Array, shares: Array
    ) -> tuple[Array, Array]:
        """Information on the delays (d, d) to add, and right-hand side (d,) about zero.

        Noise of a slope biases a delay towards its linearisation point, the more the farther away
        the delay may be: for a sum of squares of slopes with information δ, of which a share n is
        noise, the variance is 1/δ + n E(Δd)², the mean that of (1 − n) Δd.

        Args:
            time: Seconds.
            values: Estimates of the delays (d,) from all readings, s.
            info: Information (d, d) of these estimates.
            start: Values (d,) at which readings are linearised.
            shares: Shares (d,) of the delays' slopes that count.
        """
        before, cov = self._delays.faded(time - self._time, self._values, self._cov)
        prior_info = np.linalg.inv(cov)
        data_info = info - prior_info
        rhs = info @ (values - start) - prior_info @ (before - start)
        off = cov + np.diag((before - start) ** 2)
        noise = np.diag(1.0 - shares**2)
        weight = shares[:, None] * np.linalg.inv(np.eye(shares.size) + data_info @ noise @ off)
        counted = weight @ data_info * shares
        counted_rhs = weight @ rhs / np.where(shares > 0.0, shares, 1.0)
        more = 0.5 * (counted + counted.T) - data_info
        return more, counted_rhs - rhs + more @ start

    def leave(
        self, time: float, known: tuple[Array, Array], at: Index, start: Array, shares: Array
    ) -> tuple[Array, Array]:
        """Count readings that left a window; the correction to their prior on the next node.

        Args:
            time: Time of the next node, s.
            known: That prior on all unknowns of the node: information (D, D), of which the lower
                half is used, and right-hand side (D,).
            at: Indices of the delays (d,) among the unknowns.
            start: Values (d,) at which the delays are linearised.
            shares: Shares (d,) of the delays' slopes that count.

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
    """Window of a smoother without the streams whose delay is estimated."""

    nodes: Nodes

    @property
    def started(self) -> bool:
        """Whether there is a node."""

    @property
    def estimate_and_noise(self) -> tuple[State, State]:
        """Estimated nodes (K, N), and these moved by the response to noise of the readings."""


class DelayDating:
    """Dates the delayed readings of a window by the motion of another window.

    Attributes:
        motion: Nodes (K, N) of the window, estimated from streams without a delay.
        sums: Sums of the whole window as last recorded.
        information: Information on the delays from that motion and from its noise.
        counting: Estimate of the delays from the information that counts.
    """

    motion: State
    sums: NormalEquationsBuilder

    def __init__(self, others: Window, process: EstimatedParameters) -> None:
        """Date the delays among sensor parameters by the motion of a window of other streams."""
        self._others, self._size = others, process.size
        self._columns = process.delay_columns
        self._delays = [p for p in process.each if is_delay(p)]
        self.information = SlopeInformation(delayed_streams(process), self._columns)
        self.counting = DelayCounting(process)
        self._slopes: list[Slopes] = []
        self._spans_delay = False

    def copied(self) -> DelayDating:
        """A copy that can be changed without changing this one."""
        out = copy(self)
        out.information, out.counting = self.information.copied(), copy(self.counting)
        return out

    def begin(self, layout: Layout, info: Array, time: float, known: tuple[Array, Array]) -> None:
        """Begin a window with one node.

        Args:
            layout: Layout of the unknowns of a slab.
            info: Prior information (D, D) on the node.
            time: Time of the node, s.
            known: Values (E,) and covariance (E, E) of the sensor parameters at that time.
        """
        self.information.begin(layout, info)
        self.counting.begin(time, *known)

    def leave(self, nodes: Nodes, system: WindowSystem) -> None:
        """Count readings that just left the window, of which these nodes (K, N) remain."""
        self.information.drop()
        at, start = self._linearized_at(nodes, 0)
        time, known = float(nodes.time[0]), (system.info, system.rhs)
        system.add(at, *self.counting.leave(time, known, at, start, self.shares))

    def counted(self, nodes: Nodes, system: WindowSystem) -> Array:
        """Step (K, D) of a window if only a share of the information on delays counts."""
        at, start = self._linearized_at(nodes, -1)
        own, values = system.root[:, at], start + nodes.step[-1, at]
        time, info = float(nodes.time[-1]), np.asarray(np.linalg.inv(own.T @ own))
        more, rhs = self.counting.correction(time, values, info, start, self.shares)
        return system.solve_with(self.sums, at, more, rhs - more @ start)

    def _linearized_at(self, nodes: Nodes, node: int) -> tuple[Index, Array]:
        """Indices (d,) of the delays among a node's unknowns, and their linearisation points."""
        columns = np.array(self._columns)
        start: Array = nodes.parameters[node, columns]
        return nodes.state.numbers + columns, start

    def see(self, nodes: Nodes, first: int, free: int, longest: float) -> Nodes:
        """Compute the motion at the nodes of a window, and their derivatives by a delay.

        Args:
            nodes: Nodes (K, N) of the window.
            first: First node from which readings are linearised.
            free: First node whose linearisation may move: from it on derivatives are updated.
            longest: Longest possible delay, s; a window that spans less dates nothing.

        Returns:
            The nodes with their derivatives by a delay.
        """
        self._spans_delay = bool(nodes.time[-1] - nodes.time[0] >= longest)
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
        """Record the slopes of a stream's readings along the motion and along its noise."""
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
        """Share (d,) of the motion's slope that counts for each delay, the rest being noise."""
        shares = [
            min(self.information.share(stream) for stream in parameter.streams)
            for parameter in self._delays
        ]
        return np.array(shares) if self._spans_delay else np.zeros(len(shares))

    def note(self, sums: NormalEquationsBuilder) -> None:
        """Record the sums of a whole window, and the slopes of its readings."""
        self.sums = sums
        self.information.note(sums, self._slopes)

    def _motions(self, nodes: Nodes) -> list[State]:
        """Motion at the times of nodes, without and with noise; constant before it is known."""
        others = self._others
        if not others.started:
            return 2 * [nodes.state.take(np.zeros(len(nodes), dtype=int))]
        return [at_times(m, others.nodes.time, nodes.time) for m in others.estimate_and_noise]
