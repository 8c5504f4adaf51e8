"""Session time that follows the topic /clock, as a node with use_sim_time does."""

from __future__ import annotations

import time

import numpy as np

from glissando.errors import DeviceError
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.openigtlink import seconds_since, stamp_of
from glissando.hardware.ros2.graph import Graph

_SECOND = 1_000_000_000  # ns
_EPOCH = 10**15  # ns: later times count from a calendar's beginning, not from a simulation's
_BACK = 0.1  # s by which time may seem to go back, as with two publishers
_SILENT = 20.0  # s of the host's clock without anybody who publishes /clock
_LOOK = 0.001  # s


class SimulatedClock(SessionClock):
    """Session time is the simulated time, and stands while the simulation does.

    If that counts from a calendar's beginning, the whole seconds at which it began are left out.

    Args:
        graph: The node, whose parameter use_sim_time is set.

    Raises:
        DeviceError: From `now` and `sleep_until`: time went back, or nobody publishes it any more.
    """

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self._graph, self._newest = graph, 0
        self._origin: int | None = None

    def begin_at(self, first: float) -> None:
        """Simulated time has a beginning of its own."""

    def of_nanoseconds(self, simulated: int) -> float:
        """Session time of a simulated time in ns, s."""
        if self._origin is None:
            self._origin = 0 if simulated < _EPOCH else simulated - simulated % _SECOND
        return 1e-9 * (simulated - self._origin)

    def now(self) -> float:
        """Session time now, s; −∞ before the first message on /clock."""
        simulated: int = self._graph.node.get_clock().now().nanoseconds
        if simulated < self._newest - _BACK * _SECOND:
            raise DeviceError(
                f"Simulated time went back from {1e-9 * self._newest:.3f} to "
                f"{1e-9 * simulated:.3f} s; start a new session after a reset."
            )
        self._newest = max(self._newest, simulated)
        return self.of_nanoseconds(simulated) if simulated else -np.inf

    def of_monotonic(self, monotonic: float) -> float:
        """Session time now: the host's clock says nothing about simulated time."""
        return self.now()

    def of_stamp(self, stamp: int) -> float:
        """Session time, s, of an OpenIGTLink stamp of simulated time."""
        return seconds_since(stamp, self._begun)

    def stamp(self, session: float) -> int:
        """The OpenIGTLink stamp of a session time in s."""
        return self._begun + stamp_of(session)

    @property
    def _begun(self) -> int:
        return (self._origin or 0) // _SECOND << 32

    def sleep_until(self, session: float) -> None:
        """Wait until a session time, s, however long the simulation stands."""
        published = time.monotonic()
        while self.now() < session:
            self._graph.spin()
            if self._graph.node.count_publishers("/clock"):
                published = time.monotonic()
            elif time.monotonic() - published > _SILENT:
                raise DeviceError("Nobody publishes /clock any more; start the simulation again.")
            time.sleep(_LOOK)
