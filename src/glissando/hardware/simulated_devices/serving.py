"""Serves a simulated device over TCP and a pseudo-terminal, in one thread."""

from __future__ import annotations

import argparse
import contextlib
import heapq
import math
import os
import pty
import selectors
import signal
import socket
import sys
import time
import tty
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path

from glissando.errors import GlissandoError, SimulationError
from glissando.hardware.simulated_devices.travel import MESSAGE

_PERIOD = 0.005  # s between datagrams of an axis

Receive = Callable[[bytearray, float], list[tuple[float, bytes]]]
"""Removes the complete messages from a buffer at a time; returns times (s) and replies."""


class Serving:
    """Serves until standard input closes or on SIGTERM.

    Args:
        receive: Processes the buffer of received bytes.
        cut: Whether, at a time, connections are closed and a pseudo-terminal stays silent.
        beat: Called periodically with the time; returns the time of its next call, s.
    """

    def __init__(
        self,
        receive: Receive = lambda held, now: [],
        cut: Callable[[float], bool] = lambda now: False,
        beat: Callable[[float], float] = lambda now: float("inf"),
    ):
        self._receive, self._cut, self._beat = receive, cut, beat
        self._selector = selectors.DefaultSelector()
        self._due: list[tuple[float, int, Callable[[bytes], object], bytes]] = []
        self._order = count()
        self._resources = contextlib.ExitStack()

    def listen(self, port: int) -> str:
        """Accept connections on 127.0.0.1:port (any free port for 0); returns the address."""
        server = self._resources.enter_context(socket.socket())
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind(("127.0.0.1", port))
            server.listen()
        except (OSError, OverflowError) as problem:
            raise SimulationError(
                f"TCP port {port} cannot be listened on ({problem}); give another, or 0 for any."
            ) from None
        server.setblocking(False)
        self._selector.register(server, selectors.EVENT_READ, lambda: self._accept(server))
        return f"tcp://127.0.0.1:{server.getsockname()[1]}"

    def open_terminal(self, link: Path | None) -> str:
        """Serve a pseudo-terminal, to which `link` points if given; returns the path to open."""
        ours, theirs = pty.openpty()
        for end in (ours, theirs):  # theirs stays open, so that clients may reconnect
            self._resources.callback(os.close, end)
            tty.setraw(end)
        os.set_blocking(ours, False)
        path = Path(os.ttyname(theirs))
        if link is not None:
            try:
                if link.is_symlink():
                    link.unlink()
                link.symlink_to(path)
            except OSError as problem:
                raise SimulationError(f"{link} cannot be made ({problem}); give another.") from None
            self._resources.callback(link.unlink, missing_ok=True)
        held = bytearray()

        def read() -> None:
            held.extend(os.read(ours, 4096))
            now = time.monotonic()
            if self._cut(now):
                held.clear()
            self._answer(held, now, lambda reply: os.write(ours, reply))

        self._selector.register(ours, selectors.EVENT_READ, read)
        return str(link or path)

    def _accept(self, server: socket.socket) -> None:
        client, _ = server.accept()
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        held = bytearray()

        def read() -> None:
            data = b""
            with contextlib.suppress(OSError):
                data = client.recv(4096)
            held.extend(data)
            now = time.monotonic()
            if not data or self._cut(now):
                self._selector.unregister(client)
                client.close()
            else:
                self._answer(held, now, client.sendall)

        self._selector.register(client, selectors.EVENT_READ, read)

    def _answer(self, held: bytearray, now: float, send: Callable[[bytes], object]) -> None:
        for when, reply in self._receive(held, now):
            heapq.heappush(self._due, (when, next(self._order), send, reply))

    def run(self, *addresses: str) -> None:
        """Print the addresses as one line, and serve."""
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        with contextlib.suppress(PermissionError):  # a file or /dev/null, which is never closed
            self._selector.register(sys.stdin, selectors.EVENT_READ, _end_with_input)
        print(*addresses, flush=True)
        beat = time.monotonic()
        with contextlib.suppress(SystemExit, KeyboardInterrupt), self._resources:
            while True:
                due = min(self._due[0][0] if self._due else beat, beat)
                wait = None if due == float("inf") else max(due - time.monotonic(), 0.0)
                for key, _ in self._selector.select(wait):
                    key.data()
                self._send_due()
                if (now := time.monotonic()) >= beat:
                    beat = self._beat(now)

    def _send_due(self) -> None:
        while self._due and self._due[0][0] <= time.monotonic():
            *_, send, reply = heapq.heappop(self._due)
            with contextlib.suppress(OSError):  # the client has disconnected
                send(reply)


