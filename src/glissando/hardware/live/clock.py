"""Session time: seconds since the start of a session, by the host's monotonic and wall clocks."""

from __future__ import annotations

import time

from glissando.hardware.openigtlink import seconds_since, stamp_of


class SessionClock:
    """Converts the host's clocks to session time, the time of all readings and estimates."""

    def __init__(self) -> None:
        self.begin_at(0.0)

    def begin_at(self, first: float) -> None:
        """Define the present instant as session time `first`, s."""
        self._first, self._monotonic = first, time.monotonic()
        self._stamp = stamp_of(time.time())

    def now(self) -> float:
        """Present session time, s."""
        return self.of_monotonic(time.monotonic())

    def of_monotonic(self, monotonic: float) -> float:
        """Session time, s, of a value of `time.monotonic`."""
        return self._first + (monotonic - self._monotonic)

    def of_stamp(self, stamp: int) -> float:
        """Session time, s, of an OpenIGTLink stamp of this host's wall clock."""
        return self._first + seconds_since(stamp, self._stamp)

    def stamp(self, session: float) -> int:
        """OpenIGTLink stamp of a session time in s."""
        return max(0, self._stamp + stamp_of(session - self._first))

    def sleep_until(self, session: float) -> None:
        """Wait until a session time, s."""
        time.sleep(max(0.0, session - self.now()))
