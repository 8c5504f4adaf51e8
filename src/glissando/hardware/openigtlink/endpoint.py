"""A connection to OpenIGTLink peers: sends updates to all of them, and receives their messages.

A separate process, `peer_server`, does the work. Nothing here waits for a peer.
"""

from __future__ import annotations

import json
import secrets
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import Self

from glissando.errors import DeviceError
from glissando.hardware.openigtlink.address import Address, WireFrame
from glissando.hardware.openigtlink.fields import MessageError
from glissando.hardware.openigtlink.link import ARRIVAL, Packet, PacketLink
from glissando.hardware.openigtlink.message import Message, decode

_START, _END = 60.0, 5.0  # s allowed for the process to start and to end
_MOST = 256  # messages per call of `receive`, so that a flood cannot delay the caller
_MOST_CALLS = 8  # calls that take all waiting messages: _MOST × _MOST_CALLS is its buffer


class Endpoint:
    """A client or a server, at an address in the form of `Address.parse`; a context manager.

    Args:
        address: igtl://host:port connects, with retries until a server answers;
            igtl-server://host:port listens, on 127.0.0.1 unless a host is given.
        hears: Whether messages of peers are received; otherwise they are discarded.

    Attributes:
        address: The parsed address; its port is the one that is listened on.
        peers: Number of connected peers.
        counts: Events: peers 'connected', 'lost', 'silent', 'refused' for invalid data, 'turned
            away'; 'updates dropped' for slow peers; 'messages dropped', 'malformed' or 'of unread
            types'; 'not sent', because the process had not accepted the previous update.

    Raises:
        DeviceError: The address is invalid, or cannot be listened on; from any method, the process
            that communicates with the peers has ended.
    """

    def __init__(self, address: str, *, hears: bool = True) -> None:
        self.text, self.address = address, Address.parse(address)
        self._mode = "hear" if hears else "tell"
        self.peers, self._started = 0, False
        self._own_counts, self._process_counts = Counter[str](), Counter[str]()
        self._link: PacketLink | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._initial_messages: list[tuple[float, Message]] = []

    @property
    def counts(self) -> Counter[str]:
        """Number of events by name."""
        return self._own_counts + self._process_counts

    def __enter__(self) -> Self:
        with socket.create_server(("127.0.0.1", 0)) as server:
            port, token = server.getsockname()[1], secrets.token_bytes(16)
            command = [sys.executable, "-m", "glissando.hardware.openigtlink.peer_server"]
            # In a session of its own, so that Ctrl-C at the terminal reaches the estimator alone.
            self._process = subprocess.Popen(
                [*command, str(port), self.text, self._mode],
                stdin=subprocess.PIPE,
                start_new_session=True,
            )
            try:
                assert self._process.stdin is not None
                self._process.stdin.write(token)
                self._process.stdin.close()
                self._link = PacketLink(_met(server, token))
                deadline = time.monotonic() + _START
                while not self._started and time.monotonic() < deadline:
                    self._initial_messages = self.receive()  # messages that have arrived so far
                    time.sleep(0.005)
            except BaseException:
                self.close()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the link, upon which the process ends."""
        if self._link is not None:
            self._link.close()
        if self._process is not None:
            try:
                self._process.wait(_END)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._link = None

    def send(self, messages: Sequence[bytes]) -> bool:
        """Send encoded messages as one update, which each peer gets completely or not at all.

        Returns:
            Whether the process accepted them; the call does not wait for it.
        """
        sent = self._open().send(Packet.BUNDLE, b"".join(messages))
        self._own_counts["not sent"] += not sent
        self._require_alive()
        return sent

    def receive(self) -> list[tuple[float, Message]]:
        """Messages that have arrived since the last call, 256 at most, with their arrival times.

        Returns:
            Pairs of arrival time, s of time.monotonic(), and message.
        """
        out, self._initial_messages = self._initial_messages, []
        link = self._open()
        link.flush()
        for kind, data in link.receive(_MOST):
            if kind == Packet.MESSAGE:
                try:
                    out.append((ARRIVAL.unpack_from(data)[0], decode(data[ARRIVAL.size :])))
                except MessageError:
                    self._own_counts["malformed"] += 1
            elif kind == Packet.REPORT:
                report = json.loads(data)
                self.peers, self._started = report["peers"], True
                self._process_counts = Counter(report["counts"])
                self.address = Address(**{**vars(self.address), "port": report["port"]})
            elif kind == Packet.FAILURE:
                raise DeviceError(data.decode())
        self._require_alive()
        return out

    def receive_all(self) -> list[tuple[float, Message]]:
        """Messages of up to eight calls of `receive`, which end when no message is waiting."""
        out: list[tuple[float, Message]] = []
        for _ in range(_MOST_CALLS):
            if not (arrived := self.receive()):
                break
            out += arrived
        return out

    def _open(self) -> PacketLink:
        if self._link is None:
            raise DeviceError("The endpoint is closed; use it as `with Endpoint(…) as endpoint:`.")
        return self._link

    def _require_alive(self) -> None:
        if self._open().ended:
            raise DeviceError(f"The process that serves {self.text} has ended; start again.")


class EndpointUser:
    """Base of sources, sinks and trackers that own an endpoint; a context manager.

    Args:
        address: As `Endpoint` takes it.
        hears: Whether messages of peers are received rather than discarded.
    """

    def __init__(self, address: str, *, hears: bool = True) -> None:
        self._endpoint = Endpoint(address, hears=hears)
        self._frame = WireFrame.of(self._endpoint.address)
        self._own_counts = Counter[str]()

    def __enter__(self) -> Self:
        self._endpoint.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._endpoint.close()

    @property
    def port(self) -> int:
        """Port that is connected to, or listened on."""
        return self._endpoint.address.port

    @property
    def counts(self) -> Counter[str]:
        """Numbers of values dropped, and of events of the connection, by name."""
        return self._own_counts + self._endpoint.counts


def _met(server: socket.socket, token: bytes) -> socket.socket:
    """Accept the connection of the process that sends the token. Raises DeviceError."""
    deadline = time.monotonic() + _START
    while (left := deadline - time.monotonic()) > 0.0:
        server.settimeout(left)
        try:
            connected, _ = server.accept()
        except TimeoutError:
            break
        connected.settimeout(_END)
        with suppress(OSError):
            if secrets.compare_digest(connected.recv(16, socket.MSG_WAITALL), token):
                return connected
        connected.close()  # another program connected to the port
    raise DeviceError("The process that speaks with peers did not start; start it again.")
