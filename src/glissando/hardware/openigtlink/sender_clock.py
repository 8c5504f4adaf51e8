"""Conversion of stamps of a sender's clock to times of this computer's clock."""

from __future__ import annotations

import time

from glissando.hardware.drivers.clock import ClockFit
from glissando.hardware.openigtlink.message import seconds_since, stamp_of

_PERIOD = 1e-6  # s: stamps are fitted in microseconds
_RESET = 5_000_000  # µs back, beyond which the sender's clock was set
_STEP = 0.1  # s later than the newest message was, beyond which the clock may have been set
_FEW, _SPAN = 3, 100_000  # successive messages, and µs between them, that confirm it


class SenderClock:
    """Converts stamps to time.monotonic(), in one of the modes of an `Address`.

    Args:
        mode: "fitted", "shared" or "arrival".
    """

    def __init__(self, mode: str = "fitted") -> None:
        self._mode, self._newest = mode, -1
        self._fit = ClockFit(_PERIOD, 1 << 60)
        self._late = 0.0  # s by which the newest message arrived later than others
        self._behind, self._first = 0, 0  # successive messages that seem set back, and their first
        self._wall, self._monotonic = stamp_of(time.time()), time.monotonic()

    def monotonic(self, stamp: int, arrival: float) -> float:
        """Time at which a message was stamped, s of time.monotonic(); its arrival without a stamp.

        Args:
            stamp: The stamp.
            arrival: Time at which the message arrived, s of time.monotonic().
        """
        if stamp == 0 or self._mode == "arrival":
            return arrival
        if self._mode == "shared":
            return self._monotonic + seconds_since(stamp, self._wall)
        count = (stamp * 1_000_000) >> 32
        if count > self._newest or self._set_back(count, arrival):
            self._newest = self._fit.add(count, arrival)
            self._late = max(arrival - self._fit.time(count), 0.0)
            self._behind = 0
        return self._fit.time(count)

    def _set_back(self, count: int, arrival: float) -> bool:
        """Whether the sender's clock was set back, not the message overtaken by a newer one.

        Messages of several devices may arrive in any order, and late together; but then none is
        much later than the newest was, or all have nearly the same stamp.
        """
        if self._newest - count > _RESET:
            return True
        if arrival - self._fit.time(count) - self._late < _STEP:
            self._behind = 0
        elif count < self._newest:
            self._first = count if not self._behind else self._first
            self._behind += 1
        return self._behind >= _FEW and count - self._first >= _SPAN

    def std_time(self) -> float:
        """Standard deviation of the newest time, s, estimated from arrivals."""
        return self._fit.std_time(self._newest) if self._newest >= 0 else 0.0
