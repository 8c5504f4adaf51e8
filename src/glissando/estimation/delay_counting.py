"""Online: of what readings tell of delays only a share counts, while states depend on them in full.

A reading depends on its delay d by the slope of an estimated motion, of which a share is noise, see
`slope_share`. States given a delay, p(x | d), hold all the same; what readings tell of the delay
itself is noise by that share. So the joint density stays p(x | d) p(d), and information on d alone,
which is negative, takes off p(d) what does not count. Were d held at a value until some counts, the
readings that left the window by then would speak for that value ever after. What counted when its
readings left the window is not judged again.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.sensors.parameter_process import EstimatedParameters

_ROUNDING = 1e-13  # of a diagonal entry of the information


class DelayCounting:
    """What is known of delays by readings that left a window, and what counts of later ones."""

    def __init__(self, process: EstimatedParameters) -> None:
        """Begin with what is stated."""
        self.columns = process.delay_columns
        delays = [p for p in process.each if p.kind == "time_offset"]
        self._delays = EstimatedParameters(process.grid, delays)
        self.begin(0.0, process.mean, np.diag(process.std**2))

    def begin(self, time: float, values: Array, cov: Array) -> None:
        """What is known at a time: of all sensor parameters, values (E,), covariance (E, E)."""
        at = self.columns
        self._time, self._values, self._cov = time, values[at], cov[np.ix_(at, at)]

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
