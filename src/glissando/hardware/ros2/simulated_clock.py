"""Session time that follows the topic /clock, as for a node with use_sim_time."""

from __future__ import annotations

import time

import numpy as np

from glissando.errors import DeviceError
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.openigtlink import seconds_since, stamp_of
from glissando.hardware.ros2.graph import Graph

_SECOND = 1_000_000_000  # ns
_EPOCH = 10**15  # ns, above which times count from a calendar epoch, not a simulation's start
_BACK = 0.1  # s by which time may seem to run backwards, as with two publishers
_SILENT = 20.0  # s of the host's clock without a publisher of /clock
_LOOK = 0.001  # s between polls


class SimulatedClock(SessionClock):
    """Session time equal to the simulated time, which pauses with the simulation.

    If that counts from a calendar epoch, the whole seconds of its first value are subtracted.

    Args:
        graph: Node whose parameter use_sim_time is set.

    Raises:
        DeviceError: From `now` and `sleep_until`: time ran backwards, or has no publisher any more.
    """

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self._graph, self._newest = graph, 0
        self._origin: int | None = None

    def begin_at(self, first: float) -> None:
        """Do nothing: the origin of simulated time is given."""

    def of_nanoseconds(self, simulated: int) -> float:
        """Session time, s, of a simulated time in ns."""
        if self._origin is None:
            self._origin = 0 if simulated < _EPOCH else simulated - simulated % _SECOND
        return 1e-9 * (simulated - self._origin)

    def now(self) -> float:
        """Present session time, s; −∞ before the first message on /clock."""
        simulated: int = self._graph.node.get_clock().now().nanoseconds
        if simulated < self._newest - _BACK * _SECOND:
            raise DeviceError(
                f"Simulated time went back from {1e-9 * self._newest:.3f} to "
                f"{1e-9 * simulated:.3f} s; start a new session after a reset."
            )
        self._newest = max(self._newest, simulated)
        return self.of_nanoseconds(simulated) if simulated else -np.inf

    def of_monotonic(self, monotonic: float) -> float:
        """Present session time, s, whatever `monotonic`: host and simulated time are unrelated."""
        return self.now()

    def of_stamp(self, stamp: int) -> float:
        """Session time, s, of an OpenIGTLink stamp of simulated time."""
        return seconds_since(stamp, self._begun)

    def stamp(self, session: float) -> int:
        """OpenIGTLink stamp of a session time in s."""
        return self._begun + stamp_of(session)

    @property
    def _begun(self) -> int:
        return (self._origin or 0) // _SECOND << 32

    def sleep_until(self, session: float) -> None:
        """Wait until a session time, s, however long the simulation pauses."""
        published = time.monotonic()
        while self.now() < session:
            self._graph.spin()
            if self._graph.node.count_publishers("/clock"):
                published = time.monotonic()
            elif time.monotonic() - published > _SILENT:
                raise DeviceError("Nobody publishes /clock any more; start the simulation again.")
            time.sleep(_LOOK)
