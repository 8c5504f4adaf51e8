"""Serves a device's bytes over TCP and a pseudo-terminal, in one thread."""

from __future__ import annotations

import contextlib
import heapq
import os
import pty
import selectors
import signal
import socket
import sys
import time
import tty
from collections.abc import Callable
from itertools import count
from pathlib import Path

from glissando.errors import SimulationError

Hear = Callable[[bytearray, float], list[tuple[float, bytes]]]
"""Takes whole messages out of a buffer at a time; returns what to send and when, in seconds."""


class Serving:
    """Serves until standard input closes or SIGTERM comes; `hear` answers for the device.

    While `cut` says so, network connections are closed and a pseudo-terminal stays silent.
    """

    def __init__(self, hear: Hear, cut: Callable[[float], bool] = lambda now: False):
        self._hear, self._cut = hear, cut
        self._selector = selectors.DefaultSelector()
        self._due: list[tuple[float, int, Callable[[bytes], object], bytes]] = []
        self._order = count()
        self._link: Path | None = None
        self._listening: socket.socket | None = None
        self._ends: list[int] = []

    def listen(self, port: int) -> str:
        """Accept connections on 127.0.0.1:port, any free one for 0; returns the address."""
        self._listening = server = socket.socket()
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind(("127.0.0.1", port))
            server.listen()
        except (OSError, OverflowError) as problem:
            server.close()
            raise SimulationError(
                f"TCP port {port} cannot be listened on ({problem}); give another, or 0 for any."
            ) from None
        server.setblocking(False)
        self._selector.register(server, selectors.EVENT_READ, lambda: self._accept(server))
        return f"tcp://127.0.0.1:{server.getsockname()[1]}"

    def open_terminal(self, link: Path) -> str:
        """Serve a pseudo-terminal that `link` leads to; returns the link."""
        ours, theirs = pty.openpty()
        self._ends += [ours, theirs]  # theirs stays open, so that clients may come and go
        for end in (ours, theirs):
            tty.setraw(end)
        os.set_blocking(ours, False)
        if link.is_symlink():
            link.unlink()
        try:
            link.symlink_to(os.ttyname(theirs))
        except OSError as problem:
            raise SimulationError(f"{link} cannot be made ({problem}); give another.") from None
        self._link, held = link, bytearray()

        def read() -> None:
            held.extend(os.read(ours, 4096))
            now = time.monotonic()
            if self._cut(now):
                held.clear()
            self._answer(held, now, lambda reply: os.write(ours, reply))

        self._selector.register(ours, selectors.EVENT_READ, read)
        return str(link)

    def _accept(self, server: socket.socket) -> None:
        client, _ = server.accept()
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        held = bytearray()

        def read() -> None:
            came = b""
            with contextlib.suppress(OSError):
                came = client.recv(4096)
            held.extend(came)
            now = time.monotonic()
            if not came or self._cut(now):
                self._selector.unregister(client)
                client.close()
            else:
                self._answer(held, now, client.sendall)

        self._selector.register(client, selectors.EVENT_READ, read)

    def _answer(self, held: bytearray, now: float, send: Callable[[bytes], object]) -> None:
        for when, reply in self._hear(held, now):
            heapq.heappush(self._due, (when, next(self._order), send, reply))

    def run(self, *addresses: str) -> None:
        """Print the addresses as one line and serve."""
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        with contextlib.suppress(PermissionError):  # a file, or /dev/null: nobody closes those
            self._selector.register(sys.stdin, selectors.EVENT_READ, _end_with_input)
        print(*addresses, flush=True)
        try:
            while True:
                wait = max(self._due[0][0] - time.monotonic(), 0.0) if self._due else None
                for key, _ in self._selector.select(wait):
                    key.data()
                self._send_due()
        except (SystemExit, KeyboardInterrupt):
            pass
        finally:
            self._close()

    def _send_due(self) -> None:
        while self._due and self._due[0][0] <= time.monotonic():
            *_, send, reply = heapq.heappop(self._due)
            with contextlib.suppress(OSError):  # nobody listens any more
                send(reply)

    def _close(self) -> None:
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        if self._listening is not None:
            self._listening.close()
        for end in self._ends:
            os.close(end)


def _end_with_input() -> None:
    if not os.read(sys.stdin.fileno(), 4096):
        sys.exit(0)
