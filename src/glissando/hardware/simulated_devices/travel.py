"""Travel of the slide, received by UDP from another simulated device."""

from __future__ import annotations

import socket
import struct
from collections import deque

import numpy as np

from glissando.errors import SimulationError

MESSAGE = struct.Struct("<dd")
"""A datagram: time.monotonic() in s, and travel in m."""
_HISTORY = 400
_AHEAD = 0.02  # s for which the travel is extrapolated at constant speed between datagrams


class Travel:
    """Travel received at 127.0.0.1:`port`, at any recent time.

    Raises:
        SimulationError: The port is in use.
    """

    def __init__(self, port: int):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        try:
            self.socket.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as problem:
            self.socket.close()
            raise SimulationError(
                f"UDP port {port} cannot be listened on ({problem}); give another --travel."
            ) from None
        self._points: deque[tuple[float, float]] = deque(maxlen=_HISTORY)

    def at(self, time: float) -> float:
        """Travel in m at a time.monotonic(); 0 before the first datagram, held after the last."""
        self._receive()
        if not self._points:
            return 0.0
        times, travels = np.array(self._points).T
        late = time - times[-1]
        if 0.0 < late <= _AHEAD and times.size > 1:
            step = times[-1] - times[-2]
            return float(travels[-1] + late * (travels[-1] - travels[-2]) / step)
        return float(np.interp(time, times, travels))

    def _receive(self) -> None:
        while True:
            try:
                datagram = self.socket.recv(64)
            except BlockingIOError:
                return
            if len(datagram) != MESSAGE.size:
                continue
            time, travel = MESSAGE.unpack(datagram)
            newer = not self._points or time > self._points[-1][0]
            if newer and np.isfinite(time) and np.isfinite(travel):
                self._points.append((time, travel))
