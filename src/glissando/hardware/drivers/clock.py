"""Clock synchronisation: host time as a function of a device's counter."""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array

_BLOCKS = 32  # blocks of successive readings; the line fits the least delayed one of each
_LARGEST_BLOCK = 64  # largest number of readings in a block
_DRIFT = 1e-4  # standard deviation of a counter's rate about the nominal, relative
_JITTER = 2e-3  # s, prior of the delay; weighted as two readings
_STEP = 0.1  # s off the line, above which it is not a delay but a jump of the counter
_PATIENCE = 40  # successive late readings after which the counter counts as having jumped
_REACH = 3.0  # standard deviations at which the weight of a reading is a quarter


class ClockFit:
    """Maps a device's counter to the host's monotonic clock, in bounded memory.

    A reading arrives `latency` after its measurement, plus a delay that is never negative.
    Therefore the least delayed reading of each block of successive readings is kept, and a robust
    line fitted through these. The minimum of many delays is nearly exponential, with a mean equal
    to its standard deviation, by which the line is lowered. A constant delay cannot be estimated
    from arrivals; `latency` supplies it.

    time(n) = `offset` + `period` (n − `origin`) − latency, with `cov` (2, 2) of offset and period.

    Args:
        period: Nominal duration of one count, s.
        modulus: Count at which the counter wraps.
        latency: Constant delay from a reading to its arrival, s.
        std_latency: Standard deviation of `latency`, s.

    >>> clock = ClockFit(period=0.025, modulus=2**32)
    >>> for n in range(400):
    ...     _ = clock.add(n, host=10.0 + 0.025 * n + 0.003 * (n % 7))
    >>> round(clock.time(400), 3), clock.std_time(400) < 1e-3
    (20.0, True)
    """

    def __init__(
        self, period: float, modulus: int, *, latency: float = 0.0, std_latency: float = 0.0
    ):
        self._nominal, self._modulus = period, modulus
        self._latency, self._std_latency = latency, std_latency
        self.restarts = -1
        self.restart()

    def restart(self) -> None:
        """Discard the fit, as after a reset of the device; `restarts` counts the calls."""
        self.restarts += 1
        self._last: int | None = None
        self._first = self._host = 0.0
        self._count: list[float] = []  # of the least delayed reading of each block, from the first
        self._delay: list[float] = []  # its arrival relative to the nominal rate
        self._block_least: tuple[float, float] | None = None
        self._block_count, self._block_size, self._late = 0, 1, 0
        self.origin, self.offset, self.period = 0.0, 0.0, self._nominal
        self.cov: Array = np.diag([_JITTER, _DRIFT * self._nominal]) ** 2

    def add(self, number: int, host: float) -> int:
        """Add one arrival, and return its unwrapped number.

        A repeated number is ignored. A smaller number, an arrival well before its predicted time,
        or many successive late arrivals restart the fit, as after a reset of the device.

        Args:
            number: Value of the counter.
            host: Time of arrival, s of the host's monotonic clock.
        """
        count = self._unwrapped(number, host)
        if count == self._last:
            return count
        if self._last is not None and (count < self._last or self._jumped(count, host)):
            self.restart()
            count = number
        if self._last is None:
            self._first, self._host = float(count), host
            self.origin, self.offset = float(count), host
        self._last = count
        steps = count - self._first
        self._add_to_block(steps, host - self._host - self._nominal * steps)
        return count

    def time(self, count: float) -> float:
        """Time at which an unwrapped number was measured, s of the host's monotonic clock."""
        return self.offset + self.period * (count - self.origin) - self._latency

    def std_time(self, count: float) -> float:
        """Standard deviation of `time(count)`, seconds."""
        row = np.array([1.0, count - self.origin])
        return float(np.sqrt(row @ self.cov @ row + self._std_latency**2))

    def count_at(self, time: float) -> float:
        """Unwrapped number, with a fraction, at a time in seconds."""
        return self.origin + (time + self._latency - self.offset) / self.period

    def _unwrapped(self, number: int, host: float) -> int:
        if self._last is None:
            return number
        expected = self.count_at(host - self._latency)
        return number + self._modulus * round((expected - number) / self._modulus)

    def _jumped(self, count: int, host: float) -> bool:
        late = host - self.time(count) - self._latency
        self._late = self._late + 1 if late > _STEP else 0
        return late < -_STEP or self._late >= _PATIENCE

    def _add_to_block(self, steps: float, delay: float) -> None:
        if self._block_least is None or delay < self._block_least[1]:
            self._block_least = (steps, delay)
        self._block_count += 1
        if self._block_count < self._block_size:
            return
        self._count.append(self._block_least[0])
        self._delay.append(self._block_least[1])
        self._block_least, self._block_count = None, 0
        if len(self._count) == _BLOCKS:
            self._merge_blocks()
        self._fit()

    def _merge_blocks(self) -> None:
        """Halve the number of blocks by merging pairs, or drop the oldest block of largest size."""
        if self._block_size == _LARGEST_BLOCK:
            self._count, self._delay = self._count[1:], self._delay[1:]
            return
        later = np.argmin(np.reshape(self._delay, (-1, 2)), axis=1)
        least = 2 * np.arange(_BLOCKS // 2) + later
        self._count = [self._count[k] for k in least]
        self._delay = [self._delay[k] for k in least]
        self._block_size *= 2

    def _fit(self) -> None:
        """Fit the robust line: Geman-McClure weights, and a prior of the rate about the nominal."""
        count, delay = np.array(self._count), np.array(self._delay)
        middle = float(count.mean())
        x = self._nominal * (count - middle)
        rows = np.stack([np.ones_like(x), x], axis=-1)
        present = self.offset - self._host + self.period * (middle + self._first - self.origin)
        present -= self._nominal * middle
        line = np.array([present, self.period / self._nominal - 1.0])
        if count.size < 5:
            line = np.array([float(np.median(delay)), 0.0])
        for _ in range(6):
            residual = delay - rows @ line
            centred = residual - np.median(residual)
            scale = max(1.4826 * float(np.median(np.abs(centred))), 1e-6)
            weight = 1.0 / (1.0 + (centred / (_REACH * scale)) ** 2) ** 2
            variance = (2.0 * (_JITTER / self._block_size) ** 2 + np.sum(weight * residual**2)) / (
                2.0 + np.sum(weight)
            )
            normal = (rows.T * weight) @ rows / variance + np.diag([0.0, _DRIFT**-2])
            line = np.linalg.solve(normal, rows.T @ (weight * delay) / variance)
        std = float(np.sqrt(variance))
        # The weights remove tails that the covariance should include, and the standard deviation of
        # the amount by which the line is lowered is about half that amount.
        cov = 1.5 * np.linalg.inv(normal)
        cov[0, 0] += (0.5 * std) ** 2
        scaling = np.diag([1.0, self._nominal])
        self.origin = middle + self._first
        self.offset = self._host + self._nominal * middle + float(line[0]) - std
        self.period = self._nominal * (1.0 + float(line[1]))
        self.cov = scaling @ cov @ scaling
