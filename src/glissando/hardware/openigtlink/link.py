"""Link between an estimator and the process that communicates with its peers.

Packets go both ways over a local socket: length, kind and data. The estimator's side never waits: a
packet is not sent while the previous one is incomplete, and the process drops and counts the oldest
of its own when they are not read in time.
"""

from __future__ import annotations

import socket
import struct
from enum import IntEnum

PACKET = struct.Struct(">IB")
ARRIVAL = struct.Struct(">d")
_READ = 1 << 16
_MOST_READ = 1 << 20  # bytes a call


class Packet(IntEnum):
    """Kinds of packets."""

    BUNDLE = 0  # messages for all peers
    MESSAGE = 1  # arrival time and message of a peer
    REPORT = 2  # number of peers, port and counts, in JSON
    FAILURE = 3  # reason why there cannot be peers


class PacketLink:
    """Packets over a connected socket, without blocking."""

    def __init__(self, connected: socket.socket) -> None:
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket = connected
        self._unsent: memoryview = memoryview(b"")
        self._received = bytearray()
        self.ended = False

    @property
    def clear(self) -> bool:
        """Whether the last packet has been sent completely."""
        return not self._unsent

    def send(self, kind: int, data: bytes) -> bool:
        """Send a packet; False, without effect, while an earlier one is incomplete."""
        self.flush()
        if self._unsent or self.ended:
            return False
        self._unsent = memoryview(PACKET.pack(len(data), kind) + data)
        self.flush()
        return True

    def flush(self) -> None:
        """Send as much of the last packet as the socket accepts."""
        while self._unsent and not self.ended:
            try:
                self._unsent = self._unsent[self.socket.send(self._unsent) :]
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                self.ended = True

    def receive(self, most: int = 1 << 20) -> list[tuple[int, bytes]]:
        """Packets that have arrived, at most `most` of them and about a megabyte in a call."""
        if len(self._received) < _MOST_READ:
            self._read()
        at, out = 0, list[tuple[int, bytes]]()
        while len(out) < most and len(self._received) >= at + PACKET.size:
            size, kind = PACKET.unpack_from(self._received, at)
            begin, end = at + PACKET.size, at + PACKET.size + size
            if len(self._received) < end:
                break
            out.append((kind, bytes(self._received[begin:end])))
            at = end
        del self._received[:at]
        return out

    def _read(self) -> None:
        for _ in range(_MOST_READ // _READ):
            try:
                data = self.socket.recv(_READ)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                data = b""
            if not data:
                self.ended = True
                return
            self._received += data
            if len(data) < _READ:
                return

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()
