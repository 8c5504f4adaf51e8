"""Stamps of a sender's clock as times of this computer's."""

from __future__ import annotations

import time

from glissando.hardware.drivers.clock import ClockFit
from glissando.hardware.openigtlink.message import seconds_since, stamp_of

_PERIOD = 1e-6  # s: stamps are fitted in microseconds
_RESET = 5_000_000  # of these back, and the sender's clock was set


class SenderClock:
    """Maps stamps to time.monotonic(), in one of the modes of an `Address`.

    Args:
        mode: "fitted", "shared" or "arrival".
    """

    def __init__(self, mode: str = "fitted") -> None:
        self._mode, self._newest = mode, -1
        self._fit = ClockFit(_PERIOD, 1 << 60)
        self._wall, self._monotonic = stamp_of(time.time()), time.monotonic()

    def monotonic(self, stamp: int, arrival: float) -> float:
        """When a message was stamped, s of time.monotonic(); its arrival if it has no stamp.

        Args:
            stamp: The stamp.
            arrival: When the message came, s of time.monotonic().
        """
        if stamp == 0 or self._mode == "arrival":
            return arrival
        if self._mode == "shared":
            return self._monotonic + seconds_since(stamp, self._wall)
        count = (stamp * 1_000_000) >> 32
        if count > self._newest or self._newest - count > _RESET:
            self._newest = self._fit.add(count, arrival)
        return self._fit.time(count)

    def std_time(self) -> float:
        """Standard deviation of the newest time, s, as far as arrivals tell."""
        return self._fit.std_time(self._newest) if self._newest >= 0 else 0.0