def _end_with_input() -> None:
    if not os.read(sys.stdin.fileno(), 4096):
        sys.exit(0)


def device_parser(name: str, text: str | None, faults: type) -> argparse.ArgumentParser:
    """Construct the command-line parser of a device, with its faults listed below the options."""
    parser = argparse.ArgumentParser(
        name, None, text, faults.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    named = "what goes wrong, listed below"
    parser.add_argument("--faults", default="", metavar="NAME=NUMBER,…", help=named)
    return parser


def add_axis_options(parser: argparse.ArgumentParser) -> None:
    """Add options of an axis: pseudo-terminal, receivers of its travel, and seed."""
    add = parser.add_argument
    add("--pty", type=Path, metavar="LINK", help="make this link to the pseudo-terminal")
    purpose = "send true travel there, 200 Hz; may be repeated"
    add("--travel", type=address, action="append", default=[], metavar="HOST:PORT", help=purpose)
    add("--seed", type=seed, default=0, help="of all that is drawn")


def address(text: str) -> tuple[str, int]:
    """Parse a host and port of a command line."""
    host, _, number = text.rpartition(":")
    if not host:
        raise argparse.ArgumentTypeError(f"{text!r} is no HOST:PORT")
    return host, port(number)


def port(text: str) -> int:
    """Parse a port of a command line, 0 for any."""
    return _integer(text, 0xFFFF, "is not a port; give 0 to 65535")


def seed(text: str) -> int:
    """Parse a seed of a command line."""
    return _integer(text, 2**63 - 1, "is not a seed; give a whole number, 0 or more")


def finite(text: str) -> float:
    """Parse a finite number of a command line."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number; give a finite one")
    return value


def positive(text: str) -> float:
    """Parse a number of a command line from a millionth to a million."""
    value = finite(text)
    if not 1e-6 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} cannot be; give a number above zero")
    return value


def _integer(text: str, largest: int, problem: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text[:20]) <= largest):
        raise argparse.ArgumentTypeError(f"{text!r} {problem}")
    return int(text)


def require_axis(start: float, ends: Sequence[float], unit: str) -> None:
    """Raise SimulationError unless an axis starts between its ends."""
    low, high = ends
    if not low <= start <= high:
        raise SimulationError(
            f"An axis from {low:g} to {high:g} {unit} cannot start at {start:g} {unit}; give ends "
            f"that increase and a start between them."
        )


def serve_axis(
    receive: Receive, travel: Callable[[float], float], options: argparse.Namespace
) -> None:
    """Serve an axis on a pseudo-terminal, and send its true travel, m, to `options.travel`."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:

        def beat(now: float) -> float:
            datagram = MESSAGE.pack(now, travel(now))
            for listener in options.travel:
                with contextlib.suppress(OSError):  # no receiver at present
                    sender.sendto(datagram, listener)
            return now + _PERIOD

        serving = Serving(receive, beat=beat)
        serving.run(serving.open_terminal(options.pty))


def run_device(
    parser: argparse.ArgumentParser,
    serve: Callable[[argparse.Namespace], None],
    arguments: Sequence[str] | None,
) -> int:
    """Serve with the options of a command line; returns 2 after an error, else 0."""
    try:
        serve(parser.parse_args(arguments))
    except (GlissandoError, OSError) as problem:
        print(problem, file=sys.stderr)
        return 2
    return 0
