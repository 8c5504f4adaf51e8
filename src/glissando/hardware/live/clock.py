"""Session time: seconds since a session began, of the host's monotonic and wall clocks."""

from __future__ import annotations

import time

from glissando.hardware.openigtlink import seconds_since, stamp_of


class SessionClock:
    """Maps the host's clocks to session time, in which readings and estimates are stamped."""

    def __init__(self) -> None:
        self.begin_at(0.0)

    def begin_at(self, first: float) -> None:
        """Let session time be `first` seconds now."""
        self._first, self._monotonic = first, time.monotonic()
        self._stamp = stamp_of(time.time())

    def now(self) -> float:
        """Session time now, s."""
        return self.of_monotonic(time.monotonic())

    def of_monotonic(self, monotonic: float) -> float:
        """Session time of a time.monotonic(), s."""
        return self._first + (monotonic - self._monotonic)

    def of_stamp(self, stamp: int) -> float:
        """Session time, s, of an OpenIGTLink stamp that counts this host's wall clock."""
        return self._first + seconds_since(stamp, self._stamp)

    def stamp(self, session: float) -> int:
        """The OpenIGTLink stamp of a session time in s."""
        return max(0, self._stamp + stamp_of(session - self._first))

    def sleep_until(self, session: float) -> None:
        """Wait until a session time, s."""
        time.sleep(max(0.0, session - self.now()))
